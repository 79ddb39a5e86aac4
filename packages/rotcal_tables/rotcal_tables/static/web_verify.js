// A second table, measured with the compensation in force: does it act?
import { ask, by } from "./web_desk.js";
import { work } from "./web_form.js";
import { answers, grid } from "./web_reading.js";
import { element, say, t } from "./words.js";

const VERDICTS = { ok: t("The table acts"), suspect: t("More is left than the uncertainties explain"), failed: t("The table does not act as it should") };
let stated = []; // of the second table alone

export async function measuredAgain({ target }) {
  stated = [];
  nothingVerified();
  const [file] = target.files;
  target.value = ""; // the same file may be chosen again
  if (!file) return;
  const sent = await ask(`/files/after?name=${encodeURIComponent(file.name)}`, file);
  if (sent.error) refused(sent.error);
  else await verify();
}
export function nothingVerified() {
  for (const id of ["after_error", "after_outcome"]) by(id).hidden = true;
}
async function verify() {
  nothingVerified();
  const reply = await work("verify", { stated });
  if (reply.error) refused(reply.error);
  else show(reply);
}
function refused(error) {
  const log = element("ul", "", "small");
  log.append(...error.log.map((line) => element("li", line)));
  const buttons = answers(error, (setting, value) => { stated.push(stating(setting, value)); verify(); });
  by("after_error").replaceChildren(element("p", say(error.text)), log, ...buttons);
  by("after_error").hidden = false;
}
const stating = (setting, value) => `${setting}=${setting === "sheet.columns" ? JSON.stringify([value]) : value}`;
function show({ verdict, words, rows }) {
  const lines = element("ul", "", "small"), marks = element("p", "", "marks");
  marks.append(element("span", VERDICTS[verdict], `mark ${verdict}`));
  lines.append(...words.map((line) => element("li", say(line))));
  const table = grid(t("Deviations before and after, arcsec"), [t("angle / °"), t("before"), t("after")], rows, true);
  by("after_outcome").replaceChildren(marks, lines, table);
  by("after_outcome").hidden = false;
  by("after_outcome").focus();
}
