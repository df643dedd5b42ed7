// What this browser keeps for the next visit. Where it keeps nothing (site data blocked), the page works all the same.
export function recall(name) {
  try {
    return localStorage.getItem(name) ?? "";
  } catch {
    return "";
  }
}

export function remember(name, value) {
  try {
    if (value) localStorage.setItem(name, value);
    else localStorage.removeItem(name);
  } catch {
    // nothing is lost but the memory of it
  }
}
