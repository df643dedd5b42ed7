// The live socket: states in, requests about the view out. It reconnects for ever.
import { forgetClock, heard } from "./age.js";

const AGAIN_MS = 1000;
const SILENT_MS = 5000; // a cut leaves a socket open that nothing comes through any more
const UNAUTHORIZED = 401;
// As this page is reached: a proxy may have put it under a path of its own.
export const address = (path) => new URL(`.${path}`, document.baseURI.replace(/^http/, "ws")).href;

export class Live {
  constructor(onState) {
    this.onState = onState;
    this.refused = false; // whether the server answers and knows this page's session no more
    this.open();
    setInterval(() => this.watch(), AGAIN_MS);
  }

  open() {
    const socket = new WebSocket(address("/v1/live"));
    this.socket = socket;
    this.last = performance.now();
    socket.onopen = () => {
      this.refused = false;
      forgetClock();
    };
    socket.onmessage = (message) => {
      this.last = performance.now();
      const state = JSON.parse(message.data);
      heard(state.panel.mono_ms);
      this.onState(state);
      this.send({ seen: true }); // after it was shown: who is slow is sent less
    };
    socket.onclose = async () => {
      this.refused = await sessionEnded();
      setTimeout(() => { if (this.socket === socket) this.open(); }, AGAIN_MS);
    };
  }

  watch() {
    if (this.socket.readyState !== WebSocket.OPEN || performance.now() - this.last < SILENT_MS) return;
    this.socket.onclose = null; // its closing handshake would wait for the cut
    this.socket.close();
    this.open();
  }

  send(request) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }
}

// A refused socket gives the page no reason; the session does.
async function sessionEnded() {
  const answer = await fetch("v1/session").catch(() => null);
  return answer !== null && answer.status === UNAUTHORIZED;
}
