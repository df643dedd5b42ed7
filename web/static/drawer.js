// Engineering: link, vision, calibration, gap, recordings with replay, settings. Opens at the side; never covers the top bar.
import { LIMITS_MS, ageText, crossOut, grown, isOld, serverSilent } from "./age.js";
import { send } from "./commands.js";
import { byId, make, setText, svg, whenChanged } from "./dom.js";
import { closeGap, openGap } from "./gap.js";
import { openReplay } from "./replay.js";
import { t } from "./texts.js";

const HEIGHT = 90;
let open = "";

export function startDrawer() {
  const drawer = byId("drawer");
  byId("open-drawer").onclick = () => { drawer.hidden = !drawer.hidden; if (!drawer.hidden) choose(open || "link"); };
  byId("close-drawer").onclick = () => { drawer.hidden = true; closeGap(); byId("open-drawer").focus(); };
  for (const button of drawer.querySelectorAll("[data-tab]")) button.onclick = () => choose(button.dataset.tab);
}

function choose(name) {
  open = name;
  for (const button of byId("drawer").querySelectorAll("[data-tab]")) button.setAttribute("aria-pressed", String(button.dataset.tab === name));
  for (const panel of byId("drawer").querySelectorAll("[data-panel]")) panel.hidden = panel.dataset.panel !== name;
  if (name === "recordings") listRecordings();
  if (name === "settings") listSettings();
  if (name === "gap") openGap();
  else closeGap();
}

const rows = (pairs) => make("dl", {}, ...pairs.flatMap(([name, text]) => [make("dt", {}, name), make("dd", { class: "v" }, text)]));

export function showDrawer(state) {
  if (byId("drawer").hidden) return;
  const { disk_free_gb, recording, recorder_problem } = state.panel;
  const parts = [disk_free_gb === null ? "" : t("disk", { gb: disk_free_gb.toFixed(1) }), recording ? t("recording_on") : "", recorder_problem];
  setText(byId("disk"), parts.filter(Boolean).join(" · "));
  if (open === "link") showLink(state);
  if (open === "vision") showVision(state);
  if (open === "calibration") showCalibration(state);
}

function showLink({ link, panel }) {
  const f = panel.link;
  crossOut(byId("drawer-link"), isOld(link.age_ms, LIMITS_MS.link) || serverSilent());
  whenChanged("drawer-link", [f, link.round_trip_ms, link.recent_rejects, link.warning], (box) =>
    box.replaceChildren(
      make("h3", {}, t("lateness")),
      histogram(f),
      rows([
        [t("send_late"), `${f.send_late_p50_ms.toFixed(2)} / ${f.send_late_p99_ms.toFixed(2)} / ${f.send_late_max_ms.toFixed(1)} ms`],
        [t("round_trip"), `${link.round_trip_ms.toFixed(2)} ms`],
        [t("buffer"), `${f.buffer_ms.toFixed(0)} ms`],
        [t("buffer_min"), `${f.buffer_min_ms.toFixed(0)} ms`],
        [t("loss"), `${f.loss_pct.toFixed(2)} %`],
        [t("counts"), `${f.sent} / ${f.received} / ${f.rejected} / ${f.samples_dropped}`],
        [t("rejects"), link.recent_rejects.slice(-3).join("; ") || t("none")],
        [t("warnings"), link.warning || t("none")],
      ]),
    ),
  );
}

function histogram({ lateness_edges_ms, lateness_counts }) {
  const total = Math.max(1, lateness_counts.reduce((a, b) => a + b, 0));
  const width = 40;
  const chart = svg("svg", { viewBox: `0 0 ${width * lateness_counts.length} ${HEIGHT + 18}`, role: "img", class: "histogram", "aria-label": `${t("lateness")}: ${lateness_counts.map((n, i) => `< ${lateness_edges_ms[i] ?? "∞"} ms: ${((100 * n) / total).toFixed(1)} %`).join(", ")}` });
  lateness_counts.forEach((n, i) => {
    const height = (HEIGHT * Math.log10(1 + n)) / Math.log10(1 + total);
    chart.append(svg("rect", { class: "dot", x: width * i + 3, y: HEIGHT - height, width: width - 6, height }));
    const text = svg("text", { x: width * (i + 0.5), y: HEIGHT + 13, "text-anchor": "middle" });
    text.textContent = lateness_edges_ms[i] === undefined ? `> ${lateness_edges_ms.at(-1)} ms` : `< ${lateness_edges_ms[i]}`;
    chart.append(text);
  });
  return chart;
}

function showVision({ camera, panel }) {
  const v = panel.vision;
  crossOut(byId("drawer-vision"), isOld(camera.age_ms, LIMITS_MS.camera) || serverSilent());
  whenChanged("drawer-vision", [v, camera.fps, camera.warnings], (box) =>
    box.replaceChildren(
      rows([
        [t("camera"), t("camera_text", { fps: camera.fps.toFixed(1) })],
        [t("process"), `${v.process_ms.toFixed(1)} ms`],
        [t("skipped"), v.skipped],
        [t("sharpness"), v.sharpness === null ? "–" : v.sharpness.toFixed(1)],
        [t("tool_seen"), v.tool],
        [t("target_seen"), v.target],
        [t("restarts"), v.restarts],
        [t("warnings"), camera.warnings.join("; ") || t("none")],
      ]),
    ),
  );
}

function showCalibration({ calibration: c, calibration_note: note, panel }) {
  whenChanged("drawer-calibration", [c, note, panel.calibration], (box) => {
    if (!c) return box.replaceChildren(make("p", {}, `${t("not_calibrated")} ${note ?? ""}`));
    const figures = panel.calibration;
    box.replaceChildren(
      make("p", { class: c.valid ? "good" : "bad" }, c.valid ? `✓ ${t("cal_valid")}` : t("cal_expired", { why: c.expiry_reason })),
      ...(figures ? [make("h3", {}, t("cal_ellipse")), ellipses(figures.covariance_deg2)] : []),
      rows([
        [t("cal_known"), `${c.sigma_deg.toFixed(3)}°`],
        [t("cal_weakest"), figures ? figures.weakest_axis_tcp.map((x) => x.toFixed(2)).join(", ") : "–"],
        [t("cal_residual"), `${c.residual_rms_mm.toFixed(2)} mm, ${c.n_used} ${t("cal_pairs")}`],
        [t("cal_age"), c.age_s === null ? "–" : t("cal_limit", { value: ageText(grown(1000 * c.age_s)), limit: `${c.age_max_h} h` })],
        [t("cal_place"), c.distance_mm === null ? "–" : t("cal_limit", { value: `${c.distance_mm.toFixed(0)} mm`, limit: `${c.radius_mm.toFixed(0)} mm` })],
        [t("cal_nominal"), `${c.from_nominal_deg.toFixed(2)}°`],
        [t("cal_offset"), `${c.time_offset_ms.toFixed(1)} ms`],
      ]),
    );
  });
}

// The covariance's three faces; all to one scale.
function ellipses(C) {
  const faces = [[0, 1, "x y"], [0, 2, "x z"], [1, 2, "y z"]];
  const largest = Math.sqrt(Math.max(...[0, 1, 2].map((i) => C[i][i]), 1e-12));
  const chart = svg("svg", { viewBox: "0 0 330 130", role: "img", class: "ellipses", "aria-label": `${t("cal_ellipse")}: ${[0, 1, 2].map((i) => Math.sqrt(C[i][i]).toFixed(3)).join(", ")}` });
  faces.forEach(([i, j, name], k) => {
    const [a, b, c] = [C[i][i], C[i][j], C[j][j]];
    const half = (a + c) / 2;
    const root = Math.hypot((a - c) / 2, b);
    const angle = (90 / Math.PI) * Math.atan2(2 * b, a - c);
    const r = (value) => Math.max(1, (45 * Math.sqrt(Math.max(0, value))) / largest);
    const x = 55 + 110 * k;
    chart.append(svg("line", { class: "grid", x1: x - 50, x2: x + 50, y1: 55, y2: 55 }), svg("line", { class: "grid", x1: x, x2: x, y1: 5, y2: 105 }));
    chart.append(svg("ellipse", { class: "ellipse", cx: x, cy: 55, rx: r(half + root), ry: r(half - root), transform: `rotate(${-angle} ${x} 55)` }));
    const text = svg("text", { x, y: 123, "text-anchor": "middle" });
    text.textContent = `${name}: ${Math.sqrt(a).toFixed(3)}°, ${Math.sqrt(c).toFixed(3)}°`;
    chart.append(text);
  });
  return chart;
}

async function listRecordings() {
  const { ok, data } = await send("GET", "/v1/panel/recordings", undefined, { quiet: true });
  if (!ok) return;
  const list = data.map((one) =>
    make(
      "tr",
      {},
      make("td", {}, one.name),
      make("td", {}, `${one.size_mb.toFixed(1)} MB`),
      make("td", {}, make("a", { href: `v1/panel/recordings/${one.name}/file`, download: one.name }, t("download"))),
      make("td", {}, make("button", { type: "button", onclick: () => openReplay(one.name) }, t("replay"))),
    ),
  );
  byId("recordings-body").replaceChildren(...list);
  byId("no-recordings").hidden = list.length > 0;
}

async function listSettings() {
  const { ok, data } = await send("GET", "/v1/settings", undefined, { quiet: true });
  if (ok) byId("settings-body").replaceChildren(...data.map((one) => make("tr", {}, make("th", { scope: "row" }, one.name), make("td", {}, one.value), make("td", {}, one.unit))));
}
