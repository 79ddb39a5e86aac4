// The result, and what is made of it.
import { showDeviations } from "./deviations.js";
import { by, desk } from "./web_desk.js";
import { atFields, work } from "./web_form.js";
import { atOnce, trouble } from "./web_reading.js";
import { element, number, say, t, text } from "./words.js";

const TITLES = { "report.html": t("Report"), "result.json": t("Result (JSON)"), "setup.yaml": t("Set-up (YAML)"), "report.pdf": t("Report (PDF)"), "certificate.xml": t("Certificate (XML)") };

export async function solve() {
  atOnce();
  by("made_error").hidden = true;
  by("solve").disabled = true;
  const reply = await busy(t("Solving …"), "solve");
  by("solve").disabled = false;
  by("result").hidden = Boolean(reply.error);
  trouble(reply.error);
  if (reply.error) { by("error").scrollIntoView(); return; }
  showResult(reply);
  const links = by("links");
  links.replaceChildren(...reply.files.map(link), order(t("PDF"), "pdf"), order(t("Digital certificate (DCC)"), "dcc"));
  by("marks").focus();
  const report = await busy(t("The report is being written …"), "report");
  if (report.error) failed("made_error", report.error);
  else links.prepend(link("report.html"));
}
async function busy(words, what) {
  text("busy", words);
  const reply = await work(what);
  text("busy", "");
  return reply;
}
function showResult(reply) {
  by("simulated").hidden = !reply.simulated;
  showDeviations(reply.deviations);
  by("warnings").replaceChildren(...reply.warnings.map((words) => element("li", say(words))));
  const facts = [[t("observations"), reply.deviations.observations], [t("rejected"), reply.rejected], [t("degrees of freedom"), reply.dof], ["sigma0", number(reply.sigma0, 3)]];
  by("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", String(value))]));
  text("command", command());
}
function command() {
  const quoted = (name) => `'${name.replace(/'/g, "'\\''")}'`;
  const { table, targets } = desk.names;
  return `rotcal solve ${quoted(table)} --setup setup.yaml${targets ? ` --targets ${quoted(targets)}` : ""}`;
}

export function link(name) {
  const made = element("a", TITLES[name] ?? name, "button");
  made.href = `/made/${encodeURIComponent(name)}`;
  if (name === "report.html") { made.target = "_blank"; made.rel = "noopener"; } else made.download = name;
  return made;
}
function order(words, what) {
  const button = element("button", `${words} …`, "quiet");
  button.addEventListener("click", async () => {
    button.disabled = true;
    by("made_error").hidden = true;
    const reply = await busy(t("Writing …"), what);
    button.disabled = false;
    if (reply.error) { failed("made_error", reply.error); return; }
    const made = link(reply.files[0]);
    button.replaceWith(made);
    made.focus();
  });
  return button;
}
export function failed(id, error) {
  atFields(error);
  const log = element("ul", "", "small");
  log.append(...error.log.map((line) => element("li", line)));
  by(id).replaceChildren(element("p", say(error.text)), log);
  by(id).hidden = false;
}
