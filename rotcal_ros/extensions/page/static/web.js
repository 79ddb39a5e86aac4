// The page of rotcal web: a table is dropped, looked at, corrected, solved and taken along.
import { redraw } from "./charts.js";
import { showDeviations } from "./deviations.js";
import { element, language, number, offerLanguages, say, sentence, t, text, translatePage } from "./words.js";

const by = (id) => document.getElementById(id);
const ROLES = { table: t("Measurements"), targets: t("Targets"), setup: t("Set-up file") };
const OURS = { position: t("table position"), angle: t("table angle"), target: t("target"), length: t("length"), place: t("place of the tracer") };
const READING = { // settings of the group sheet that hold for all columns
  "sheet.decimal": [t("decimal mark"), [["", t("as the numbers tell")], [".", t("point")], [",", t("comma")]]],
  "sheet.counted_from": [t("first number of positions and targets"), [["", t("as the numbers tell")], ["0", "0"], ["1", "1"]]],
};
const UNITS = { deg: "°", degC: "°C", arcsec: "″", um: "µm" };
const MICRO = /_std_m$/; // shown in micrometres
const stated = new Map(); // settings of the group sheet that were corrected
const columns = new Map(); // our column -> the head of theirs
let token = "", names = {}, asked = 0;

async function ask(path, body, method = "POST") {
  try {
    const answer = await fetch(path, { method, body, headers: { "x-rotcal-token": token } });
    return await answer.json();
  } catch {
    by("lost").textContent = t("The server of this page does not answer any more. Start rotcal web again.");
    by("lost").hidden = false;
    return { error: { text: t("no answer"), log: [] } };
  }
}
const work = (what, more = {}) =>
  ask(`/do/${what}`, JSON.stringify({ method: by("method").value, changes: changes(), language, ...more }));

function field(id, words, input, unit = "") {
  const line = element("p", "", "field"), label = element("label", words), wrap = element("span", "", unit ? "with_unit" : "");
  input.id = label.htmlFor = id;
  const trouble = element("span", "", "trouble");
  trouble.id = `${id}_trouble`;
  wrap.append(input, ...(unit ? [element("span", unit)] : []));
  line.append(label, wrap, trouble);
  return line;
}
function select(options, value = "") {
  const made = element("select");
  made.append(...options.map(([key, words]) => new Option(words, key, false, key === value)));
  return made;
}

// The form: what rotcal new asks for.
async function form() {
  const kept = new Map(inputs().map((input) => [input.dataset.name, input.value]));
  const found = await ask(`/settings/${by("method").value}`, undefined, "GET");
  const groups = { measurement: [], item: [], more: [], certificate: [], instruments: [] };
  for (const asked of found) groups[groupOf(asked)].push(asked);
  for (const [name, listed] of Object.entries(groups)) {
    by(name).querySelectorAll(".field").forEach((line) => line.remove());
    by(name).append(...listed.map((one) => setting(one, kept.get(one.name) ?? "")));
  }
  const kinds = [...new Set(groups.instruments.map((one) => one.name.split(".")[2]))];
  by("instrument").replaceChildren(...select(kinds.map((kind) => [kind, t(kind.replace("_", " "))])).children);
  oneInstrument();
  withSetup();
}
function groupOf({ name, list, default: usual, asked }) {
  if (name.startsWith("identity.instruments.")) return "instruments";
  if (name.startsWith("identity.")) return asked ? "item" : "certificate";
  if (name === "air.temperature_c") return "item";
  return (list && usual !== "-") || name.startsWith("air.") ? "more" : "measurement";
}
function setting({ name, meaning, unit, kind, list, choices, default: usual }, value) {
  const micro = MICRO.test(name) && !list;
  const input = choices.length ? select([["", usual], ...choices.map((c) => [c, c])], value) : element("input");
  input.dataset.name = name;
  input.dataset.kind = list ? "list" : kind;
  if (!choices.length) {
    input.value = value;
    if (/\d/.test(usual)) input.placeholder = micro ? `${Number((usual * 1e6).toPrecision(6))}` : usual;
    if (kind === "float" || kind === "int") input.inputMode = list ? "text" : "decimal";
    input.required = usual === "-";
  }
  if (name.endsWith(".measured")) input.type = "date";
  return field(`set.${name}`, sentence(say(meaning)), input, micro ? "µm" : UNITS[unit] ?? unit);
}
const inputs = () => [...document.querySelectorAll("#form [data-name]")];
function oneInstrument() {
  for (const input of by("instruments").querySelectorAll("[data-name]")) {
    input.closest(".field").hidden = input.dataset.name.split(".")[2] !== by("instrument").value;
  }
}
function withSetup() { // a set-up has a method and a plan of its own
  for (const id of ["method_field", "measurement", "more"]) (id === "more" ? by(id).parentElement : by(id)).hidden = "setup" in names;
}
function given({ dataset: { name, kind }, value }) {
  const plain = kind === "float" ? value.trim().replace(",", ".") : value.trim();
  if (!MICRO.test(name) || kind === "list") return plain;
  return /^\d*\.?\d*$/.test(plain) ? `${plain}e-6` : plain;
}
function changes() {
  const found = new Map(inputs().filter((i) => i.value.trim())
    .filter((i) => !("setup" in names) || i.dataset.name.startsWith("identity.") || i.dataset.name.startsWith("air."))
    .map((i) => [i.dataset.name, given(i)]));
  const count = found.get("plan.table_positions");
  if (count && !found.has("plan.table_step_deg")) found.set("plan.table_step_deg", 360 / count);
  for (const [name, value] of stated) found.set(name, value);
  if (columns.size) found.set("sheet.columns", JSON.stringify([...columns].map(([ours, theirs]) => `${ours}=${theirs}`)));
  return [...found].map(([name, value]) => `${name}=${value}`);
}

// Files: each row takes one, and so does the whole card.
function files() {
  by("files").replaceChildren(...Object.entries(ROLES).map(([role, words]) => {
    const line = element("li"), choose = element("label", t("Choose …"), "button"), input = element("input");
    input.type = "file";
    input.setAttribute("aria-label", `${words}: ${t("choose a file")}`);
    input.addEventListener("change", () => send(role, input.files[0]));
    choose.append(input);
    line.append(element("span", words), element("span", names[role] ?? t("none yet"), names[role] ? "name there" : "name nothing"));
    if (names[role]) {
      const away = element("button", t("Remove"), "quiet");
      away.setAttribute("aria-label", `${t("Remove")}: ${words}`);
      away.addEventListener("click", async () => { await send(role, null); by("files").querySelector("input, button").focus(); });
      line.append(away);
    } else line.append(choose);
    return line;
  }));
}
const roleOf = ({ name }) => (/\.ya?ml$/i.test(name) ? "setup" : /^(target|ziel|cible|目标|ターゲット)/i.test(name) ? "targets" : "table");
async function send(role, file) {
  text("file_trouble", "");
  const told = await ask(`/files/${role}?name=${encodeURIComponent(file?.name ?? "")}`, file ?? undefined, file ? "POST" : "DELETE");
  if (told.error) { text("file_trouble", told.error.text); return; }
  names = told.names;
  if (role === "table") { stated.clear(); columns.clear(); }
  files();
  withSetup();
  await understand();
}

// What is understood, and what has to be asked.
let waiting = 0;
function soon() { clearTimeout(waiting); waiting = setTimeout(understand, 300); }
async function understand() {
  by("result").hidden = true;
  for (const id of ["understood", "outcome"]) by(id).hidden = !names.table;
  if (!names.table) return;
  const mine = ++asked;
  by("understood").setAttribute("aria-busy", "true");
  const told = await work("explain");
  if (mine !== asked) return; // asked again meanwhile
  by("understood").setAttribute("aria-busy", "false");
  trouble(told.error);
  corrections();
  by("tables").replaceChildren(...(told.tables ?? []).map((table, place) => shown(table, place === 0)));
  by("solve").disabled = Boolean(told.error);
}
function trouble(error) {
  by("error").hidden = !error;
  text("error_words", error?.text ?? "");
  by("error_log").replaceChildren(...(error?.log ?? []).map((line) => element("li", line)));
  by("answers").replaceChildren(...(error?.question?.answers ?? []).map(([value, words]) => {
    const button = element("button", words);
    button.addEventListener("click", () => correct(error.question.setting, value));
    return button;
  }));
  atFields(error);
}
function atFields(error) { // what an error says of a setting stands at its field, too
  for (const input of inputs()) {
    const named = new RegExp(`${input.dataset.name.replaceAll(".", "\\.")}(?![\\w.])`);
    const words = error ? [error.text, ...error.log].find((line) => named.test(line)) : undefined;
    input.setAttribute("aria-invalid", String(words !== undefined));
    input.setAttribute("aria-describedby", `${input.id}_trouble`);
    text(`${input.id}_trouble`, words ?? "");
    if (words !== undefined && input.closest("details")) input.closest("details").open = true;
  }
}
function correct(name, value) {
  if (name === "sheet.columns") {
    const [ours, ...theirs] = value.split("=");
    columns.set(ours, theirs.join("="));
  } else if (value) stated.set(name, value);
  else stated.delete(name);
  understand();
}
function corrections() {
  const made = [...[...columns].map(([ours, theirs]) => [`${OURS[ours] ?? ours} = ${theirs}`, () => columns.delete(ours)]),
    ...[...stated].map(([name, value]) => [`${name} = ${value}`, () => stated.delete(name)])];
  by("corrected").hidden = !made.length;
  by("corrected").replaceChildren(element("span", t("Your corrections:")), ...made.map(([words, undo]) => {
    const button = element("button", `${words}  ✕`, "quiet");
    button.setAttribute("aria-label", t("Take back: {0}", words));
    button.addEventListener("click", () => { undo(); understand(); });
    return button;
  }));
  for (const name of Object.keys(READING)) by(`set.${name}`).value = stated.get(name) ?? "";
}
function shown(table, main) {
  const box = element("div", "", "table_of");
  box.append(element("h3", table.name), element("p", table.form ? t("{0}, {1} rows", say(table.form), table.rows) : t("a table of our own form, read as it stands: {0}", table.header.join(", "))));
  const grids = element("div", "", "sheets");
  if (table.columns.length) grids.append(grid(t("Columns of {0}", table.name), [t("means"), t("column of the table"), t("unit")],
    table.columns.map((column) => [ours(column, main), theirs(column, table, main), unitOf(column, main)])));
  grids.append(grid(t("First rows as they are solved: metres, numbers from 0"), [t("row"), ...table.header], table.first.map(([row, cells]) => [row, ...cells]), true));
  box.append(grids);
  if (table.remarks.length) box.append(element("p", table.remarks.map(say).join("; "), "small"));
  if (table.aside.length) box.append(element("p", t("not needed: {0}", table.aside.join(", ")), "small"));
  if (table.left_out.length) {
    const more = element("details"), list = element("ul", "", "lines");
    list.append(...table.left_out.map(([row, why]) => { const line = element("li"); line.append(element("span", t("row {0}", row)), element("span", say(why))); return line; }));
    more.append(element("summary", table.left_out.length === 1 ? t("1 row left out") : t("{0} rows left out", table.left_out.length)), list);
    box.append(more);
  }
  return box;
}
function grid(caption, head, rows, numbers = false) {
  const box = element("div", "", numbers ? "sheet numbers" : "sheet"), made = element("table"), top = element("tr"), body = element("tbody"), above = element("thead");
  box.tabIndex = 0;
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", caption);
  top.append(...head.map((words) => { const cell = element("th", words, numbers ? "number" : ""); cell.scope = "col"; return cell; }));
  above.append(top);
  body.append(...rows.map((cells) => {
    const line = element("tr");
    line.append(...cells.map((cell) => { const made = element("td", "", numbers ? "number" : ""); made.append(cell); return made; }));
    return line;
  }));
  made.append(element("caption", caption), above, body);
  box.append(made);
  return box;
}
function ours({ name, text: head }, main) {
  if (!main || head === null || !["position", "angle"].includes(name)) return OURS[name] ?? name;
  const choice = select([["position", OURS.position], ["angle", OURS.angle]], name);
  choice.setAttribute("aria-label", t("meaning of {0}", head));
  choice.addEventListener("change", () => { columns.delete(name); correct("sheet.columns", `${choice.value}=${head}`); });
  return choice;
}
function theirs({ name, text: head, theirs: words }, table, main) {
  if (!main || head === null) return say(words);
  const choice = select([...new Set(table.head)].filter(Boolean).map((one) => [one, one]), head);
  choice.setAttribute("aria-label", t("column that is {0}", OURS[name] ?? name));
  choice.addEventListener("change", () => correct("sheet.columns", `${name}=${choice.value}`));
  return choice;
}
function unitOf({ setting, units, name }, main) {
  if (!setting || !main) return units.length === 1 ? units[0] : "";
  const choice = select([["", t("as the table tells")], ...units.map((unit) => [unit, unit])], stated.get(setting) ?? "");
  choice.setAttribute("aria-label", t("unit of {0}", OURS[name] ?? name));
  choice.addEventListener("change", () => correct(setting, choice.value));
  return choice;
}

// The result, and what is made of it.
async function solve() {
  clearTimeout(waiting); // a field that was left for this button: what it says is solved now
  by("solve").disabled = true;
  text("busy", t("Solving …"));
  const told = await work("solve");
  by("solve").disabled = false;
  text("busy", "");
  by("result").hidden = Boolean(told.error);
  trouble(told.error);
  if (told.error) { by("error").scrollIntoView(); return; }
  by("simulated").hidden = !told.simulated;
  showDeviations(told.deviations);
  by("warnings").replaceChildren(...told.warnings.map((words) => element("li", say(words))));
  const facts = [[t("observations"), told.deviations.observations], [t("rejected"), told.rejected], [t("degrees of freedom"), told.dof], ["sigma0", number(told.sigma0, 3)]];
  by("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", String(value))]));
  const source = names.table.replace(/'/g, "'\\''");
  text("command", `rotcal solve '${source}' --setup setup.yaml${names.targets ? ` --targets '${names.targets.replace(/'/g, "'\\''")}'` : ""}`);
  for (const id of ["made_error", "controller_error"]) by(id).hidden = true;
  for (const id of ["controller_links", "controller_words"]) by(id).replaceChildren();
  const links = by("links");
  links.replaceChildren(...told.files.map(link), order(t("PDF"), "pdf"), order(t("Digital certificate (DCC)"), "dcc"));
  by("marks").focus();
  text("busy", t("The report is being written …"));
  const report = await work("report");
  text("busy", "");
  if (report.error) failed("made_error", report.error);
  else links.prepend(link("report.html"));
}
const TITLES = { "report.html": t("Report"), "result.json": t("Result (JSON)"), "setup.yaml": t("Set-up (YAML)"), "report.pdf": t("Report (PDF)"), "certificate.xml": t("Certificate (XML)") };
function link(name) {
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
    text("busy", t("Writing …"));
    const told = await work(what);
    text("busy", "");
    button.disabled = false;
    if (told.error) { failed("made_error", told.error); return; }
    const made = link(told.files[0]);
    button.replaceWith(made);
    made.focus();
  });
  return button;
}
function failed(id, error) {
  atFields(error);
  const log = element("ul", "", "small");
  log.append(...error.log.map((line) => element("li", line)));
  by(id).replaceChildren(element("p", error.text), log);
  by(id).hidden = false;
}
async function controller(event) {
  event.preventDefault();
  by("controller_error").hidden = true;
  for (const id of ["controller_links", "controller_words"]) by(id).replaceChildren();
  const in_force = document.querySelector("[name=in_force]:checked")?.value ?? "";
  if (in_force === "add") {
    await ask("/files/in_force", undefined, "DELETE");
    for (const file of by("held").files) {
      const told = await ask(`/files/in_force?name=${encodeURIComponent(file.name)}`, file);
      if (told.error) { failed("controller_error", told.error); return; }
    }
  }
  const told = await work("controller", { controller: by("controller").value, in_force, settings: by("controller_settings").value,
    accept_age: by("accept_age").checked, accept_unverified: by("accept_unverified").checked });
  if (told.error) { failed("controller_error", told.error); return; }
  by("controller_words").replaceChildren(...told.words.map((words) => element("li", words)));
  by("controller_links").replaceChildren(...told.files.map(link));
}

translatePage();
offerLanguages();
const begin = await ask("/start", undefined, "GET");
token = begin.token;
names = begin.names;
by("method").append(...select(begin.methods.map(([name, title]) => [name, say(title)])).children);
by("method").value = begin.method;
by("controller").append(...select([["", t("choose …")], ...begin.controllers.map((name) => [name, name])]).children);
by("controller").value = "";
by("reading").append(...Object.entries(READING).map(([name, [words, options]]) => {
  const choice = select(options);
  choice.addEventListener("change", () => correct(name, choice.value));
  return field(`set.${name}`, words, choice);
}));
files();
await form();
by("method").addEventListener("change", async () => { await form(); understand(); });
by("form").addEventListener("submit", (event) => event.preventDefault());
by("form").addEventListener("change", ({ target }) => { if (target.dataset.name) soon(); });
by("instrument").addEventListener("change", oneInstrument);
by("solve").addEventListener("click", solve);
by("controller_form").addEventListener("submit", controller);
by("controller_form").addEventListener("change", () => { by("held_field").hidden = !by("in_force_add").checked; });
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => { event.preventDefault(); by("dropped").classList.toggle("over", name === "dragover"); });
}
document.addEventListener("drop", async ({ dataTransfer }) => {
  for (const file of [...dataTransfer.files].sort((a, b) => (roleOf(a) === "table") - (roleOf(b) === "table"))) await send(roleOf(file), file);
});
let resizing = 0;
addEventListener("resize", () => { clearTimeout(resizing); resizing = setTimeout(redraw, 150); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
await understand();
