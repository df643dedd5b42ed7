// Boreholes and rings: found in the shown picture, numbered there, chosen by a click on one.
import { shownHeader } from "./camera.js";
import { send } from "./commands.js";
import { byId } from "./dom.js";

const NEAR_PX = 12; // a finger's click next to a small mark still means it
let marks = [];

// Search the shown picture for the diameters in the field; returns the answer, or null when the server refused.
export async function findMarks() {
  const header = shownHeader();
  const diameters_mm = byId("mark-diameters").value.split(/[\s,;]+/).filter(Boolean).map(Number);
  if (!header) return null;
  const answer = await send("POST", "/v1/target/marks", { image: header.number, diameters_mm });
  marks = answer.ok ? answer.data.marks : [];
  return answer.ok ? answer.data : null;
}

export const forgetMarks = () => { marks = []; };

// The mark whose rim, or a finger's width around its centre, holds the place; undefined where there is none.
export function markAt([u, v]) {
  const far = ({ patch }) => Math.hypot(patch.u_px - u, patch.v_px - v);
  const reach = ({ patch }) => Math.max(NEAR_PX, ...patch.outline_px.map(([x, y]) => Math.hypot(patch.u_px - x, patch.v_px - y)));
  return marks.filter((mark) => far(mark) <= reach(mark)).sort((a, b) => far(a) - far(b))[0];
}

export function drawMarks(context, place, chosen) {
  context.font = `600 ${Math.max(15, context.canvas.width / 55)}px system-ui, "DejaVu Sans", sans-serif`;
  for (const { number, patch } of marks) {
    const color = patch.status !== "ok" ? "#aab4b9" : patch.target_id === chosen ? "#ffd84d" : "#35e08a";
    context.strokeStyle = color;
    context.lineWidth = 2.5;
    context.beginPath();
    patch.outline_px.map(place).forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.stroke();
    const [u, v] = place([patch.u_px, patch.v_px]);
    context.lineWidth = 4;
    context.strokeStyle = "#000d";
    context.strokeText(number, u - 5, v + 6);
    context.fillStyle = color;
    context.fillText(number, u - 5, v + 6);
  }
}
