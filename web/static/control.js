// Who has control: take, keep alive, release, ask, hand over. The secret stays in this page's memory: a copy of the
// tab, or the same page reloaded, has none.
import { getLease, notice, send, setLease } from "./commands.js";
import { byId, make, setClass, setText, whenChanged } from "./dom.js";
import { serverSilent } from "./age.js";
import { recall, remember } from "./memory.js";
import { t } from "./texts.js";

const TTL_S = 10;
const KEEP_MS = 3000;
const NAME = "longreach-name";
const TAKE_REASON = "taken over at the panel"; // for the audit, which is English

export function myName() {
  const field = byId("name");
  return field.value.trim() || field.placeholder;
}

export function startControl() {
  const field = byId("name");
  field.placeholder = `operator-${Math.floor(Math.random() * 0xffff).toString(16).padStart(4, "0")}`;
  field.value = recall(NAME);
  field.onchange = () => remember(NAME, field.value.trim());
  setInterval(keepAlive, KEEP_MS);
  addEventListener("pagehide", () => {
    if (getLease()) fetch(`v1/lease/${getLease().lease_id}`, { method: "DELETE", keepalive: true }).catch(() => {});
    setLease(null);
  });
}

export const haveControl = (state) => Boolean(getLease()) && state.control.fencing === getLease().fencing && !state.control.stale;

async function keepAlive() {
  const lease = getLease();
  if (!lease) return;
  const { ok, status, data } = await send("PUT", `/v1/lease/${lease.lease_id}`, undefined, { quiet: true });
  if (ok || status === 0 || getLease() !== lease) return;
  setLease(null);
  notice(t("control_lost", { why: data?.detail ?? "" }));
}

async function acquire() {
  const { ok, data } = await send("POST", "/v1/lease", { owner: myName(), kind: "operator", ttl_s: TTL_S });
  if (ok) setLease(data);
}

async function takeOver() {
  const { ok, data } = await send("POST", "/v1/lease/take", { owner: myName(), kind: "operator", ttl_s: TTL_S, reason: TAKE_REASON });
  if (ok) setLease(data);
}

async function release() {
  const lease = getLease();
  setLease(null);
  await send("DELETE", `/v1/lease/${lease.lease_id}`);
}

async function ask(owner) {
  const { ok } = await send("POST", "/v1/lease/ask", { owner: myName() });
  if (ok) notice(t("asked_sent", { owner }));
}

const grant = (to) => send("POST", `/v1/lease/${getLease().lease_id}/grant`, { to });

export function showControl(state) {
  const control = state.control;
  const mine = haveControl(state);
  const free = !control.owner || control.stale;
  const offered = control.offered_to === myName();
  setText(byId("holder"), mine ? t("control_you") : free ? t("control_none") : t("control_other", { owner: control.owner }));
  setText(byId("holder-left"), holderLeft(control, mine, offered));
  setClass(byId("control"), "mine", mine);
  byId("name-field").hidden = mine;
  whenChanged("control-buttons", [mine, free, offered, control.owner, control.asked_by], (box) => {
    box.replaceChildren(...buttons(control, mine, free, offered));
  });
}

function holderLeft(control, mine, offered) {
  if (serverSilent()) return t("why_server");
  if (offered) return t("offered");
  if (mine) return control.asked_by.length ? t("asked", { owner: control.asked_by.at(-1) }) : t("control_kept");
  if (!control.owner) return "";
  return control.stale ? t("control_stale") : t("control_left", { s: Math.round(control.expires_in_s ?? 0) });
}

// The box is redrawn under the pointer: the second half of a double click on "Take control" must not be "Release".
let asking = false;
async function once(event, act) {
  if (asking || event.detail > 1) return;
  asking = true;
  await act().finally(() => { asking = false; });
}

function buttons(control, mine, free, offered) {
  const button = (key, act, kind = "", values = {}) => make("button", { class: kind, onclick: (event) => once(event, act), type: "button" }, t(key, values));
  if (mine) {
    const requests = control.asked_by.slice(-1).map((owner) => button("hand_over", () => grant(owner), "", { owner }));
    return [...requests, button("release", release)];
  }
  if (free || offered) return [button("take_control", acquire, "primary")];
  return [button("ask", () => ask(control.owner)), button("take_over", takeOver, "grave")];
}
