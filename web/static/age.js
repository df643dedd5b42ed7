// How old things are. The server tells ages; they go on growing here while nothing new comes.
import { setClass } from "./dom.js";

export const LIMITS_MS = { server: 700, link: 250, camera: 700, look: 60000 };
let heardAt = -Infinity;

export const heardNow = () => { heardAt = performance.now(); };
export const silence = () => performance.now() - heardAt;
export const serverSilent = () => silence() > LIMITS_MS.server;

// An age that was told with the newest message, as it is now; null stays null.
export const grown = (toldMs) => (toldMs === null || toldMs === undefined ? null : toldMs + silence());

export const isOld = (toldMs, limitMs) => toldMs === null || toldMs === undefined || grown(toldMs) > limitMs;

export function ageText(ms) {
  if (ms === null || !Number.isFinite(ms)) return "–";
  if (ms < 1000) return `${Math.round(ms / 10) * 10} ms`;
  if (ms < 90000) return `${(ms / 1000).toFixed(1)} s`;
  return ms < 5.4e6 ? `${Math.round(ms / 60000)} min` : `${(ms / 3.6e6).toFixed(1)} h`;
}

// Cross out every value inside `element`.
export const crossOut = (element, old) => setClass(element, "old", old);
