// A viewer by Foxglove's own client library (npm's @foxglove/ws-protocol): the first message of each topic on a line of its
// own, as JSON; with "stall" it subscribes and then reads nothing any more.
import { createRequire } from "node:module";

const [folder, port, topics, stall] = process.argv.slice(2);
const require = createRequire(`${folder}/package.json`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = globalThis.WebSocket ?? require("ws"); // Node has its own from version 22 on
const names = [FoxgloveClient.SUPPORTED_SUBPROTOCOL, "foxglove.sdk.v1"];
const socket = new WebSocket(`ws://127.0.0.1:${port}`, names);
const client = new FoxgloveClient({ ws: socket });
const subscribed = new Map();
const wanted = new Set(topics.split(","));
const print = (value) => process.stdout.write(JSON.stringify(value) + "\n");

client.on("error", (error) => print({ error: String(error) }));
client.on("serverInfo", (info) => print({ server: info.name, protocol: socket.protocol, capabilities: info.capabilities }));
client.on("advertise", (channels) => {
  for (const channel of channels) subscribed.set(client.subscribe(channel.id), channel);
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const { topic, schemaName, encoding } = subscribed.get(subscriptionId);
  if (!wanted.delete(topic)) return;
  const base64 = Buffer.from(data.buffer, data.byteOffset, data.byteLength).toString("base64");
  print({ topic, schemaName, encoding, timestamp: String(timestamp), base64 });
  if (wanted.size) return;
  if (stall) Atomics.wait(new Int32Array(new SharedArrayBuffer(4)), 0, 0); // for ever: the socket is read no more
  client.close();
});
