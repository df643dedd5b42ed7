// Tabs of the lower right: history, alarms, joints, story. Arrow keys go from tab to tab.
import { byId } from "./dom.js";

export function startTabs() {
  const tabs = [...byId("tabs").querySelectorAll("[role=tab]")];
  tabs.forEach((tab, i) => {
    tab.onclick = () => choose(tabs, i);
    tab.onkeydown = (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step) choose(tabs, (i + step + tabs.length) % tabs.length).focus();
    };
  });
  byId("alarm-chip").onclick = () => choose(tabs, tabs.indexOf(byId("tab-alarms"))).focus();
}

function choose(tabs, chosen) {
  tabs.forEach((tab, i) => {
    tab.setAttribute("aria-selected", String(i === chosen));
    tab.tabIndex = i === chosen ? 0 : -1;
    byId(tab.getAttribute("aria-controls")).hidden = i !== chosen;
  });
  return tabs[chosen];
}
