// The alarm list: what, since when, cause, what to do, who may clear it. Latched on the server.
import { send } from "./commands.js";
import { haveControl } from "./control.js";
import { byId, make, setText, whenChanged } from "./dom.js";
import { alarmText, phrase, t } from "./texts.js";

const clock = (unixS) => new Date(1000 * unixS).toLocaleTimeString("en-GB");
const LEVEL = { high: "priority_high", medium: "priority_medium", low: "priority_low" };
let said = "";

export function showAlarms(state) {
  const alarms = state.panel.alarms;
  const mine = haveControl(state);
  const open = alarms.filter((one) => !one.acknowledged_by).length;
  setText(byId("tab-alarms"), open ? `${t("alarms_tab")} (${open})` : t("alarms_tab"));
  const lasting = alarms.map(({ detail, ...one }) => [one, Boolean(detail)]); // details count seconds: ten redraws a second no button outlives
  whenChanged("alarm-list", [lasting, mine], (list) => list.replaceChildren(...(alarms.length ? alarms.map((one) => alarmItem(one, mine)) : [make("p", { class: "soft" }, t("no_alarms"))])));
  for (const one of alarms.filter((each) => each.detail)) setText(byId(`alarm-detail-${one.code}`), one.detail);
  const newest = alarms.find((one) => !one.acknowledged_by && one.ended_unix_s === null);
  const text = newest ? `${alarmText(newest, "title")}. ${alarmText(newest, "remedy")}` : "";
  if (text !== said) {
    said = text;
    setText(byId("alarm-voice"), text);
  }
}

function alarmItem(one, mine) {
  const when = `${t("since", { time: clock(one.since_unix_s) })} · ${one.ended_unix_s === null ? t("still") : t("over", { time: clock(one.ended_unix_s) })}`;
  const button = make("button", { type: "button", disabled: !mine, onclick: () => send("POST", `/v1/alarms/${one.code}/acknowledge`) }, t("acknowledge"));
  const done = one.acknowledged_by ? make("span", { class: "soft" }, t("acknowledged", { who: one.acknowledged_by })) : make("span", {}, button, mine ? null : make("small", { class: "why" }, ` ${t("no_control")}`));
  return make(
    "article",
    { class: `alarm ${one.level} ${one.acknowledged_by ? "seen" : ""} ${one.ended_unix_s === null ? "" : "ended"}` },
    make("h3", {}, make("span", { class: "level" }, t(LEVEL[one.level])), ` ${alarmText(one, "title")} `, make("small", {}, when)),
    one.detail ? make("p", { class: "detail", id: `alarm-detail-${one.code}` }, one.detail) : null,
    make("p", {}, make("b", {}, `${t("cause")}: `), alarmText(one, "cause")),
    make("p", {}, make("b", {}, `${t("remedy")}: `), alarmText(one, "remedy")),
    make("p", { class: "soft" }, `${t("clears")}: ${phrase(one.clears)}.`),
    make("p", {}, done, " ", make("a", { href: `help/alarms/${one.code}`, target: "_blank", rel: "noopener" }, t("help"))),
  );
}
