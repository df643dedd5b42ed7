// Replay of one finished run: a slider over its pictures, joints, looks and story.
import { notice, send } from "./commands.js";
import { byId, make, setText } from "./dom.js";
import { t } from "./texts.js";

const PICTURE_S = 3; // as long a picture stands for its time; long runs have one every second or two
let run = null;
let loading = false; // one at a time: the server reads one, and a browser has six connections for everything

export async function openReplay(name) {
  if (loading) return;
  showLine(t("loading"));
  byId("replay").hidden = true;
  loading = true;
  const { ok, data } = await send("GET", `/v1/panel/recordings/${name}/replay`).finally(() => (loading = false));
  if (!ok) return showLine(t("replay_empty", { name }));
  showLine("");
  notice("");
  run = { name, ...data };
  const end = Math.max(0, ...[data.joints, data.lines, data.pictures, data.looks].map((list) => list.at(-1)?.[0] ?? 0));
  byId("replay").hidden = false;
  setText(byId("replay-title"), t("replay_title", { name }));
  const slider = byId("replay-slider");
  Object.assign(slider, { min: 0, max: end, step: 0.1, value: 0 });
  slider.oninput = () => show(Number(slider.value), end);
  show(0, end);
}

function showLine(text) {
  setText(byId("replay-line"), text);
  byId("replay-line").hidden = !text;
}

const lastBefore = (list, time) => list.findLast(([at]) => at <= time + 1e-6) ?? list[0];

function show(time, end) {
  setText(byId("replay-at"), t("replay_at", { s: time.toFixed(1), end: end.toFixed(1) }));
  const picture = lastBefore(run.pictures, time);
  const image = byId("replay-picture");
  image.hidden = !picture || time - picture[0] > PICTURE_S; // none of then is shown in its place
  const path = picture ? `v1/panel/recordings/${run.name}/pictures/${picture[1]}-${picture[2]}` : "";
  if (picture && image.getAttribute("src") !== path) image.src = path;
  const joints = lastBefore(run.joints, time);
  setText(byId("replay-joints"), joints ? `${joints[1].map((q) => (q === null ? "–" : `${q.toFixed(1)}°`)).join("  ")}  ${joints[2]}` : "");
  const lines = run.lines.filter(([at]) => at <= time + 1e-6).slice(-8).reverse();
  byId("replay-lines").replaceChildren(...lines.map(([at, text]) => make("li", {}, make("time", {}, `${at.toFixed(1)} s`), text)));
}
