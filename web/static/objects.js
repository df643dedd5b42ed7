// Taught objects: views taken of an object next to the markers, taught under a name, chosen without the markers.
import { shownHeader } from "./camera.js";
import { send } from "./commands.js";
import { byId, make, setText } from "./dom.js";
import { t } from "./texts.js";

const PATH = "/v1/target/objects";
const FIELDS = ["object-x", "object-y", "object-z", "object-width", "object-height", "object-depth"];

export function startObjects() {
  byId("object-view").onclick = takeView;
  byId("object-teach").onclick = async () => take(await send("POST", PATH, { name: byId("object-name").value }));
  byId("object-forget").onclick = async () => take(await send("DELETE", `${PATH}/views`));
  byId("object-use").onclick = async () => take(await send("POST", `${PATH}/${chosen()}/use`));
  byId("object-remove").onclick = async () => take(await send("DELETE", `${PATH}/${chosen()}`));
  byId("objects").ontoggle = read;
}

async function read() {
  if (byId("objects").open) take(await send("GET", PATH, undefined, { quiet: true }));
}

async function takeView() {
  const header = shownHeader();
  if (!header) return;
  const numbers = FIELDS.map((id) => Number(byId(id).value));
  setText(byId("object-line"), t("target_measuring"));
  const answer = await send("POST", `${PATH}/views`, { image: header.number, centre_mm: numbers.slice(0, 3), size_mm: numbers.slice(3) });
  if (answer.ok) take(answer);
  else read();
}

const chosen = () => encodeURIComponent(byId("object-list").value);

function take(answer) {
  if (!answer.ok) return;
  const { names, in_use: used, view_landmarks: views } = answer.data;
  const list = byId("object-list"), before = list.value;
  list.replaceChildren(...names.map((name) => make("option", { value: name, selected: name === (used || before) }, name)));
  for (const id of ["object-use", "object-remove"]) byId(id).disabled = !names.length;
  byId("object-teach").disabled = views.length < 2;
  const seen = views.length ? t("object_views", { n: views.length, marks: views.join(", ") }) : t("object_no_views");
  setText(byId("object-line"), used ? t("object_in_use", { name: used }) : seen);
}
