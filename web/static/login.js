// Who is logged in, and the way out. A server without keys has no users, and shows no button.
import { send } from "./commands.js";
import { byId, setText } from "./dom.js";
import { t } from "./texts.js";

const NO_KEYS = "local"; // the name that a server without keys gives everybody

export async function startLogin() {
  const { ok, data } = await send("GET", "/v1/session", undefined, { quiet: true });
  if (!ok || data.name === NO_KEYS) return;
  const button = byId("log-out");
  setText(button, t("log_out", { name: data.name }));
  button.hidden = false;
  button.onclick = async () => {
    await send("DELETE", "/v1/session");
    location.assign("login");
  };
}
