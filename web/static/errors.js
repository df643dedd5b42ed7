// Errors in mm and degrees: before, now, predicted, each with its bar against the tolerance, and a verdict in words.
import { ageText, grown, lookOld, movedSince, pictureOld, serverSilent } from "./age.js";
import { byId, make, setText, svg, whenChanged } from "./dom.js";
import { t } from "./texts.js";

const ROWS = [
  ["x_mm", "axis_x", "mm", 1, "sigma_x_mm", 0],
  ["y_mm", "axis_y", "mm", 1, "sigma_y_mm", 1],
  ["z_mm", "axis_z", "mm", 1, "sigma_z_mm", 2],
  ["distance_mm", "axis_norm", "mm", 1, null, null],
  ["rotation_deg", "axis_rotation", "°", 2, "sigma_rotation_deg", null],
];
const WIDTH = 150;
const HEIGHT = 20;
const SPAN = 2; // tolerances to each side

export function buildErrors() {
  byId("errors-body").replaceChildren(
    ...ROWS.map(([name, label]) =>
      make("tr", { id: `row-${name}` }, make("th", { scope: "row" }, t(label)), make("td", { class: "now" }), make("td", { class: "bar-cell" }), make("td", { class: "before" }), make("td", { class: "predicted" })),
    ),
  );
}

export function showErrors(state) {
  const goal = state.panel.goal;
  const shift = goal.offset_x_mm || goal.offset_y_mm ? t("goal_shift", { x: goal.offset_x_mm, y: goal.offset_y_mm }) : "";
  setText(byId("goal"), t("goal_line", { z: goal.stand_off_mm, shift }));
  setText(byId("allowed"), t("allowed", { mm: state.tolerance_mm, deg: state.tolerance_deg }));
  const look = state.look?.error ?? null;
  const old = Boolean(state.look) && lookOld(state);
  const liveOld = pictureOld(state);
  for (const row of ROWS) showRow(row, state, look, old || serverSilent(), liveOld);
  showVerdict(state, look, old);
}

function showRow([name, label, unit, digits, sigmaName, axis], state, look, old, liveOld) {
  const row = byId(`row-${name}`);
  const limit = unit === "mm" ? state.tolerance_mm : state.tolerance_deg;
  const live = state.live_error?.[name] ?? null;
  const before = look?.[name] ?? null;
  const sigma = look && sigmaName ? look[sigmaName] : null;
  const predicted = state.plan && axis !== null ? 2 * state.plan.predicted_sigma_mm[axis] : null;
  const number = (value) => `${value.toFixed(digits)} ${unit}`;
  const now = row.querySelector("td.now");
  setText(now, live === null ? t("not_seen") : number(live));
  now.className = `now ${live === null ? "" : Math.abs(live) <= limit ? "in" : "out"}${liveOld ? " old" : ""}`;
  const last = row.querySelector("td.before");
  setText(last, before === null ? "–" : `${before.toFixed(digits)}${sigma === null ? "" : ` ± ${(2 * sigma).toFixed(digits)}`} ${unit}`);
  last.className = `before${old ? " old" : ""}`;
  setText(row.querySelector("td.predicted"), predicted === null ? "–" : `0 ± ${predicted.toFixed(1)} ${unit}`);
  const shown = [live === null || liveOld ? null : +live.toFixed(digits), before === null ? null : +before.toFixed(digits), predicted, limit];
  const cell = row.querySelector("td.bar-cell");
  cell.id = `bar-${name}`;
  whenChanged(cell.id, shown, (target) => target.replaceChildren(bar(shown, t(label), unit, digits)));
}

function bar([now, before, predicted, limit], axis, unit, digits) {
  const x = (value) => WIDTH / 2 + (WIDTH / 2 / SPAN) * Math.max(-SPAN * 0.97, Math.min(SPAN * 0.97, value / limit));
  const text = (value) => (value === null ? "–" : `${value.toFixed(digits)} ${unit}`);
  const label = t("bar_label", { axis, now: text(now), before: text(before), limit: `${limit} ${unit}`, sigma: text(predicted) });
  const parts = [svg("rect", { class: "band", x: x(-limit), y: 2, width: x(limit) - x(-limit), height: HEIGHT - 4 }), svg("line", { class: "zero", x1: WIDTH / 2, x2: WIDTH / 2, y1: 0, y2: HEIGHT })];
  if (predicted !== null) parts.push(svg("rect", { class: "predicted", x: x(-predicted), y: HEIGHT / 2 - 2.5, width: Math.max(2, x(predicted) - x(-predicted)), height: 5 }));
  if (before !== null) parts.push(mark(x(before), Math.abs(before) > SPAN * limit, Math.sign(before), "before"));
  if (now !== null) parts.push(mark(x(now), Math.abs(now) > SPAN * limit, Math.sign(now), Math.abs(now) <= limit ? "now in" : "now out"));
  return svg("svg", { class: "bar", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label }, ...parts);
}

// A line, or an arrow to where the value lies beyond the bar.
function mark(x, beyond, sign, name) {
  if (!beyond) return svg("rect", { class: name, x: x - 2, y: 1, width: 4, height: HEIGHT - 2 });
  return svg("path", { class: name, d: `M ${x + 4 * sign} ${HEIGHT / 2} l ${-9 * sign} -7 v 14 z` });
}

function showVerdict(state, look, old) {
  const element = byId("verdict");
  const [text, level] = verdict(state, look, old);
  setText(element, text);
  element.className = `verdict ${level}`;
}

function verdict(state, look, old) {
  if (serverSilent()) return [t("why_server"), ""];
  if (!state.look) return [t("verdict_none"), ""];
  if (!look) return [t("verdict_failed", { why: state.look.reason }), "bad"];
  if (old) return [t("verdict_old", { age: ageText(grown(1000 * state.look.age_s)) }), ""];
  if (movedSince(state)) return [t("why_moved"), ""];
  if (state.panel.history.at(-1)?.inside) return [t("verdict_inside"), "good"];
  const inside = ["x", "y", "z"].every((a) => Math.abs(look[`${a}_mm`]) <= state.tolerance_mm) && look.rotation_deg <= state.tolerance_deg;
  return [t(inside ? "verdict_near" : "verdict_outside"), inside ? "" : "bad"];
}
