// Top bar, story of the job, history of moves, joints.
const LINK_OLD_MS = 250;
const CAMERA_OLD_MS = 500;

export function showBar(state) {
  const mode = document.getElementById("mode");
  mode.textContent = state.mode;
  mode.className = `mode ${state.mode.toLowerCase()}`;
  document.getElementById("machine").textContent = state.machine;
  document.getElementById("version").textContent = `longreach ${state.version}`;
  const link = state.link;
  const linkAge = link.age_ms === null ? "never heard" : `${Math.round(link.age_ms)} ms`;
  const phase = link.dry_run ? `${link.phase}, DRY RUN (valves neutral)` : link.phase;
  chip("link", `PLC ${phase}, ${linkAge}, ${link.lost_pct.toFixed(1)} % lost`, link.age_ms === null || link.age_ms > LINK_OLD_MS ? "bad" : link.dry_run || ["fault", "local"].includes(link.phase) ? "warn" : "good");
  document.getElementById("link").title = [link.warning, ...link.recent_rejects.slice().reverse()].filter(Boolean).join("\n");
  const camera = state.camera;
  const cameraAge = camera.age_ms === null ? "no image" : `${camera.fps.toFixed(0)} pairs/s, ${Math.round(camera.age_ms)} ms`;
  chip("camera", `camera ${cameraAge}`, camera.age_ms === null || camera.age_ms > CAMERA_OLD_MS ? "bad" : camera.warnings.length ? "warn" : "good");
  const job = state.job;
  const busy = job && ["running", "stopping"].includes(job.state);
  chip("job", busy ? `${job.kind} by ${job.owner}, ${Math.round(job.elapsed_s)} s` : job ? `${job.kind} ${job.state}` : "idle", busy ? "warn" : job?.state === "failed" ? "bad" : "good");
}

function chip(id, text, level) {
  const element = document.getElementById(id);
  element.textContent = text;
  element.className = `chip ${level}`;
}

export function showStory(state) {
  const events = state.job?.events.filter((event) => event.text).slice(-40).reverse() ?? [];
  document.getElementById("events").replaceChildren(
    ...events.map((event) => {
      const item = document.createElement("li");
      const when = document.createElement("time");
      when.textContent = `${event.elapsed_s.toFixed(1)} s`;
      item.append(when, event.text);
      if (event.text.startsWith("failed")) item.className = "bad";
      return item;
    }),
  );
  document.querySelector("#moves tbody").replaceChildren(
    ...state.moves.map((move) => {
      const row = document.createElement("tr");
      const change = (name, digits) => `${move.before[name].toFixed(digits)} → ${move.after ? move.after[name].toFixed(digits) : "–"}`;
      const texts = [move.kind === "move" ? `move ${move.number}` : `orient ${move.number}`, change("x_mm", 1), change("y_mm", 1), change("z_mm", 1), change("rotation_deg", 2)];
      row.append(...texts.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
      return row;
    }),
  );
}

export function showJoints(state) {
  showCalibration(state);
  const rows = state.joint_names.map((name, i) => {
    const row = document.createElement("tr");
    const range = document.createElement("td");
    range.className = "range";
    const box = document.createElement("div");
    const mark = document.createElement("i");
    mark.style.left = `${(100 * (state.q_deg[i] - state.q_min_deg[i])) / (state.q_max_deg[i] - state.q_min_deg[i])}%`;
    box.append(mark);
    range.append(box);
    row.append(text(name), text(`${state.q_deg[i].toFixed(2)}°`), range, text(`${state.q_min_deg[i].toFixed(0)} … ${state.q_max_deg[i].toFixed(0)}°`));
    return row;
  });
  document.querySelector("#joints tbody").replaceChildren(...rows);
}

function showCalibration(state) {
  const element = document.getElementById("calibration");
  const found = state.calibration;
  element.className = found && !found.valid ? "expired" : "";
  element.title = found?.observability_text ?? "";
  element.textContent = found ? calibrationText(found) : `not calibrated${state.calibration_note ? `: ${state.calibration_note}` : ""}`;
}

function calibrationText(found) {
  if (!found.valid) return `calibration EXPIRED: ${found.expiry_reason}`;
  const parts = [`camera rotation known to ${found.sigma_deg.toFixed(2)}°`, `residual ${found.residual_rms_mm.toFixed(1)} mm`];
  if (found.age_s !== null) parts.push(`${ageText(found.age_s)} old (limit ${found.age_max_h} h)`);
  if (found.radius_mm !== null) parts.push(`${found.distance_mm === null ? "?" : found.distance_mm.toFixed(0)} of ${found.radius_mm.toFixed(0)} mm from where it was made`);
  parts.push(`${found.from_nominal_deg.toFixed(1)}° off nominal`, `clock ${found.time_offset_ms.toFixed(0)} ms`);
  return parts.join(", ");
}

function ageText(seconds) {
  return seconds < 5400 ? `${Math.max(0, Math.round(seconds / 60))} min` : `${(seconds / 3600).toFixed(1)} h`;
}

function text(content) {
  return Object.assign(document.createElement("td"), { textContent: content });
}
