// Choosing a target in the camera picture: click, look at what was measured, use it. Nothing moves by any of it.
import { afterDrawing, pictureClick, shownHeader } from "./camera.js";
import { send } from "./commands.js";
import { byId, setText } from "./dom.js";
import { drawMarks, findMarks, forgetMarks, markAt } from "./marks.js";
import { t } from "./texts.js";

const AXIS_COLORS = ["#ff6b6b", "#51d88a", "#5aa9ff"];
let choosing = false;
let candidate = null;
let target = null;

export function startTarget() {
  byId("target-choose").onclick = () => choose(!choosing);
  byId("target-use").onclick = use;
  byId("marks-find").onclick = find;
  byId("target-clear").onclick = async () => take((await send("DELETE", "/v1/target")).data);
  pictureClick(measure);
  afterDrawing(draw);
  read();
}

async function read() {
  const answer = await send("GET", "/v1/target", undefined, { quiet: true });
  if (answer.ok) take(answer.data);
  else show();
}

function choose(on) {
  choosing = on;
  if (!on) candidate = null;
  if (!on) forgetMarks();
  show();
}

async function measure([u, v]) {
  const header = shownHeader();
  if (!choosing || !header) return;
  const mark = markAt([u, v]);
  if (mark) {
    candidate = mark.patch;
    return show();
  }
  setText(byId("target-line"), t("target_measuring"));
  const answer = await send("POST", "/v1/target/measure", { image: header.number, u_px: u, v_px: v });
  candidate = answer.ok ? answer.data : null;
  show();
}

async function find() {
  choosing = true;
  candidate = null;
  show();
  setText(byId("target-line"), t("marks_searching"));
  const found = await findMarks();
  show();
  if (found) setText(byId("target-line"), found.reason || t("marks_found", { n: found.marks.length }));
}

async function use() {
  const answer = await send("POST", "/v1/target", { target_id: candidate.target_id });
  if (!answer.ok) return;
  choosing = false;
  take(answer.data);
}

function take(view) {
  if (!view) return;
  target = view.target;
  candidate = null;
  forgetMarks();
  show();
}

function show() {
  setText(byId("target-choose"), t(choosing ? "target_cancel" : "target_choose"));
  byId("target-choose").setAttribute("aria-pressed", String(choosing));
  byId("picture").classList.toggle("choosing", choosing);
  byId("target-use").hidden = candidate?.status !== "ok";
  byId("target-clear").hidden = !target || choosing;
  setText(byId("target-line"), line());
}

function line() {
  if (candidate && candidate.status !== "ok") return t("target_refused", { why: candidate.reason });
  if (candidate) return `${t("target_found", figures(candidate))}. ${reach(candidate)}`;
  if (choosing) return t("target_click");
  return target ? t("target_in_use", figures(target)) : t("target_markers");
}

const reach = (patch) => t(`target_reach_${patch.reach}`, { why: patch.reach_reason });

const figures = (patch) => ({
  mm: patch.distance_mm.toFixed(0), place: patch.position_mm.toFixed(1), deg: patch.normal_deg.toFixed(1), radius: patch.radius_mm.toFixed(0),
});

// The candidate in the picture it was measured in: the machine is at rest while a target is chosen.
function draw(context, place) {
  drawMarks(context, place, candidate?.target_id);
  if (!candidate) return;
  const [u, v] = place([candidate.u_px, candidate.v_px]);
  const good = candidate.status === "ok";
  context.strokeStyle = good ? (candidate.reach === "refused" ? "#ff9f43" : "#ffd84d") : "#ff6b6b";
  context.lineWidth = 2.5;
  for (const ring of [candidate.outline_px, candidate.ellipse_px]) {
    if (!ring.length) continue;
    context.beginPath();
    ring.map(place).forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.stroke();
  }
  const [origin, ...ends] = candidate.axes_px.map(place);
  ends.forEach(([x, y], i) => {
    context.strokeStyle = AXIS_COLORS[i];
    context.beginPath();
    context.moveTo(...origin);
    context.lineTo(x, y);
    context.stroke();
  });
  if (good) return;
  context.beginPath();
  context.moveTo(u - 10, v - 10);
  context.lineTo(u + 10, v + 10);
  context.moveTo(u + 10, v - 10);
  context.lineTo(u - 10, v + 10);
  context.stroke();
}
