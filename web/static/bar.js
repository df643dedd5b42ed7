// The top bar: mode, link, camera, e-stop, alarms. Each chip: a mark by shape and colour, words, age.
import { LIMITS_MS, ageText, crossOut, grown, isOld, serverSilent } from "./age.js";
import { byId, setClass, setText } from "./dom.js";
import { t } from "./texts.js";

export function showBar(state) {
  const real = state.mode === "REAL";
  setText(byId("mode"), t(real ? "real" : "sim"));
  setText(byId("mode-long"), `${t(real ? "real_long" : "sim_long")} · ${state.machine}`);
  setClass(byId("mode-box"), "real", real);
  setClass(byId("mode-box"), "sim", !real);
  setText(byId("version"), `longreach ${state.version}`);
  showLink(state.link, state.panel.link);
  showCamera(state.camera);
  showSafety(state.panel.safety, state.link);
  showAlarmChip(state.panel.alarms);
}

function chip(id, level, text, sub, old) {
  const element = byId(id);
  const wanted = `chip ${level}`;
  if (!element.className.startsWith(wanted)) element.className = wanted;
  setText(element.querySelector("b"), text);
  setText(element.querySelector("small"), sub);
  crossOut(element, old);
}

function showLink(link, figures) {
  const old = isOld(link.age_ms, LIMITS_MS.link) || serverSilent();
  const warn = link.dry_run || ["fault", "local"].includes(link.phase) || figures.loss_pct > 5;
  const age = link.age_ms === null ? t("never") : ageText(grown(link.age_ms));
  const text = link.dry_run ? t("dry_run") : link.phase;
  chip("link", old ? "bad" : warn ? "warn" : "good", text, t("plc_sub", { age, loss: figures.loss_pct.toFixed(1) }), old);
}

function showCamera(camera) {
  const old = isOld(camera.age_ms, LIMITS_MS.camera) || serverSilent();
  const age = camera.age_ms === null ? "–" : ageText(grown(camera.age_ms));
  const text = camera.age_ms === null ? t("no_image") : t("camera_text", { fps: camera.fps.toFixed(0) });
  const sub = camera.warnings.length && !old ? camera.warnings.at(-1).split(":")[0] : t("camera_sub", { age });
  chip("camera", old ? "bad" : camera.warnings.length ? "warn" : "good", text, sub, old);
}

function showSafety(safety, link) {
  const old = isOld(link.age_ms, LIMITS_MS.link) || serverSilent();
  const bad = safety.estop === "PRESSED" || safety.enable === "LOST";
  chip("safety", bad ? "bad" : old ? "warn" : "good", safety.estop, t("estop_sub", { enable: safety.enable }), old);
}

function showAlarmChip(alarms) {
  const open = alarms.filter((one) => !one.acknowledged_by);
  const level = open.some((one) => one.level === "high") ? "bad" : open.length ? "warn" : "good";
  const sub = open.length ? t("alarm_count", { n: open.length }) : alarms.length ? t("alarm_seen", { n: alarms.length }) : "";
  chip("alarm-chip", level, open[0]?.title ?? t("alarm_none"), sub, serverSilent());
}
