// The page: one live socket in, REST out. Every command goes through startJob or stop.
import { drawPicture, noPicture } from "./picture.js";
import { showErrors } from "./errors.js";
import { showSteps, onStep } from "./steps.js";
import { showBar, showJoints, showStory } from "./status.js";

const STATE_OLD_MS = 1000;
let state = null;
let heardAt = 0;

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/v1/live`);
  socket.binaryType = "blob";
  socket.onmessage = async (message) => {
    heardAt = performance.now();
    if (typeof message.data === "string") {
      state = JSON.parse(message.data);
      show();
    } else if (state) {
      drawPicture(await createImageBitmap(message.data), state);
    }
  };
  socket.onclose = () => setTimeout(connect, 1000);
}

function show() {
  showBar(state);
  showErrors(state);
  showSteps(state);
  showStory(state);
  showJoints(state);
  if (state.camera.age_ms === null || state.camera.age_ms > STATE_OLD_MS) noPicture(state.camera);
}

async function post(path, body) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body ?? {}),
  });
  if (!answer.ok) {
    const problem = await answer.json().catch(() => ({ detail: `${answer.status} ${answer.statusText}` }));
    alarm(problem.detail);
  } else {
    alarm("");
  }
}

function alarm(text) {
  const line = document.getElementById("alarm");
  line.hidden = !text;
  line.textContent = text;
}

onStep((kind) => {
  const body = { kind, owner: "operator" };
  if (kind === "execute") body.plan_hash = state.plan.plan_hash;
  post("/v1/jobs", body);
});
document.getElementById("stop").onclick = () => post("/v1/stop");

setInterval(() => {
  const silent = performance.now() - heardAt > STATE_OLD_MS;
  document.body.classList.toggle("silent", silent);
  if (silent) {
    alarm("The server does not answer: nothing on this page is current. The PLC stops by itself when the link is silent.");
    noPicture({ warnings: ["server silent"] });
  } else if (document.getElementById("alarm").textContent.startsWith("The server does not answer")) {
    alarm("");
  }
}, 300);
connect();
