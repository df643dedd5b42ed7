// The camera picture with what was found in that very picture. Only the newest frame is drawn.
import { LIMITS_MS, ageText, isOld, pageTime, serverSilent, stalePicture } from "./age.js";
import { address } from "./connection.js";
import { byId, setText } from "./dom.js";
import { t } from "./texts.js";

const AGAIN_MS = 1000;
const AXIS_COLORS = ["#ff6b6b", "#51d88a", "#5aa9ff"];
const canvas = byId("picture");
const context = canvas.getContext("2d", { willReadFrequently: true });
let shown = null; // header of the frame on the screen
let shownAt = -Infinity; // when it was exposed, on this page's clock
let waiting = null;
let drawn = 0;

const extras = []; // drawn over every picture

export const afterDrawing = (draw) => extras.push(draw);
export const shownHeader = () => shown;

// Call `act` with a clicked place, in px of the eye's full resolution.
export function pictureClick(act) {
  canvas.addEventListener("click", (event) => {
    if (!shown) return;
    const box = canvas.getBoundingClientRect();
    const scale = Math.min(box.width / canvas.width, box.height / canvas.height); // the picture is fitted into its box
    const u = (event.clientX - box.left - (box.width - canvas.width * scale) / 2) / scale;
    const v = (event.clientY - box.top - (box.height - canvas.height * scale) / 2) / scale;
    const full = shown.width_px / canvas.width;
    const at = [u * full - 0.5, v * full - 0.5];
    if (at[0] >= 0 && at[1] >= 0 && at[0] <= shown.width_px - 1 && at[1] <= shown.height_px - 1) act(at);
  });
}

export function startCamera() {
  const socket = new WebSocket(address("/v1/video"));
  socket.binaryType = "arraybuffer";
  let newest = -1; // of this connection: two may be decoded simultaneously, and end in the other order
  socket.onmessage = async (message) => {
    try {
      const frame = await decoded(message.data);
      if (frame.header.number < newest) return frame.bitmap.close();
      newest = frame.header.number;
      offer(frame);
    } catch (error) {
      reportError(error); // one bad picture; the next one is requested all the same
    } finally {
      if (socket.readyState === WebSocket.OPEN) socket.send("next");
    }
  };
  socket.onclose = () => setTimeout(startCamera, AGAIN_MS);
}

async function decoded(data) {
  const size = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 4 + size)], { type: "image/jpeg" }));
  return { header, bitmap, at: performance.now() - header.age_ms };
}

function offer(frame) {
  const first = waiting === null;
  waiting?.bitmap.close();
  waiting = frame;
  if (first) requestAnimationFrame(draw);
}

function draw() {
  const { header, bitmap, at } = waiting;
  waiting = null;
  if (canvas.width !== bitmap.width) Object.assign(canvas, { width: bitmap.width, height: bitmap.height });
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const scale = canvas.width / header.width_px;
  context.save();
  for (const polygon of header.masks_px ?? []) drawMask(polygon, scale);
  for (const marker of header.markers) drawMarker(marker, scale);
  if (header.goal) drawCross(header.goal, scale, t("legend_goal"), "#ffd84d", true);
  if (header.tool) drawCross(header.tool, scale, t("legend_tool"), "#ff8ad8", false);
  for (const extra of extras) extra(context, place(scale));
  context.restore();
  drawn += 1;
  Object.assign(canvas.dataset, { number: header.number, drawn });
  shown = header;
  shownAt = pageTime(header.exposure_mono_ms, at);
}

const place = (scale) => ([u, v]) => [(u + 0.5) * scale, (v + 0.5) * scale];

// Where nothing of the scene is looked for: the machine itself, as the settings have it.
function drawMask(polygon, scale) {
  context.beginPath();
  polygon.map(place(scale)).forEach(([u, v], i) => (i ? context.lineTo(u, v) : context.moveTo(u, v)));
  context.closePath();
  context.fillStyle = "#0d1b2a80";
  context.fill();
  context.setLineDash([10, 6]);
  context.lineWidth = 2;
  context.strokeStyle = "#aab4b9";
  context.stroke();
  context.setLineDash([]);
}

function drawMarker(marker, scale) {
  const points = marker.corners_px.map(place(scale));
  const color = marker.used ? "#35e08a" : "#aab4b9";
  context.setLineDash(marker.used ? [] : [6, 4]);
  context.lineWidth = 2.5;
  context.strokeStyle = color;
  context.beginPath();
  points.forEach(([u, v], i) => (i ? context.lineTo(u, v) : context.moveTo(u, v)));
  context.closePath();
  context.stroke();
  context.setLineDash([]);
  const text = marker.used ? `${marker.marker_id}  ${marker.residual_px.toFixed(2)} px` : `${marker.marker_id} ${marker.reason || t("marker_unused")}`;
  const u = Math.min(...points.map((p) => p[0]));
  const v = Math.min(...points.map((p) => p[1])) - 7;
  label(text.slice(0, 60), u, v, marker.used ? "#d6ffe9" : "#dde3e6");
}

function drawCross({ origin_px, axes_px }, scale, text, color, ring) {
  const [u, v] = place(scale)(origin_px);
  axes_px.map(place(scale)).forEach(([x, y], i) => {
    context.strokeStyle = AXIS_COLORS[i];
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(u, v);
    context.lineTo(x, y);
    context.stroke();
  });
  context.strokeStyle = color;
  context.lineWidth = 3;
  context.beginPath();
  if (ring) context.arc(u, v, 14, 0, 2 * Math.PI);
  else context.rect(u - 9, v - 9, 18, 18);
  context.stroke();
  label(text, u + 18, v + (ring ? 26 : -14), color);
}

function label(text, u, v, color) {
  context.font = `600 ${Math.max(13, canvas.width / 68)}px system-ui, "DejaVu Sans", sans-serif`;
  context.lineWidth = 4;
  context.strokeStyle = "#000d";
  context.strokeText(text, u, Math.max(16, v));
  context.fillStyle = color;
  context.fillText(text, u, Math.max(16, v));
}

// Called several times a second, also when no frame comes: the veil and the age must not wait for one.
export function showCameraAge(state) {
  const age = shown ? performance.now() - shownAt : null;
  const old = age === null || age > LIMITS_MS.camera || serverSilent();
  const frozen = old ? "" : stalePicture(shown.warnings);
  const alarm = state?.panel.alarms.find((one) => one.code === "camera_unfit" && one.ended_unix_s === null);
  const veil = byId("veil");
  veil.hidden = !(old || frozen);
  if (old) setText(veil, age === null ? t("veil_none") : `${t("veil_old", { age: ageText(age) })}\n${t(whyOld(state))}`);
  else if (frozen) setText(veil, `${t("frozen", { age: ageText(alarm && state ? 1000 * (state.panel.unix_s - alarm.since_unix_s) : 0) })}\n${frozen}`);
  const strip = byId("picture-warning");
  const warning = !old && !frozen ? shown.warnings.at(-1) ?? "" : "";
  strip.hidden = !warning;
  setText(strip, warning);
  const text = age === null ? t("veil_none") : t("frame_age", { fps: shown.fps.toFixed(0), age: ageText(age) });
  setText(byId("camera-age"), text);
  byId("camera-age").classList.toggle("old", old);
}

function whyOld(state) {
  if (serverSilent()) return "veil_server";
  return state && !isOld(state.camera.age_ms, LIMITS_MS.camera) ? "veil_way" : "veil_camera";
}

export function describePicture(state) {
  if (!shown) return;
  const used = shown.markers.filter((marker) => marker.used).length;
  const error = state.live_error;
  const text = error ? `${t("axis_norm")} ${error.distance_mm.toFixed(0)} mm` : t("not_seen");
  const label = t("picture_label", { n: used, text });
  if (canvas.getAttribute("aria-label") !== label) canvas.setAttribute("aria-label", label);
}
