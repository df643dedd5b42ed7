// The steps: exactly one is primary, the others say why they are not possible now.
import { grown, lookOld, movedSince, serverSilent, stalePicture } from "./age.js";
import { send } from "./commands.js";
import { haveControl } from "./control.js";
import { byId, make, setClass, setText, whenChanged } from "./dom.js";
import { heldKind, holdButton, holding } from "./hold.js";
import { phrase, t } from "./texts.js";

const MAIN = ["look", "orient", "calibrate", "preview", "execute", "look_again", "accept"];
const MINOR = ["retract", "return", "park", "position", "reset"];
const MOVES = new Set(["orient", "calibrate", "execute", "retract", "return", "park", "position"]);
const SEES = new Set(["look", "look_again", "orient", "calibrate", "position"]);
const BLIND = new Set(["camera_silent", "vision_ended"]);
const JOB_OF = { look_again: "look" };
let state = null;
const buttons = new Map();

export function buildSteps() {
  for (const [box, kinds] of [["main-steps", MAIN], ["minor-steps", MINOR]]) {
    byId(box).replaceChildren(...kinds.map(stepButton));
  }
  byId("hold-switch").onchange = () => showSteps(state);
  byId("goal-form").onsubmit = (event) => {
    event.preventDefault();
    const value = (id) => Number(byId(id).value);
    send("PUT", "/v1/goal", { stand_off_mm: value("stand-off"), offset_x_mm: value("offset-x"), offset_y_mm: value("offset-y") });
  };
}

function stepButton(kind) {
  const button = make("button", { type: "button", class: "step", "data-kind": kind }, make("b", {}, ""), make("small", { class: "about" }));
  button.onclick = (event) => {
    if (MOVES.has(kind) && mustHold()) return; // held, never clicked
    if (event.detail > 1) return; // the second half of a double click is not a request of its own
    act(kind);
  };
  if (MOVES.has(kind)) holdButton(button, mustHold, () => bodyOf(kind));
  buttons.set(kind, button);
  return button;
}

export const mustHold = () => Boolean(state) && (state.panel.hold.required || byId("hold-switch").checked);

function bodyOf(kind) {
  const body = { kind: JOB_OF[kind] ?? kind };
  if (kind === "execute") body.plan_hash = byId("plan").dataset.hash; // the plan that this page shows, and no other
  if (kind === "retract") body.distance_mm = Number(byId("retract-mm").value);
  return body;
}

function act(kind) {
  if (kind === "accept") return send("POST", "/v1/accept");
  if (kind === "reset") return send("POST", "/v1/reset");
  return send("POST", "/v1/jobs", bodyOf(kind));
}

export function showSteps(now) {
  state = now;
  if (!state) return;
  const next = nextStep();
  noteEnds();
  for (const [kind, button] of buttons) showButton(kind, button, next);
  setText(byId("hint"), hint(next));
  byId("hold-switch").disabled = state.panel.hold.required;
  if (state.panel.hold.required) byId("hold-switch").checked = true;
  setClass(document.body, "must-hold", mustHold()); // a finger that wanders a little while it holds does not scroll
  setText(byId("hold-label"), t(state.panel.hold.required ? "hold_forced" : "hold_mode"));
  showPlan(state.plan);
  showGoal(state.panel.goal);
}

function showButton(kind, button, next) {
  const why = reason(kind);
  const disabled = why !== "" && heldKind() !== kind; // a button that is disabled under the finger would lose it
  if (button.disabled !== disabled) button.disabled = disabled;
  setClass(button, "primary", kind === next && !why);
  setClass(button, "running", running() && jobKind() === (JOB_OF[kind] ?? kind) && kind !== "look_again");
  const number = MAIN.includes(kind) ? `${MAIN.indexOf(kind) + 1} ` : "";
  setText(button.querySelector("b"), number + t(`step_${kind}`));
  setText(button.querySelector("small"), why || about(kind));
  if (kind === "reset") button.hidden = state.link.phase !== "fault";
}

function about(kind) {
  if (MOVES.has(kind) && mustHold()) return t(kind === "retract" ? "about_held_mm" : "about_held", { mm: byId("retract-mm").value });
  if (kind === "calibrate" && calibrated()) return t("why_calibrated");
  return t(`about_${kind}`, { mm: byId("retract-mm").value });
}

// How many jobs this page has seen end: for those who follow it by program.
let lastEnded = "";
function noteEnds() {
  const job = state.job;
  if (!job || running() || job.job_id === lastEnded) return;
  lastEnded = job.job_id;
  document.body.dataset.jobs = String(Number(document.body.dataset.jobs ?? 0) + 1);
}

const running = () => Boolean(state.job) && ["running", "stopping"].includes(state.job.state);
const jobKind = () => (state.job ? state.job.kind : "");
const calibrated = () => Boolean(state.calibration?.valid);
const planFresh = () => Boolean(state.plan) && grown(0) < 1000 && state.plan.expires_in_s - grown(0) / 1000 > 0;
const lookFresh = () => Boolean(state.look?.error) && !lookOld(state) && !movedSince(state);
// As the alarms have it: one bad pair between good ones must not make buttons flicker. The look itself reports other faults.
const blind = () => state.panel.alarms.some((one) => one.ended_unix_s === null && (BLIND.has(one.code) || (one.code === "camera_unfit" && stalePicture(state.camera.warnings))));
const lastLook = () => state.panel.history.at(-1);
const atGoal = () => lookFresh() && Boolean(lastLook()?.inside);
const accepted = () => Boolean(lastLook()?.accepted_by);

export function reason(kind) {
  if (serverSilent()) return t("why_server");
  if (!haveControl(state)) return state.control.owner && !state.control.stale ? t("other_control", { owner: state.control.owner }) : t("no_control");
  if (running()) return jobKind() === (JOB_OF[kind] ?? kind) ? t("why_running") : t("busy_short", { kind: phrase(jobKind()) });
  if (kind === "accept") return accepted() ? t("why_accepted") : !lookFresh() ? t(state.look ? "why_look_again" : "why_no_look") : atGoal() ? "" : t("why_not_inside");
  if (kind === "reset") return "";
  if (kind === "look_again" && !state.panel.history.length) return t("why_first");
  if (["offline", "fault", "local"].includes(state.link.phase)) return t(`why_plc_${state.link.phase}`);
  if (SEES.has(kind) && blind()) return t("why_camera");
  const refusal = state.steps[JOB_OF[kind] ?? kind] ?? "";
  if (refusal) return phrase(refusal);
  if (["orient", "calibrate", "preview"].includes(kind) && !lookFresh()) return t(!state.look ? "why_no_look" : movedSince(state) ? "why_moved" : "why_look_old");
  if (kind === "preview" && !calibrated()) return t("why_calibrate_first");
  if (kind === "execute" && !planFresh()) return t(state.plan ? "why_expired" : "why_no_plan");
  return "";
}

// What comes next; "" while something runs, without control, or when all is done.
function nextStep() {
  if (serverSilent() || !haveControl(state) || running()) return "";
  if (state.link.phase === "fault") return "reset";
  if (state.steps.look || blind()) return "";
  if (accepted() && lookFresh()) return "retract";
  if (atGoal()) return "accept";
  if (planFresh() && !state.steps.execute) return "execute";
  if (!lookFresh()) return state.panel.history.length ? "look_again" : "look";
  if (!calibrated()) return state.look.error.rotation_deg > state.tolerance_deg ? "orient" : "calibrate";
  return "preview";
}

function hint(next) {
  if (serverSilent()) return t("why_server");
  if (holding()) return t("holding");
  if (running()) {
    const { kind, owner, events, elapsed_s } = state.job;
    return t("busy", { kind: phrase(kind), owner, text: events.findLast((event) => event.text)?.text ?? "", s: Math.round(elapsed_s) });
  }
  if (!haveControl(state)) return t("next", { what: t("take_control") });
  if (["offline", "fault", "local"].includes(state.link.phase)) return t(`hint_${state.link.phase}`);
  if (blind()) return t("hint_camera");
  if (next === "retract") return t("done");
  return next ? t("next", { what: t(`step_${next}`) }) : "";
}

function showPlan(plan) {
  const list = byId("plan");
  list.hidden = !plan;
  if (!plan) {
    delete list.dataset.hash;
    return;
  }
  const left = Math.max(0, Math.round(plan.expires_in_s));
  const rows = [
    ["plan", t("plan_text", { hash: plan.plan_hash.slice(0, 8), s: left })],
    ["path", t("path_text", { mm: plan.length_mm.toFixed(0), s: plan.duration_s.toFixed(1), v: plan.tcp_speed_max_mm_s.toFixed(0) })],
    ["clearance", plan.clearance_mm === null ? t("clearance_none") : t("clearance_text", { mm: plan.clearance_mm.toFixed(0) })],
    ["travel", plan.joint_travel_deg.map((deg, i) => `${state.joint_names[i] ?? i + 1} ${deg.toFixed(1)}°`).join(", ")],
    ["checks", t("checks_text")],
    ...(plan.caution ? [["caution", plan.caution]] : []),
  ];
  whenChanged("plan", rows, () => {
    list.replaceChildren(...rows.flatMap(([name, text]) => [make("dt", {}, t(name)), make("dd", { class: `v ${name === "caution" ? "caution" : ""}` }, text)]));
  });
  list.dataset.hash = plan.plan_hash;
}

function showGoal(goal) {
  for (const [id, name] of [["stand-off", "stand_off_mm"], ["offset-x", "offset_x_mm"], ["offset-y", "offset_y_mm"]]) {
    const field = byId(id);
    if (document.activeElement?.form !== byId("goal-form")) field.value = goal[name];
  }
}
