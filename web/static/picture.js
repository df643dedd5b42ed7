// The camera picture with what the detector found in it.
const FULL_WIDTH = 1280;
const canvas = document.getElementById("picture");
const veil = document.getElementById("veil");

export function drawPicture(bitmap, state) {
  const context = canvas.getContext("2d");
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const scale = canvas.width / FULL_WIDTH;
  for (const marker of state.markers) drawMarker(context, marker, scale);
  veil.hidden = true;
  document.getElementById("camera-age").textContent = `${state.camera.fps.toFixed(0)} pairs/s, ${Math.round(state.camera.age_ms)} ms old`;
}

export function noPicture(camera) {
  veil.hidden = false;
  veil.textContent = camera.warnings.at(-1) ?? "no current image";
}

function drawMarker(context, marker, scale) {
  const points = marker.corners_px.map(([u, v]) => [(u + 0.5) * scale, (v + 0.5) * scale]);
  context.lineWidth = 2.5;
  context.strokeStyle = marker.used ? "#35e08a" : "#aab4b9";
  context.beginPath();
  points.forEach(([u, v], i) => (i ? context.lineTo(u, v) : context.moveTo(u, v)));
  context.closePath();
  context.stroke();
  context.fillStyle = "#ff5d52";
  context.fillRect(points[0][0] - 3, points[0][1] - 3, 6, 6);
  const text = marker.used ? `${marker.marker_id}  ${marker.residual_px.toFixed(2)} px` : `${marker.marker_id} not used`;
  const u = Math.min(...points.map((p) => p[0]));
  const v = Math.min(...points.map((p) => p[1])) - 8;
  context.font = "600 15px system-ui, sans-serif";
  context.lineWidth = 4;
  context.strokeStyle = "#000c";
  context.strokeText(text, u, v);
  context.fillStyle = marker.used ? "#d6ffe9" : "#dde3e6";
  context.fillText(text, u, v);
}
