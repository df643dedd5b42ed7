// History of looks and moves with its trend, the story of the job, the joints.
import { LIMITS_MS, isOld, crossOut, serverSilent } from "./age.js";
import { byId, make, setText, svg, whenChanged } from "./dom.js";
import { t } from "./texts.js";

const WIDTH = 420;
const HEIGHT = 70;

export function showHistory(state) {
  const history = state.panel.history;
  whenChanged("history-body", history, (body) => body.replaceChildren(...history.slice().reverse().map(historyRow)));
  byId("no-history").hidden = history.length > 0;
  byId("history-table").hidden = history.length === 0;
  byId("trend").hidden = history.every((one) => !one.error);
  whenChanged("trend", [history.map((one) => one.error?.distance_mm ?? null), state.tolerance_mm], (box) => box.replaceChildren(trend(history, state.tolerance_mm)));
}

const clock = (unixS) => new Date(1000 * unixS).toLocaleTimeString("en-GB");

function historyRow(one) {
  const error = one.error;
  const number = (name, digits) => error[name].toFixed(digits);
  const first = [one.number, clock(one.unix_s), one.after].map((text) => make("td", {}, String(text)));
  if (!error) return make("tr", {}, ...first, make("td", { class: "why", colspan: 6 }, one.reason || one.status));
  const inside = one.accepted_by ? t("accepted_by", { who: one.accepted_by }) : t(one.inside ? "yes" : "no");
  const cells = [number("x_mm", 1), number("y_mm", 1), number("z_mm", 1), number("distance_mm", 1), number("rotation_deg", 2), inside];
  return make("tr", { class: one.inside ? "in" : "" }, ...first, ...cells.map((text) => make("td", {}, text)));
}

function trend(history, tolerance) {
  const values = history.map((one) => one.error?.distance_mm ?? null);
  const known = values.filter((value) => value !== null);
  const low = Math.log10(0.3);
  const high = Math.log10(Math.max(10 * tolerance, ...known, 10));
  const y = (value) => HEIGHT - 8 - ((HEIGHT - 16) * (Math.log10(Math.max(0.3, value)) - low)) / (high - low);
  const x = (i) => 50 + ((WIDTH - 65) * i) / Math.max(1, values.length - 1);
  const label = t("trend_label", { n: values.length, now: known.length ? known.at(-1).toFixed(1) : "–" });
  const chart = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label });
  chart.append(svg("rect", { class: "band", x: 46, y: y(tolerance), width: WIDTH - 50, height: HEIGHT - 4 - y(tolerance) }));
  for (const value of [1, 10, 100, 1000].filter((one) => Math.log10(one) <= high)) {
    chart.append(svg("line", { class: "grid", x1: 46, x2: WIDTH - 4, y1: y(value), y2: y(value) }));
    const text = svg("text", { x: 42, y: y(value) + 3, "text-anchor": "end" });
    text.textContent = `${value} mm`;
    chart.append(text);
  }
  const points = values.flatMap((value, i) => (value === null ? [] : [[x(i), y(value)]]));
  chart.append(svg("polyline", { class: "line", points: points.map((p) => p.join(",")).join(" ") }));
  for (const [u, v] of points) chart.append(svg("circle", { class: "dot", cx: u, cy: v, r: 3.2 }));
  return chart;
}

export function showStory(state) {
  const events = state.job?.events.filter((event) => event.text) ?? [];
  whenChanged("events", [state.job?.job_id, events.length], (list) => {
    list.replaceChildren(
      ...events.slice(-40).reverse().map((event) => make("li", {}, make("time", {}, `${event.elapsed_s.toFixed(1)} s`), event.text)),
    );
  });
}

export function showJoints(state) {
  const old = isOld(state.link.age_ms, LIMITS_MS.link) || serverSilent();
  const body = byId("joints-body");
  crossOut(byId("panel-joints"), old);
  if (body.childElementCount !== state.joint_names.length) body.replaceChildren(...state.joint_names.map(jointRow));
  state.joint_names.forEach((_name, i) => {
    const row = body.children[i];
    const [low, high, now, wanted] = [state.q_min_deg[i], state.q_max_deg[i], state.q_deg[i], state.q_ref_deg[i]];
    setText(row.children[1], `${now.toFixed(2)}°`);
    setText(row.children[3], `${low.toFixed(0)} … ${high.toFixed(0)}°`);
    const place = (value) => (100 * (value - low)) / (high - low);
    row.querySelector("rect.now").setAttribute("x", place(now) - 1);
    row.querySelector("rect.wanted").setAttribute("x", place(wanted) - 0.5);
  });
}

function jointRow(name) {
  const range = svg("svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none", class: "range", "aria-hidden": "true" }, svg("rect", { class: "track", x: 0, y: 4, width: 100, height: 2 }), svg("rect", { class: "wanted", y: 1, width: 1, height: 8 }), svg("rect", { class: "now", y: 0, width: 2, height: 10 }));
  return make("tr", {}, make("th", { scope: "row" }, name), make("td", { class: "v" }), make("td", {}, range), make("td", {}));
}
