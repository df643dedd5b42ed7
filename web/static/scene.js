// The 3D view in its frame: shown while it runs, reloaded after it came back, never in the way of anything.
import { silence } from "./age.js";
import { byId, setClass, setText } from "./dom.js";
import { recall, remember } from "./memory.js";
import { t } from "./texts.js";

const OFF = "longreach-scene-off";
const GONE_MS = 5000; // a short silence must not throw the chosen view away
let loaded = null; // process of the view that the frame shows

export function startScene(live) {
  byId("scrub").oninput = () => live.send({ scrub: Number(byId("scrub").value) / 100 });
  byId("scene-switch").onclick = () => remember(OFF, recall(OFF) ? "" : "yes");
}

export function showScene(state) {
  const { running, problem, process_id, scrub_frac } = state.panel.scene;
  const off = Boolean(recall(OFF)) || new URLSearchParams(location.search).has("no3d");
  setText(byId("scene-switch"), t(off ? "show_scene" : "hide_scene"));
  const wanted = running && !off && silence() < GONE_MS ? process_id : null;
  if (wanted !== loaded) {
    loaded = wanted;
    const frame = byId("view");
    frame.hidden = wanted === null;
    if (wanted === null) frame.removeAttribute("src");
    else frame.src = `view/?hideViserLogo&hideSceneTree&run=${process_id}`;
  }
  setText(byId("scene-off"), off ? t("scene_hidden") : problem ? t("scene_off", { problem }) : t("scene_loading"));
  setClass(byId("scene-off"), "behind", loaded !== null);
  byId("scrub-field").hidden = !state.plan;
  const slider = byId("scrub");
  if (document.activeElement !== slider) slider.value = String(Math.round(100 * scrub_frac));
}
