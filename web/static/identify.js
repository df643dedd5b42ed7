// Identify this machine: what the drive will do, the drive, the version in use effect by effect, and what it changed.
import { send } from "./commands.js";
import { byId, make, setText, whenChanged } from "./dom.js";
import { heldKind, holdButton } from "./hold.js";
import { mustHold } from "./steps.js";
import { t } from "./texts.js";

const AGAIN_MS = 1000;
let timer = 0;
let plan = null; // as the last plan_identify reported it, until it is driven
let driveButton = null;

export function closeIdentify() {
  clearTimeout(timer);
}

export async function openIdentify() {
  byId("identify-plan").onclick = () => makePlan(false);
  byId("identify-rest").onclick = () => makePlan(true);
  await followIdentify();
}

async function makePlan(resume) {
  const body = { kind: "plan_identify", minutes: Number(byId("identify-minutes").value), wall_free: byId("identify-free").checked, resume };
  plan = null;
  await send("POST", "/v1/jobs", body);
  followIdentify();
}

const driveBody = () => ({ kind: "identify", plan_hash: plan?.plan_hash ?? "" });

async function drive() {
  await send("POST", "/v1/jobs", driveBody());
  followIdentify();
}

export async function followIdentify() {
  clearTimeout(timer);
  const [session, versions, jobs] = await Promise.all(["/v1/identification", "/v1/machine/versions", "/v1/jobs"].map((path) => send("GET", path, undefined, { quiet: true })));
  byId("identify").hidden = session.status === 404;
  if (!session.ok || !versions.ok || !jobs.ok) return again(session.status !== 404);
  const last = jobs.data.findLast((one) => ["identify", "plan_identify"].includes(one.kind));
  const job = last ? (await send("GET", `/v1/jobs/${last.job_id}`, undefined, { quiet: true })).data : null;
  const running = ["running", "stopping"].includes(job?.state);
  if (job?.kind === "plan_identify" && job.state === "done") plan = job.result;
  if (job?.kind === "identify") plan = null; // a plan fires once
  showPlan(running);
  showProgress(job, session.data, running);
  showVersions(versions.data);
  again(true);
}

function again(wanted) {
  if (wanted) timer = setTimeout(followIdentify, AGAIN_MS);
}

function showPlan(running) {
  byId("identify-plan").disabled = running;
  whenChanged("identify-plan-facts", [plan?.plan_hash], (box) => {
    box.hidden = !plan;
    driveButton = null;
    if (!plan) return box.replaceChildren();
    const button = make("button", { type: "button", id: "identify-drive", class: "step" }, make("b", {}, t("identify_drive")), make("small", { class: "about" }, mustHold() ? t("identify_held") : t("identify_clicked")));
    button.onclick = (event) => { if (!mustHold() && event.detail <= 1) drive(); };
    holdButton(button, mustHold, driveBody);
    driveButton = button;
    const facts = t("identify_facts", { min: (plan.duration_s / 60).toFixed(1), looks: plan.looks, v: plan.tcp_speed_max_mm_s.toFixed(0), clear: plan.clearance_mm === null ? "?" : plan.clearance_mm.toFixed(0) });
    const rows = plan.parts.map((part) => make("tr", {}, make("td", {}, part.name), make("td", {}, `${part.duration_s.toFixed(0)} s`), make("td", {}, part.shows.join(", ")), make("td", { class: "soft" }, part.cannot)));
    box.replaceChildren(
      make("p", {}, make("b", {}, facts)),
      ...(plan.caution ? [make("p", { class: "caution" }, plan.caution)] : []),
      make("table", {}, head(["identify_part", "identify_lasts", "identify_shows", "identify_cannot"]), make("tbody", {}, ...rows)),
      ...plan.cannot.map((text) => make("p", { class: "soft" }, text)),
      button,
    );
  });
  if (driveButton) driveButton.disabled = running && heldKind() !== "identify"; // disabled under the finger it is lost
}

function showProgress(job, session, running) {
  const driving = running && job.kind === "identify";
  const all = session.parts_done.length + session.parts_left.length;
  byId("identify-progress").hidden = !driving;
  byId("identify-bar").max = Math.max(1, all);
  byId("identify-bar").value = session.parts_done.length;
  const failed = job && !running && job.state === "failed" ? job.reason : "";
  const text = running ? job.events.findLast((one) => one.text)?.text ?? "" : failed || session.next_step;
  setText(byId("identify-line"), text);
  byId("identify-rest").hidden = running || !session.next_step.startsWith("paused");
}

const head = (keys) => make("thead", {}, make("tr", {}, ...keys.map((key) => make("th", { scope: "col" }, key ? t(key) : ""))));

// The version in use, or the newest one: each effect with what it changes, and a switch.
function showVersions({ in_use, problem, versions, compared }) {
  const one = versions.find((each) => each.version_id === in_use) ?? versions[0];
  whenChanged("identify-versions", [in_use, problem, versions, compared], (box) => {
    box.replaceChildren();
    if (problem) box.append(make("p", { class: "bad" }, problem));
    if (!one) return;
    const used = one.version_id === in_use;
    const when = new Date(1000 * one.made_unix_s).toLocaleString();
    const boxes = one.effects.map((effect) => make("input", { type: "checkbox", checked: effect.on, "aria-label": nameOf(effect) }));
    const rows = one.effects.map((effect, k) => make("tr", {}, make("td", {}, boxes[k]), make("td", {}, nameOf(effect)), make("td", {}, `${effect.tool_mm.toPrecision(2)} mm`), make("td", {}, effect.does || t("identify_sim_only"))));
    const put = (version_id, on) => send("PUT", "/v1/machine/in-use", { version_id, on }).then(followIdentify);
    box.append(
      make("h3", {}, t(used ? "identify_in_use" : "identify_kept", { when, serial: one.serial || one.machine })),
      make("p", {}, one.sentence),
      make("table", {}, head(["", "gap_cause", "gap_tool", "identify_does"]), make("tbody", {}, ...rows)),
      make("div", { class: "row" },
        make("button", { type: "button", id: "identify-use", onclick: () => put(one.version_id, boxes.map((each) => each.checked)) }, t(used ? "identify_apply" : "identify_use")),
        make("button", { type: "button", id: "identify-off", disabled: !used, onclick: () => put("", null) }, t("identify_off")),
        make("a", { href: `v1/machine/versions/${one.version_id}/file`, download: true }, t("identify_file"))),
    );
    if (compared.length) box.append(...comparison(compared));
  });
}

function comparison(compared) {
  const rows = compared.slice(-6).map((one) => make("tr", {}, make("td", {}, one.number), make("td", {}, `${one.nominal_mm.toFixed(1)} mm`), make("td", {}, one.in_use_mm === null ? "–" : `${one.in_use_mm.toFixed(1)} mm`)));
  return [make("h3", {}, t("identify_compare")), make("p", { class: "soft" }, t("identify_compare_about")), make("table", { id: "identify-compared" }, head(["identify_move", "identify_nominal", "identify_with"]), make("tbody", {}, ...rows))];
}

const nameOf = ({ name, joint }) => (joint ? t("gap_joint", { name, joint }) : name);

// For a finished budget: keep its effects as a version, and use it.
export function useButton({ diagnosis_id }, { budget }) {
  if (!budget?.effects.some((one) => one.status === "confirmed")) return [];
  const use = async () => {
    const { ok, data } = await send("POST", "/v1/machine/versions", { diagnosis_id });
    if (ok) await send("PUT", "/v1/machine/in-use", { version_id: data.version_id });
    followIdentify();
  };
  return [make("button", { type: "button", class: "use-effects", onclick: use }, t("identify_use"))];
}

// The miss, what each confirmed effect takes off it (by its share of the squared miss), and what is left.
export function waterfall({ miss_mm, left_mm, effects }) {
  const sure = effects.filter((one) => one.status === "confirmed" && one.column !== "sees" && one.share_frac > 0);
  if (!sure.length || !(miss_mm > 0)) return [];
  let rest = miss_mm ** 2;
  const rows = [row(t("identify_miss"), 0, miss_mm, miss_mm)];
  for (const one of sure) {
    const from = Math.sqrt(rest);
    rest = Math.max(0, rest - one.share_frac * miss_mm ** 2);
    rows.push(row(nameOf(one), Math.sqrt(rest), from, miss_mm));
  }
  rows.push(row(t("identify_left"), 0, left_mm, miss_mm));
  return [make("table", { class: "waterfall" }, make("tbody", {}, ...rows))];
}

function row(name, from, to, most) {
  const bar = make("span", { class: "fall" });
  bar.style.marginLeft = `${(100 * from) / most}%`;
  bar.style.width = `${(100 * Math.max(0, to - from)) / most}%`;
  return make("tr", {}, make("td", {}, name), make("td", { class: "fall-cell" }, bar), make("td", {}, `${(to - from).toFixed(1)} mm`));
}
