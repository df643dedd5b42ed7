// The live socket: states in, wishes about the view out. It reconnects for ever.
import { forgetClock, heard } from "./age.js";

const AGAIN_MS = 1000;
export const address = (path) => `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;

export class Live {
  constructor(onState) {
    this.onState = onState;
    this.open();
  }

  open() {
    this.socket = new WebSocket(address("/v1/live"));
    this.socket.onopen = forgetClock;
    this.socket.onmessage = (message) => {
      const state = JSON.parse(message.data);
      heard(state.panel.mono_ms);
      this.onState(state);
      this.send({ seen: true }); // after it was shown: who is slow is sent less
    };
    this.socket.onclose = () => setTimeout(() => this.open(), AGAIN_MS);
  }

  send(wish) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(wish));
  }
}
