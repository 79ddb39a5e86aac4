// What all parts of the page of rotcal web share: its server, and what a person has stated.
import { t } from "./words.js";

export const by = (id) => document.getElementById(id);
export const desk = {
  token: "",
  names: {}, // role of a file that was dropped -> its name
  typed: new Map(), // id of a field, or name of a choice -> what stands there
  stated: new Map(), // settings of the group sheet that were corrected
  columns: new Map(), // our column -> the head of theirs
};

export async function ask(path, body, method = "POST") {
  try {
    const answer = await fetch(path, { method, body, headers: { "x-rotcal-token": desk.token } });
    return await answer.json();
  } catch {
    by("lost").textContent = t("The server of this page does not answer any more. Start rotcal web again.");
    by("lost").hidden = false;
    return { error: { text: t("no answer"), log: [] } };
  }
}

export async function begin() {
  const started = await ask("/start", undefined, "GET");
  Object.assign(desk, { token: started.token, names: started.names });
  recollect();
  return started;
}

// What was stated outlasts a reload, in this tab and with this server alone.
const MEMORY = "rotcal.desk", KEPT = ["typed", "stated", "columns"];
export function keep() {
  const kept = KEPT.map((part) => [part, [...desk[part]]]);
  try { sessionStorage.setItem(MEMORY, JSON.stringify({ token: desk.token, ...Object.fromEntries(kept) })); } catch { /* until a reload */ }
}
function recollect() {
  let kept = {};
  try { kept = JSON.parse(sessionStorage.getItem(MEMORY)) ?? {}; } catch { /* some browsers are told to keep nothing */ }
  if (kept.token === desk.token) for (const part of KEPT) desk[part] = new Map(kept[part]);
}

export function typed({ target }) {
  if (!target.closest("form") || ["file", "checkbox"].includes(target.type)) return;
  desk.typed.set(target.name || target.id, target.type === "radio" ? target.id : target.value);
  keep();
}
export function fillIn() {
  for (const [key, value] of desk.typed) {
    const chosen = document.querySelector(`[type=radio][name="${key}"][id="${CSS.escape(value)}"]`);
    if (chosen) chosen.checked = true;
    else if (by(key)) by(key).value = value;
  }
}
