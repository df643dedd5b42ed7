// How old things are. The server sends ages and its own clock; both clocks are matched here, so that what has waited in
// a queue on its way is as old as it is, and ages go on growing while nothing new comes.
import { setClass } from "./dom.js";

export const LIMITS_MS = { server: 700, link: 250, camera: 700 };
const STALE_PICTURE = /^(?!.*\(over;).*(frozen|repeats)/; // the camera's warnings that mean: what is seen is not now
const CREEP_MS = 0.05; // a message, ten of them a second: lets two clocks drift apart by 500 ppm
let heardAt = -Infinity;
let ahead = Infinity; // this page's clock less the server's, by the fastest message; late by its way

// A message that the server made at `serverMs` on its clock; without it, or before anything is known: made now.
export function heard(serverMs) {
  ahead = Math.min(ahead + CREEP_MS, performance.now() - serverMs);
  heardAt = Math.max(heardAt, ahead + serverMs);
}

// On a new connection: it may be another life of the server, with another clock.
export const forgetClock = () => { ahead = Infinity; };

// When that was on this page's clock; `otherwise` before the clocks are matched.
export const pageTime = (serverMs, otherwise) => (Number.isFinite(ahead) ? Math.min(ahead + serverMs, performance.now()) : otherwise);
export const silence = () => performance.now() - heardAt;
export const serverSilent = () => silence() > LIMITS_MS.server;

// An age that came with the newest message, as it is now; null stays null.
export const grown = (ageMs) => (ageMs === null || ageMs === undefined ? null : ageMs + silence());

export const isOld = (ageMs, limitMs) => ageMs === null || ageMs === undefined || grown(ageMs) > limitMs;

// The last look against the server's own limits: its age, and whether the machine is where it was taken. A calibration is
// driven: the look before it is outdated, also where the machine came back.
export const lookOld = (state) => isOld(state.look ? 1000 * state.look.age_s : null, 1000 * state.panel.look_age_max_s);
export const movedSince = (state) => state.panel.look_moved_deg > state.panel.look_moved_max_deg || (state.calibration?.age_s ?? Infinity) < (state.look?.age_s ?? 0);

// Whether the camera's data are stale: nothing came for too long, what comes was long on its way, or the same
// picture comes again and again.
export const pictureOld = ({ camera, panel }) =>
  serverSilent() || isOld(camera.age_ms, LIMITS_MS.camera) || isOld(panel.vision.exposure_age_ms, LIMITS_MS.camera) || stalePicture(camera.warnings) !== "";
export const stalePicture = (warnings) => warnings.find((text) => STALE_PICTURE.test(text)) ?? "";

export function ageText(ms) {
  if (ms === null || !Number.isFinite(ms)) return "–";
  if (ms < 1000) return `${Math.round(ms / 10) * 10} ms`;
  if (ms < 90000) return `${(ms / 1000).toFixed(1)} s`;
  return ms < 5.4e6 ? `${Math.round(ms / 60000)} min` : `${(ms / 3.6e6).toFixed(1)} h`;
}

// Cross out every value inside `element`.
export const crossOut = (element, old) => setClass(element, "old", old);
