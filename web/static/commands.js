// Every command goes through here: with this page's lease, once, and its refusal shown in words.
// Why a button is disabled: reason() in steps.js.
import { byId, setText } from "./dom.js";
import { t } from "./texts.js";

const NOTICE_MS = 12000;
let lease = null;
let noticeTimer = 0;

export const setLease = (held) => { lease = held; };
export const getLease = () => lease;

export function notice(text) {
  const line = byId("notice");
  setText(line, text);
  line.hidden = !text;
  clearTimeout(noticeTimer);
  if (text) noticeTimer = setTimeout(() => { line.hidden = true; }, NOTICE_MS);
}

// One key a press of a button: a request that is sent twice is done once.
function freshKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export async function send(method, path, body, { quiet = false } = {}) {
  const headers = { "Content-Type": "application/json" };
  if (lease) Object.assign(headers, { "Longreach-Lease": lease.lease_id, "Longreach-Fencing": String(lease.fencing) });
  if (path === "/v1/jobs") headers["Idempotency-Key"] = freshKey();
  let answer;
  try {
    answer = await fetch(`.${path}`, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch (error) {
    if (!quiet) notice(t("refused", { why: t("why_server") }));
    return { ok: false, status: 0, data: null };
  }
  const data = answer.status === 204 ? null : await answer.json().catch(() => null);
  if (!answer.ok && !quiet) notice(t("refused", { why: [data?.detail ?? `${answer.status} ${answer.statusText}`, data?.hint].filter(Boolean).join(". ") }));
  if (answer.ok && !quiet) notice("");
  return { ok: answer.ok, status: answer.status, data };
}
