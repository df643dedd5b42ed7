// The steps: which one is next, and why the others are not possible now.
const buttons = [...document.querySelectorAll("button[data-kind]")];

export function onStep(act) {
  for (const button of buttons) button.onclick = () => act(button.dataset.kind);
}

export function showSteps(state) {
  const next = nextStep(state);
  for (const button of buttons) {
    const reason = state.steps[button.dataset.kind] ?? "";
    button.disabled = reason !== "";
    button.title = reason;
    button.classList.toggle("next", button.dataset.kind === next && !reason);
  }
  document.getElementById("hint").textContent = hint(state, next);
  showPlan(state.plan);
}

function nextStep(state) {
  if (state.plan) return "execute";
  const error = state.look?.error;
  if (!error || state.look.age_s > 60) return "look";
  if (error.rotation_deg > state.tolerance_deg && !state.calibration) return "orient";
  if (!state.calibration) return "calibrate";
  const inside = ["x", "y", "z"].every((a) => Math.abs(error[`${a}_mm`]) <= state.tolerance_mm);
  return inside ? "" : "preview";
}

function hint(state, next) {
  if (state.job && ["running", "stopping"].includes(state.job.state)) return state.job.events.at(-1)?.text ?? "";
  const blocked = state.steps.look;
  if (blocked) return blocked;
  return next ? `next: ${next === "execute" ? "move" : next}` : "on target";
}

function showPlan(plan) {
  const list = document.getElementById("plan");
  if (!plan) return list.replaceChildren();
  const rows = {
    plan: `${plan.plan_hash}, valid ${Math.max(0, Math.round(plan.expires_in_s))} s more`,
    path: `${plan.length_mm.toFixed(0)} mm in ${plan.duration_s.toFixed(1)} s, at most ${plan.tcp_speed_max_mm_s.toFixed(0)} mm/s`,
    clearance: plan.clearance_mm === null ? "wall not known" : `${plan.clearance_mm.toFixed(0)} mm to the wall`,
    ...(plan.caution ? { caution: plan.caution } : {}),
    joints: plan.joint_travel_deg.map((d) => d.toFixed(1)).join(" / ") + " deg travel",
  };
  list.replaceChildren(
    ...Object.entries(rows).flatMap(([name, text]) => {
      const term = document.createElement("dt");
      const detail = document.createElement("dd");
      term.textContent = name;
      detail.textContent = text;
      return [term, detail];
    }),
  );
}
