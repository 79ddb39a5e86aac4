// How the table is understood, what has to be asked, and what a person corrects.
import { by, desk, keep } from "./web_desk.js";
import { atFields, field, select, work } from "./web_form.js";
import { element, say, t, text } from "./words.js";

const OURS = { position: t("table position"), angle: t("table angle"), target: t("target"), length: t("length"), place: t("place of the tracer") };
const READING = { // settings of the group sheet that hold for all columns
  "sheet.decimal": [t("decimal mark"), [["", t("as the numbers show")], [".", t("point")], [",", t("comma")]]],
  "sheet.counted_from": [t("first number of positions and targets"), [["", t("as the numbers show")], ["0", "0"], ["1", "1"]]],
};
const nameOf = (name) => OURS[name] ?? name;
let waiting = 0, asked = 0;

export function soon() { atOnce(); waiting = setTimeout(understand, 300); }
export function atOnce() { clearTimeout(waiting); } // a field was left for a button: what it says counts now
export async function understand() {
  by("result").hidden = true;
  for (const id of ["understood", "outcome"]) by(id).hidden = !desk.names.table;
  if (!desk.names.table) return;
  const mine = ++asked;
  by("understood").setAttribute("aria-busy", "true");
  const reply = await work("explain");
  if (mine !== asked) return; // asked again meanwhile
  by("understood").setAttribute("aria-busy", "false");
  trouble(reply.error);
  corrections();
  by("tables").replaceChildren(...(reply.tables ?? []).map((table, place) => shown(table, place === 0)));
  by("solve").disabled = Boolean(reply.error);
}
export function trouble(error) {
  by("error").hidden = !error;
  text("error_words", say(error?.text ?? ""));
  by("error_log").replaceChildren(...(error?.log ?? []).map((line) => element("li", line)));
  by("answers").replaceChildren(...answers(error, correct));
  atFields(error);
}
export function answers(error, chosen) { // buttons for a question, and for all that are asked besides
  const { question } = error ?? {};
  return (question ? [question, ...question.also] : []).map(({ setting, found, answers: ways }, place) => {
    const group = element("div", "", "buttons");
    if (place) group.append(element("p", say(found)));
    group.append(...ways.map(([value, words]) => {
      const button = element("button", words);
      button.addEventListener("click", () => chosen(setting, value));
      return button;
    }));
    return group;
  });
}

export function asTold() { // another table: nothing of it is corrected
  desk.stated.clear();
  desk.columns.clear();
  keep();
}
function correct(name, value) {
  if (name === "sheet.columns") {
    const [ours, ...theirs] = value.split("=");
    desk.columns.set(ours, theirs.join("="));
  } else if (value) desk.stated.set(name, value);
  else desk.stated.delete(name);
  keep();
  understand();
}
function corrections() {
  const made = [
    ...[...desk.columns].map(([ours, theirs]) => undoing(desk.columns, ours, `${nameOf(ours)} = ${theirs}`)),
    ...[...desk.stated].map(([name, value]) => undoing(desk.stated, name, `${name} = ${value}`)),
  ];
  by("corrected").hidden = !made.length;
  by("corrected").replaceChildren(element("span", t("Your corrections:")), ...made);
  for (const name of Object.keys(READING)) by(`set.${name}`).value = desk.stated.get(name) ?? "";
}
function undoing(corrected, key, words) {
  const button = element("button", `${words}  ✕`, "quiet");
  button.setAttribute("aria-label", t("Take back: {0}", words));
  button.addEventListener("click", () => { corrected.delete(key); keep(); understand(); });
  return button;
}
export function readingFields() {
  return Object.entries(READING).map(([name, [words, options]]) => {
    const choice = select(options);
    choice.addEventListener("change", () => correct(name, choice.value));
    return field(`set.${name}`, words, choice);
  });
}

function shown(table, main) {
  const box = element("div", "", "table_of"), grids = element("div", "", "sheets");
  const form = table.form ? t("{0}, {1} rows", say(table.form), table.rows) : t("a table of our own form, read as it stands: {0}", table.header.join(", "));
  if (table.columns.length) grids.append(columnsOf(table, main));
  grids.append(grid(t("First rows as they are solved: metres, numbers from 0"), [t("row"), ...table.header], table.first.map(([row, cells]) => [row, ...cells]), true));
  box.append(element("h3", table.name), element("p", form), grids);
  if (table.remarks.length) box.append(element("p", table.remarks.map(say).join("; "), "small"));
  if (table.aside.length) box.append(element("p", t("not needed: {0}", table.aside.join(", ")), "small"));
  if (table.left_out.length) box.append(leftOut(table.left_out));
  return box;
}
function columnsOf({ name, head, columns }, main) {
  const rows = columns.map((column) => [ours(column, main), theirs(column, head, main), unitOf(column, main)]);
  return grid(t("Columns of {0}", name), [t("means"), t("column of the table"), t("unit")], rows);
}
function leftOut(rows) {
  const more = element("details"), list = element("ul", "", "lines");
  list.append(...rows.map(([row, why]) => {
    const line = element("li");
    line.append(element("span", t("row {0}", row)), element("span", say(why)));
    return line;
  }));
  more.append(element("summary", rows.length === 1 ? t("1 row left out") : t("{0} rows left out", rows.length)), list);
  return more;
}
export function grid(caption, head, rows, numbers = false) {
  const kind = numbers ? "number" : "";
  const box = element("div", "", numbers ? "sheet numbers" : "sheet"), made = element("table"), top = element("tr"), body = element("tbody"), above = element("thead");
  box.tabIndex = 0;
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", caption);
  top.append(...head.map((words) => { const cell = element("th", words, kind); cell.scope = "col"; return cell; }));
  above.append(top);
  body.append(...rows.map((cells) => {
    const line = element("tr");
    line.append(...cells.map((cell) => { const one = element("td", "", kind); one.append(cell); return one; }));
    return line;
  }));
  made.append(element("caption", caption), above, body);
  box.append(made);
  return box;
}

// Boxes to correct a column, in the main table alone: what it means, which of theirs it is, its unit.
function ours({ name, text: head }, main) {
  if (!main || head === null || !["position", "angle"].includes(name)) return nameOf(name);
  return correcting([["position", OURS.position], ["angle", OURS.angle]], name, t("meaning of {0}", head), (meant) => {
    desk.columns.delete(name);
    correct("sheet.columns", `${meant}=${head}`);
  });
}
function theirs({ name, text: chosen, theirs: words }, head, main) {
  if (!main || chosen === null) return say(words);
  const options = [...new Set(head)].filter(Boolean).map((one) => [one, one]);
  return correcting(options, chosen, t("column that is {0}", nameOf(name)), (one) => correct("sheet.columns", `${name}=${one}`));
}
function unitOf({ setting, units, name }, main) {
  if (!setting || !main) return units.length === 1 ? units[0] : "";
  const options = [["", t("as the table states")], ...units.map((unit) => [unit, unit])];
  return correcting(options, desk.stated.get(setting) ?? "", t("unit of {0}", nameOf(name)), (unit) => correct(setting, unit));
}
function correcting(options, value, label, chosen) {
  const choice = select(options, value);
  choice.setAttribute("aria-label", label);
  choice.addEventListener("change", () => chosen(choice.value));
  return choice;
}
