// Jog: one joint or one axis of the tool, slowly, only while its button is held. In SIM too: a click does nothing.
import { byId, make, setClass, setText, whenChanged } from "./dom.js";
import { heldKind, holdButton } from "./hold.js";
import { reason } from "./steps.js";
import { t } from "./texts.js";

const TOOL_AXES = ["x", "y", "z", "rx", "ry", "rz"];
const ends = [];

export function startJog() {
  for (const direction of [-1, 1]) {
    const button = make("button", { type: "button", class: "jog", "data-jog": String(direction) }, "");
    holdButton(button, () => true, () => ({ kind: "jog", axis: byId("jog-axis").value, direction }));
    ends.push(button);
  }
  byId("jog-buttons").replaceChildren(...ends);
  byId("jog-axis").onchange = name;
}

export function showJog(state) {
  whenChanged("jog-axis", state.joint_names, (box) => {
    const joints = state.joint_names.map((joint, i) => make("option", { value: `joint_${i + 1}` }, t("jog_joint", { n: i + 1, joint })));
    const tool = state.joint_names.length < 6 ? [] : TOOL_AXES.map((axis) => make("option", { value: axis }, t(`jog_${axis}`)));
    box.replaceChildren(...joints, ...tool);
    name();
  });
  const why = reason("jog");
  for (const button of ends) {
    const disabled = why !== "" && heldKind() !== "jog"; // a button that is disabled under the finger would lose it
    if (button.disabled !== disabled) button.disabled = disabled;
  }
  byId("jog-axis").disabled = heldKind() === "jog"; // what is held does not change under the finger
  const running = state.job?.kind === "jog" && ["running", "stopping"].includes(state.job.state);
  setClass(byId("jog"), "running", running);
  setText(byId("jog-why"), running ? limit(state.job) || t("jog_running") : why || t("jog_about"));
  setText(byId("jog-now"), range(state));
}

// What ends a held motion before the button comes up, as soon as the server has planned it.
function limit(job) {
  return job.events.findLast((event) => event.name === "jog_limit")?.text ?? "";
}

// Where the chosen joint is and how far it may go; nothing for an axis of the tool.
function range(state) {
  const i = state.joint_names.findIndex((_, n) => byId("jog-axis").value === `joint_${n + 1}`);
  if (i < 0) return "";
  const [now, low, high] = [state.q_deg[i], state.q_min_deg[i], state.q_max_deg[i]];
  return now === undefined ? "" : t("jog_now", { now: now.toFixed(1), low: low.toFixed(0), high: high.toFixed(0) });
}

// The name of a button holds its axis: a screen reader says what will move.
function name() {
  const chosen = byId("jog-axis").selectedOptions[0]?.textContent ?? "";
  for (const button of ends) {
    const sign = button.dataset.jog === "1" ? "+" : "−";
    setText(button, sign);
    button.setAttribute("aria-label", t("jog_hold", { axis: chosen, sign: t(sign === "+" ? "jog_plus" : "jog_minus") }));
  }
}
