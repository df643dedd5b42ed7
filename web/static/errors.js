// Errors in mm and degrees, with bars against the tolerance and a verdict in words.
const ROWS = [
  ["x_mm", "X", "mm", 1],
  ["y_mm", "Y", "mm", 1],
  ["z_mm", "Z (normal)", "mm", 1],
  ["distance_mm", "distance", "mm", 1],
  ["rotation_deg", "rotation", "deg", 2],
];
const LOOK_OLD_S = 60;

export function showErrors(state) {
  document.getElementById("goal").textContent = `goal: ${state.stand_off_mm} mm in front of the target`;
  const look = state.look?.error ?? null;
  const old = state.look && state.look.age_s > LOOK_OLD_S;
  const body = document.querySelector("#errors tbody");
  body.replaceChildren(...ROWS.map((row) => errorRow(row, state, look, old)));
  document.getElementById("verdict").textContent = verdict(state, look, old);
}

function errorRow([name, label, unit, digits], state, look, old) {
  const tolerance = unit === "mm" ? state.tolerance_mm : state.tolerance_deg;
  const live = state.live_error?.[name];
  const row = document.createElement("tr");
  const sigma = look?.[`sigma_${name.replace("_mm", "").replace("_deg", "")}_${unit}`];
  const axis = ["x_mm", "y_mm", "z_mm"].indexOf(name);
  const predicted = state.plan && axis >= 0 ? `0 ± ${state.plan.predicted_sigma_mm[axis].toFixed(1)} ${unit}` : "–";
  row.append(
    cell(label),
    valueCell(live, tolerance, digits, unit, name),
    cell(look ? `${look[name].toFixed(digits)}${sigma === undefined ? "" : ` ± ${sigma.toFixed(digits)}`} ${unit}` : "–", old ? "old" : ""),
    cell(predicted),
    cell(`± ${tolerance} ${unit}`),
  );
  return row;
}

function valueCell(value, tolerance, digits, unit, name) {
  if (value === undefined || value === null) return cell("not seen", "value");
  const inside = Math.abs(value) <= tolerance;
  const result = cell(`${value.toFixed(digits)} ${unit}`, `value ${inside ? "in" : "out"}`);
  const signed = name === "rotation_deg" || name === "distance_mm" ? value : value;
  const bar = document.createElement("span");
  bar.className = "bar";
  const mark = document.createElement("i");
  mark.style.left = `${50 + 25 * Math.max(-1.9, Math.min(1.9, signed / tolerance))}%`;
  bar.append(mark);
  result.append(bar);
  return result;
}

function cell(text, className = "") {
  const result = document.createElement("td");
  result.textContent = text;
  result.className = className;
  return result;
}

function verdict(state, look, old) {
  if (!state.look) return "No look yet.";
  if (!look) return `Look failed: ${state.look.reason}`;
  if (old) return `The last look is ${Math.round(state.look.age_s)} s old: look again.`;
  const inside = ["x", "y", "z"].every((a) => Math.abs(look[`${a}_mm`]) <= state.tolerance_mm) && look.rotation_deg <= state.tolerance_deg;
  return inside ? "✓ Inside tolerance by the last look." : "Outside tolerance: calibrate if needed, preview and move.";
}
