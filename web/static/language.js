// The page's language: chosen on the page, else the browser's, else English. One catalogue file a language.
import { byId, make, setText } from "./dom.js";
import { recall, remember } from "./memory.js";
import { t, useCatalogue } from "./texts.js";

const LANGUAGES = { en: "English", de: "Deutsch" }; // each by its own name; texts.<code>.json holds all but English
const NAME = "longreach-language";
const PATIENCE_MS = 3000;

function chosen() {
  const wanted = [recall(NAME), ...navigator.languages.map((language) => language.slice(0, 2).toLowerCase())];
  return wanted.find((code) => code in LANGUAGES) ?? "en";
}

// A catalogue that does not come leaves the page in English; STOP waits for nothing of this.
export async function loadLanguage() {
  const code = chosen();
  if (code === "en") return;
  try {
    const answer = await fetch(`static/texts.${code}.json`, { signal: AbortSignal.timeout(PATIENCE_MS) });
    if (!answer.ok) throw new Error(`${answer.status}`);
    useCatalogue(await answer.json());
    document.documentElement.lang = code;
  } catch (error) {
    reportError(error);
  }
}

export function startLanguage() {
  const select = byId("language");
  select.replaceChildren(...Object.entries(LANGUAGES).map(([code, name]) => make("option", { value: code, lang: code }, name)));
  select.value = chosen();
  select.onchange = () => {
    remember(NAME, select.value);
    location.reload();
  };
  byId("view").title = t("scene_title_frame");
  const stop = byId("stop"); // its script imports nothing: it takes its words from here, else its own English ones
  Object.assign(stop.dataset, { calm: t("stop_hint"), sent: t("stop_sent"), heard: t("stop_heard"), unheard: t("stop_not_heard") });
  setText(stop.querySelector("b"), t("stop_button"));
  if (!stop.dataset.state) setText(byId("stop-status"), t("stop_hint"));
  setText(byId("stop-unheard"), t("stop_unheard"));
}
