// The page: states in over one socket, commands out over REST, everything drawn again a few times a second so that
// ages grow also when nothing comes.
import { ageText, serverSilent, silence } from "./age.js";
import { showAlarms } from "./alarms.js";
import { showBar } from "./bar.js";
import { describePicture, showCameraAge, startCamera } from "./camera.js";
import { notice } from "./commands.js";
import { Live } from "./connection.js";
import { showControl, startControl } from "./control.js";
import { byId, setClass, setText } from "./dom.js";
import { showDrawer, startDrawer } from "./drawer.js";
import { buildErrors, showErrors } from "./errors.js";
import { showHistory, showJoints, showStory } from "./history.js";
import { loadLanguage, startLanguage } from "./language.js";
import { startLogin } from "./login.js";
import { watchHold } from "./hold.js";
import { showJog, startJog } from "./jog.js";
import { showScene, startScene } from "./scene.js";
import { startObjects } from "./objects.js";
import { buildSteps, showSteps } from "./steps.js";
import { startTabs } from "./tabs.js";
import { startTarget } from "./target.js";
import { fillTexts, t } from "./texts.js";
import { startTour } from "./tour.js";

const AGES_MS = 200;
const PARTS = [showBar, showControl, showErrors, showSteps, showJog, showHistory, showStory, showJoints, showAlarms, showDrawer, showScene, describePicture];
let state = null;

function show() {
  const silent = serverSilent();
  setClass(document.body, "silent", silent);
  const line = byId("silent");
  byId("logged-out").hidden = !(silent && live.refused);
  line.hidden = !silent || live.refused;
  setText(line, silent ? (state ? t("server_silent", { age: ageText(silence()) }) : t("reconnecting")) : "");
  guarded(showCameraAge);
  if (state) PARTS.forEach((part) => guarded(part));
}

// A defect in one part of the page must not leave the others standing with what they last showed.
const failed = new Set();
function guarded(part, about = state) {
  try {
    part(about);
  } catch (error) {
    if (failed.has(part.name)) return;
    failed.add(part.name);
    notice(t("part_failed", { name: part.name, why: error.message }));
    reportError(error);
  }
}

await loadLanguage(); // before the first state: every text is made in one language
const live = new Live((fresh) => {
  state = fresh;
  show();
});
const fillPage = () => fillTexts(document);
const STARTED = [fillPage, startLanguage, buildErrors, buildSteps, startJog, startControl, startDrawer, startTabs, startTour, watchHold, startCamera, startTarget, startObjects, startScene, startLogin];
STARTED.forEach((part) => guarded(part, live));
setInterval(show, AGES_MS);
