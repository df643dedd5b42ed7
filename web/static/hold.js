// Hold-to-run: motion only while the button is down and this page answers every challenge.
import { getLease, notice } from "./commands.js";
import { address } from "./connection.js";
import { stop } from "./stop.js";
import { t } from "./texts.js";

let held = null; // the one press that is on

export const holding = () => held !== null && !held.up;
export const heldKind = () => held?.kind ?? "";

export function press(body) {
  if (!getLease()) return;
  if (held) return held.up ? notice(t("hold_again")) : undefined;
  const { lease_id, fencing } = getLease();
  const socket = new WebSocket(address("/v1/hold"));
  const mine = { socket, kind: body.kind, bond: "", open: false, up: "" };
  held = mine;
  document.body.classList.add("holding");
  socket.onopen = () => {
    if (mine.up) return socket.close(); // let go before it was open: nothing begins
    mine.open = true;
    socket.send(JSON.stringify({ press: body, lease_id, fencing }));
  };
  socket.onmessage = (message) => take(mine, JSON.parse(message.data));
  socket.onclose = () => end(mine);
}

function take(mine, message) {
  if (message.bond !== undefined) mine.bond = message.bond;
  if (message.challenge && !mine.up) {
    const { seq, nonce } = message.challenge;
    mine.socket.send(JSON.stringify({ seq, reply: ~nonce >>> 0, bond: mine.bond }));
  }
  if (message.refused !== undefined) notice(t("refused", { why: message.refused }));
  // Letting go needs no words, and no line that moves the page under the finger.
  if (message.ended === "failed" || (message.ended === "stopped" && mine.up !== "button up")) notice(t("hold_ended", { why: message.reason }));
  else if (message.ended === "done" && mine.kind === "jog") notice(t("jog_done", { why: message.reason })); // while still held
}

function end(mine) {
  if (held !== mine) return;
  held = null;
  document.body.classList.remove("holding");
}

// Every way of letting go. The socket informs the server immediately; the plain stop is sent as well.
export function release(why) {
  const mine = held;
  if (!mine || mine.up) return;
  mine.up = why;
  if (mine.open) {
    if (mine.socket.readyState === WebSocket.OPEN) mine.socket.send(JSON.stringify({ release: why }));
    if (why !== "button up" && why !== "STOP pressed") stop();
  }
  setTimeout(() => mine.socket.close(), 1500);
  document.body.classList.remove("holding");
}

export function watchHold() {
  addEventListener("stop-pressed", () => release("STOP pressed"));
  addEventListener("pointerup", () => release("button up"));
  addEventListener("pointercancel", () => release("pointer cancelled"));
  addEventListener("blur", () => release("window lost focus"));
  addEventListener("beforeunload", () => release("page left")); // the first word of a tab that is being closed
  addEventListener("pagehide", () => release("page left"));
  addEventListener("visibilitychange", () => { if (document.hidden) release("tab hidden"); });
  addEventListener("keyup", () => release("button up"));
  addEventListener("contextmenu", (event) => { if (held) event.preventDefault(); });
}

// Make a button one that is held: pointer or Space/Enter down presses, letting go anywhere releases.
export function holdButton(button, isHold, body) {
  button.addEventListener("pointerdown", (event) => {
    if (!isHold() || button.disabled || event.button !== 0) return;
    event.preventDefault();
    button.focus();
    button.setPointerCapture(event.pointerId);
    press(body());
  });
  button.addEventListener("lostpointercapture", () => release("button up"));
  button.addEventListener("keydown", (event) => {
    if (!isHold() || button.disabled || ![" ", "Enter"].includes(event.key)) return;
    event.preventDefault();
    if (!event.repeat) press(body());
  });
}
