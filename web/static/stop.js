// STOP, by itself: it imports nothing and is wired before any other part of the page, so that no defect of another part
// takes it along. It is sent when the button is touched, not when the finger lifts, and its outcome is shown.
const AGAIN_MS = 150; // sent twice, in case one is lost on a dying connection
const PATIENCE_MS = 4000; // the server answers when the job has ended: within three seconds, or 503
const SHOWN_MS = 4000;
const button = document.getElementById("stop");
const status = document.getElementById("stop-status");
const unheard = document.getElementById("stop-unheard");
const WORDS = { calm: status.textContent, sent: "sent …", heard: "STOP received", unheard: "NOT CONFIRMED" };
const word = (key) => button.dataset[key] ?? WORDS[key]; // the page sets them in its language
const LINE_AGAIN_MS = 2000;
let line = null;
let latest = 0;
let calmTimer = 0;

// Needs nothing: no lease, no state.
export async function stop() {
  const mine = ++latest;
  say(word("sent"), "pressed");
  const impatient = setTimeout(() => report(mine, false), PATIENCE_MS);
  const heard = await Promise.any([...[0, AGAIN_MS].map(sent), overLine()]).catch(() => false);
  clearTimeout(impatient);
  report(mine, heard);
}

async function sent(wait) {
  await new Promise((over) => setTimeout(over, wait));
  const answer = await fetch("v1/stop", { method: "POST", keepalive: true });
  if (!answer.ok) throw new Error(String(answer.status));
  return true;
}

// A socket that is open already: a request waits in the browser as long as six others have no answer.
function open() {
  line = new WebSocket(new URL("v1/stop", document.baseURI.replace(/^http/, "ws")));
  line.addEventListener("close", () => setTimeout(open, LINE_AGAIN_MS));
}

function overLine() {
  const socket = line;
  if (socket.readyState !== WebSocket.OPEN) return Promise.reject(new Error("closed"));
  return new Promise((heard, lost) => {
    socket.addEventListener("message", ({ data }) => (data === "stopped" ? heard(true) : lost(new Error(data))), { once: true });
    socket.addEventListener("close", () => lost(new Error("closed")), { once: true });
    socket.send("stop");
  });
}

// That it was not heard stays in sight until one is.
function report(mine, heard) {
  if (mine !== latest) return;
  unheard.hidden = heard;
  say(word(heard ? "heard" : "unheard"), heard ? "heard" : "unheard");
  if (heard) calmTimer = setTimeout(() => say(word("calm"), ""), SHOWN_MS);
}

function say(text, state) {
  clearTimeout(calmTimer);
  status.textContent = text;
  button.dataset.state = state;
}

// A held button is released by this event; nothing here waits for it.
function halt() {
  stop();
  dispatchEvent(new Event("stop-pressed"));
}

open();
button.addEventListener("pointerdown", halt);
button.addEventListener("click", (event) => { if (event.detail === 0) halt(); }); // by Enter, Space or a screen reader
addEventListener("keydown", (event) => { if (event.key === "Escape" && !event.repeat) halt(); }, true);
// The 3D view has the keys while it has the focus: it sends its own STOP, and says so here.
addEventListener("message", (event) => { if (event.origin === location.origin && event.data === "stop") halt(); });
