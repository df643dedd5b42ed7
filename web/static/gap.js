// Gap diagnosis: choose a recording, follow the run, read the result in words. It moves nothing.
import { send } from "./commands.js";
import { byId, make, setText, whenChanged } from "./dom.js";
import { closeIdentify, openIdentify, useButton, waterfall } from "./identify.js";
import { t } from "./texts.js";

const AGAIN_MS = 1500;
const IDLE_MS = 5000;
const SHOWN = 14; // effects
const WORDS = new Set(["none", "effects", "partly", "outside", "undecided"]);
const STILL = /-(look|preview)-/; // recordings of jobs that move nothing
const results = new Map(); // diagnosis id -> answer, once it is done
let timer = 0;

export function closeGap() {
  closeIdentify();
  clearTimeout(timer);
}

export async function openGap() {
  const recordings = await send("GET", "/v1/panel/recordings", undefined, { quiet: true });
  const names = (recordings.data ?? []).map((one) => ({ name: one.name, text: `${one.name} (${one.size_mb.toFixed(1)} MB)` }));
  const moved = names.find((one) => !STILL.test(one.name)) ?? names[0]; // a look alone shows next to nothing of a machine
  whenChanged("gap-run", names, (box) => {
    box.replaceChildren(...names.map((one) => make("option", { value: one.name }, one.text)));
    if (moved) box.value = moved.name;
  });
  byId("gap-start").onclick = start;
  openIdentify();
  await follow();
}

async function start() {
  const { ok } = await send("POST", "/v1/diagnoses", { path: byId("gap-run").value });
  if (ok) follow();
}

async function follow() {
  clearTimeout(timer);
  const { ok, status, data } = await send("GET", "/v1/diagnoses", undefined, { quiet: true });
  byId("gap-missing").hidden = status !== 404;
  byId("gap").hidden = status === 404;
  if (status === 404) return;
  if (!ok) { // the run continues in the background: a hiccup of the page must not lose it
    setText(byId("gap-why"), t("gap_silent"));
    timer = setTimeout(follow, AGAIN_MS);
    return;
  }
  for (const one of data.filter((each) => each.state === "done" && !results.has(each.diagnosis_id))) await fetchResult(one);
  const running = data.some((one) => ["running", "waiting"].includes(one.state));
  byId("gap-start").disabled = running || !byId("gap-run").value;
  setText(byId("gap-why"), running ? t("gap_one") : byId("gap-run").value ? "" : t("no_recordings"));
  byId("gap-empty").hidden = data.length > 0;
  const key = data.map((one) => [one.diagnosis_id, one.state, results.has(one.diagnosis_id)]); // what a button outlives
  whenChanged("gap-list", key, (list) => list.replaceChildren(...data.map(card)));
  data.forEach(goingOn);
  timer = setTimeout(follow, running ? AGAIN_MS : IDLE_MS); // a drive that ends begins a diagnosis by itself
}

async function fetchResult({ diagnosis_id }) {
  const { ok, data } = await send("GET", `/v1/diagnoses/${diagnosis_id}/result`, undefined, { quiet: true });
  if (ok) results.set(diagnosis_id, data);
}

function card(one) {
  const running = one.state === "running";
  const id = (part) => `gap-${part}-${one.diagnosis_id}`;
  const parts = [make("h3", {}, one.recording), make("p", {}, make("b", {}, t(`gap_state_${one.state}`)), " ", make("span", { id: id("after") }))];
  if (running) parts.push(make("progress", { id: id("bar"), "aria-label": t("gap_state_running"), max: 100 }), make("p", { id: id("line"), class: "soft" }), stopButton(one));
  if (one.state === "failed") parts.push(make("p", { class: "bad" }, one.reason));
  const result = results.get(one.diagnosis_id);
  if (one.state === "done" && result) parts.push(...answer(result), ...useButton(one, result));
  if (one.state === "done") parts.push(make("p", {}, make("a", { href: `v1/diagnoses/${one.diagnosis_id}/report`, target: "_blank", rel: "noopener" }, t("gap_report"))));
  return make("li", { class: "card" }, ...parts);
}

// What changes while it goes on.
function goingOn(one) {
  const part = (name) => byId(`gap-${name}-${one.diagnosis_id}`);
  setText(part("after"), t("gap_after", { s: one.elapsed_s.toFixed(0) }));
  if (one.state !== "running") return;
  setText(part("line"), one.last_line);
  const share = /: (\d+) % done/.exec(one.last_line)?.[1]; // none yet: the bar only moves
  if (share) part("bar").value = Number(share);
}

function stopButton({ diagnosis_id }) {
  const stopIt = async () => {
    await send("DELETE", `/v1/diagnoses/${diagnosis_id}`);
    follow();
  };
  return make("button", { type: "button", onclick: stopIt }, t("gap_stop"));
}

// The verdict first.
function answer({ verdict, why, budget, next_experiment }) {
  const word = WORDS.has(verdict) ? verdict : "undecided";
  const mood = word === "outside" || word === "undecided" ? "bad" : "good";
  return [make("p", { class: `verdict ${mood}` }, t(`gap_${word}`)), make("p", {}, why), ...inMillimetres(budget), ...following(next_experiment)];
}

function following(experiment) {
  return experiment?.what ? [make("p", {}, t("gap_next", { what: experiment.what, minutes: experiment.minutes, why: experiment.why }))] : [];
}

// The error budget: a line an effect, the largest share first, with a bar of what it does at the tool.
function inMillimetres(budget) {
  const { sentence, effects } = budget;
  if (!effects.length) return [make("p", {}, sentence)];
  const most = Math.max(...effects.map((one) => one.tool_mm), 1e-9);
  const row = (one) => {
    const name = one.joint ? t("gap_joint", { name: one.name, joint: one.joint }) : one.name;
    const bar = make("meter", { min: 0, max: most, value: one.tool_mm, "aria-label": `${one.tool_mm.toPrecision(2)} mm` });
    return make("tr", {}, make("td", {}, name), make("td", {}, bar), make("td", {}, `${one.tool_mm.toPrecision(2)} mm`), make("td", {}, `${(100 * one.probability).toFixed(0)} %`));
  };
  const columns = ["gap_cause", "", "gap_tool", "gap_likely"].map((key) => make("th", { scope: "col" }, key ? t(key) : ""));
  return [make("p", {}, sentence), ...waterfall(budget), make("table", {}, make("thead", {}, make("tr", {}, ...columns)), make("tbody", {}, ...effects.slice(0, SHOWN).map(row)))];
}
