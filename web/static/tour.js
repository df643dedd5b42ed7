// The tour of the first visit: a strip of five sentences, each with its part of the page outlined. Nothing to dismiss.
import { byId, setText } from "./dom.js";
import { recall, remember } from "./memory.js";
import { t } from "./texts.js";

const SEEN = "longreach-tour-seen";
const PARTS = ["bar", "control", "steps", "errors", "steps"];
let at = 0;

export function startTour() {
  byId("tour-next").onclick = () => go(at + 1);
  byId("tour-end").onclick = () => go(PARTS.length);
  byId("tour-again").onclick = () => go(0);
  if (!recall(SEEN)) go(0);
}

function go(step) {
  at = step;
  for (const id of PARTS) byId(id).classList.remove("toured");
  const over = step >= PARTS.length;
  byId("tour").hidden = over;
  if (over) return remember(SEEN, "yes");
  setText(byId("tour-text"), t(`tour_${step + 1}`));
  byId(PARTS[step]).classList.add("toured");
}
