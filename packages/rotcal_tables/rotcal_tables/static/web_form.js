// The form: what rotcal new asks for, and what a person has stated, as changes of a set-up.
import { ask, by, desk, fillIn } from "./web_desk.js";
import { element, language, say, sentence, t, text } from "./words.js";

const UNITS = { deg: "°", degC: "°C", arcsec: "″", um: "µm" };
const MICRO = /_std_m$/; // shown in micrometres
const inputs = () => [...document.querySelectorAll("#form [data-name]")];

export const work = (what, more = {}) =>
  ask(`/do/${what}`, JSON.stringify({ method: by("method").value, changes: changes(), language, ...more }));

export function field(id, words, input, unit = "") {
  const line = element("p", "", "field"), label = element("label", words), wrap = element("span", "", unit ? "with_unit" : "");
  input.id = label.htmlFor = id;
  const trouble = element("span", "", "trouble");
  trouble.id = `${id}_trouble`;
  wrap.append(input, ...(unit ? [element("span", unit)] : []));
  line.append(label, wrap, trouble);
  return line;
}
export function select(options, value = "") {
  const made = element("select");
  made.append(...options.map(([key, words]) => new Option(words, key, false, key === value)));
  return made;
}

export async function form() {
  const found = await ask(`/settings/${by("method").value}`, undefined, "GET");
  const groups = { measurement: [], item: [], more: [], certificate: [], instruments: [] };
  for (const asked of found) groups[groupOf(asked)].push(asked);
  for (const [name, listed] of Object.entries(groups)) {
    by(name).querySelectorAll(".field").forEach((line) => line.remove());
    by(name).append(...listed.map(setting));
  }
  const kinds = [...new Set(groups.instruments.map((one) => one.name.split(".")[2]))];
  by("instrument").replaceChildren(...select(kinds.map((kind) => [kind, t(kind.replace("_", " "))])).children);
  fillIn();
  oneInstrument();
  withSetup();
}
function groupOf({ name, list, default: usual, asked }) {
  if (name.startsWith("identity.instruments.")) return "instruments";
  if (name.startsWith("identity.")) return asked ? "item" : "certificate";
  if (name === "air.temperature_c") return "item";
  return (list && usual !== "-") || name.startsWith("air.") ? "more" : "measurement";
}
function setting({ name, meaning, unit, kind, list, choices, default: usual }) {
  const micro = MICRO.test(name) && !list;
  const input = choices.length ? select([["", usual], ...choices.map((c) => [c, c])]) : element("input");
  input.dataset.name = name;
  input.dataset.kind = list ? "list" : kind;
  if (!choices.length) {
    if (typeof usual !== "string") input.placeholder = say(usual); // what the table says counts
    else if (/\d/.test(usual)) input.placeholder = micro ? `${Number((usual * 1e6).toPrecision(6))}` : usual;
    if (kind === "float" || kind === "int") input.inputMode = list ? "text" : "decimal";
    input.required = usual === "-";
  }
  if (name.endsWith(".measured")) input.type = "date";
  return field(`set.${name}`, sentence(say(meaning)), input, micro ? "µm" : UNITS[unit] ?? unit);
}
export function oneInstrument() {
  for (const input of by("instruments").querySelectorAll("[data-name]")) {
    input.closest(".field").hidden = input.dataset.name.split(".")[2] !== by("instrument").value;
  }
}
export function withSetup() { // a set-up has a method and a plan of its own
  const own = [by("method_field"), by("measurement"), by("more").parentElement];
  for (const part of own) part.hidden = "setup" in desk.names;
}

function changes() {
  const found = new Map(inputs().filter(counts).map((input) => [input.dataset.name, given(input)]));
  const count = found.get("plan.table_positions");
  if (count && !found.has("plan.table_step_deg")) found.set("plan.table_step_deg", 360 / count);
  for (const [name, value] of desk.stated) found.set(name, value);
  if (desk.columns.size) found.set("sheet.columns", JSON.stringify([...desk.columns].map((both) => both.join("="))));
  return [...found].map(([name, value]) => `${name}=${value}`);
}
function counts({ value, dataset: { name } }) {
  return value.trim() && (!("setup" in desk.names) || /^(identity|air)\./.test(name));
}
function given({ dataset: { name, kind }, value }) {
  const plain = kind === "float" ? value.trim().replace(",", ".") : value.trim();
  if (!MICRO.test(name) || kind === "list") return plain;
  return /^\d*\.?\d*$/.test(plain) ? `${plain}e-6` : plain;
}

export function atFields(error) { // what an error says of a setting stands at its field, too
  for (const input of inputs()) {
    const named = new RegExp(`${input.dataset.name.replaceAll(".", "\\.")}(?![\\w.])`);
    const says = (line) => named.test(line) || error.names?.includes(input.dataset.name);
    const words = error ? [say(error.text), ...error.log].find(says) : undefined;
    input.setAttribute("aria-invalid", String(words !== undefined));
    input.setAttribute("aria-describedby", `${input.id}_trouble`);
    text(`${input.id}_trouble`, words ?? "");
    if (words !== undefined && input.closest("details")) input.closest("details").open = true;
  }
}
