// The top bar: mode, link, camera, e-stop, alarms. Each chip: a mark by shape and colour, words, age.
import { LIMITS_MS, ageText, crossOut, grown, isOld, pictureOld, serverSilent, stalePicture } from "./age.js";
import { byId, setClass, setText } from "./dom.js";
import { alarmText, phrase, t } from "./texts.js";

const NOT_REPORTED = "not reported"; // the value of the REST interface

export function showBar(state) {
  const real = state.mode === "REAL";
  setText(byId("mode"), t(real ? "real" : "sim"));
  setText(byId("mode-long"), `${t(real ? "real_long" : "sim_long")} · ${state.machine}`);
  setClass(byId("mode-box"), "real", real);
  setClass(byId("mode-box"), "sim", !real);
  setText(byId("version"), `longreach ${state.version}`);
  showLink(state.link, state.panel.link);
  showCamera(state);
  showSafety(state.panel.safety, state.link);
  showAlarmChip(state.panel.alarms);
}

function chip(id, level, text, sub, old) {
  const element = byId(id);
  const wanted = `chip ${level}`;
  if (!element.className.startsWith(wanted)) element.className = wanted;
  setText(element.querySelector("b"), text);
  setText(element.querySelector("small"), sub);
  const title = `${text}. ${sub}`;
  if (element.title !== title) element.title = title;
  crossOut(element, old);
}

// What is silent says so in the present tense, and when it was heard last; what it reported then is gone.
function showLink(link, figures) {
  const silent = isOld(link.age_ms, LIMITS_MS.link);
  const age = link.age_ms === null ? t("never") : ageText(grown(link.age_ms));
  if (silent && !serverSilent()) return chip("link", "bad", t("plc_silent"), link.age_ms === null ? age : t("last_ago", { age }), false);
  const warn = link.dry_run || ["fault", "local"].includes(link.phase) || figures.loss_pct > 5;
  const text = link.dry_run ? t("dry_run") : phrase(link.phase);
  const loss = figures.loss_pct.toFixed(figures.loss_pct < 0.05 ? 0 : 1);
  chip("link", serverSilent() ? "bad" : warn ? "warn" : "good", text, t("plc_sub", { age, loss }), serverSilent());
}

function showCamera(state) {
  const camera = state.camera;
  const fps = camera.fps.toFixed(0);
  const age = camera.age_ms === null ? "–" : ageText(grown(camera.age_ms));
  if (camera.age_ms === null) return chip("camera", "bad", t("no_image"), "", serverSilent());
  if (serverSilent()) return chip("camera", "bad", t("camera_text", { fps }), t("camera_sub", { age }), true);
  if (isOld(camera.age_ms, LIMITS_MS.camera)) return chip("camera", "bad", t("camera_silent"), t("last_ago", { age }), false);
  if (stalePicture(camera.warnings)) return chip("camera", "bad", t("camera_frozen"), t("camera_unfit"), false);
  if (pictureOld(state)) return chip("camera", "bad", t("camera_late"), t("camera_sub", { age: ageText(grown(state.panel.vision.exposure_age_ms)) }), false);
  const unfit = camera.warnings.length > 0;
  chip("camera", unfit ? "warn" : "good", t("camera_text", { fps }), unfit ? t("camera_unfit") : t("camera_sub", { age }), false);
}

function showSafety(safety, link) {
  const old = isOld(link.age_ms, LIMITS_MS.link) || serverSilent();
  const bad = safety.estop === "PRESSED" || safety.enable === "LOST";
  const enable = { "needed to arm": t("enable_needed"), [NOT_REPORTED]: t("not_known") }[safety.enable] ?? phrase(safety.enable);
  const known = safety.estop !== NOT_REPORTED;
  const estop = known ? phrase(safety.estop) : t("not_known");
  chip("safety", bad ? "bad" : old ? "warn" : "good", estop, t("estop_sub", { enable }), old && (known || serverSilent()));
}

// What is still so goes before what is over, whatever its priority.
function showAlarmChip(alarms) {
  const open = alarms.filter((one) => !one.acknowledged_by);
  const first = open.find((one) => one.ended_unix_s === null) ?? open[0];
  const level = open.some((one) => one.level === "high" && one.ended_unix_s === null) ? "bad" : open.length ? "warn" : "good";
  const title = !first ? t("alarm_none") : first.ended_unix_s === null ? alarmText(first, "title") : t("alarm_was", { title: alarmText(first, "title") });
  setText(byId("alarm-chip").querySelector("span"), open.length ? t("alarms_n", { n: open.length }) : t("alarms"));
  chip("alarm-chip", level, title, !open.length && alarms.length ? t("alarm_seen", { n: alarms.length }) : "", serverSilent());
}
