// Before anything is measured: what fits what somebody owns and wants, as rotcal plan advise predicts it.
import { by, fillIn } from "./web_desk.js";
import { field, work } from "./web_form.js";
import { element, number, say, t, text } from "./words.js";

const LIMITS = { // options of the command
  "--minutes": [t("Longest time; empty: any"), "min", ""],
  "--positions": [t("Number of table angles"), "", "12"],
  "--machine-um": [t("How well the machine measures or places a point (k = 1)"), "µm", ""],
  "--set": [t("A setting of an instrument, as solver.u_arcsec=0.5"), "", ""],
};
let units = {};

export async function offerAdvice() {
  if (by("owned").querySelector("p") || !by("advice").querySelector("details").open) return;
  const known = await work("advise", { arguments: [] });
  if (known.error) { refused(known.error); return; }
  units = known.units;
  by("owned").append(...Object.entries(known.instruments).map(([name, words]) => {
    const line = element("p"), box = element("input"), label = element("label", t(words));
    Object.assign(box, { type: "checkbox", value: name, id: `own_${name}` });
    label.htmlFor = box.id;
    line.append(box, " ", label);
    return line;
  }));
  by("wanted").append(...Object.entries(units).map(([name, { unit }]) => field(`want_${name}`, name, asked(), unit)));
  by("limits").append(...Object.entries(LIMITS).map(([name, [words, unit, usual]]) => field(name, words, asked(usual), unit)));
  fillIn();
}
function asked(placeholder = "") {
  return Object.assign(element("input"), { inputMode: "decimal", placeholder });
}

export async function advise(event) {
  event.preventDefault();
  by("advice_error").hidden = true;
  by("ways").replaceChildren();
  text("advising", t("Predicting …"));
  const owned = [...by("owned").querySelectorAll(":checked")].flatMap(({ value }) => ["--own", value]);
  const wanted = Object.keys(units).flatMap((name) => given(`want_${name}`, (u) => ["--want", `${name}=${u}`]));
  const limits = Object.keys(LIMITS).flatMap((name) => given(name, (value) => [name, value]));
  const reply = owned.length && wanted.length
    ? await work("advise", { arguments: [...owned, ...wanted, ...limits] })
    : { error: { text: t("Choose what there is, and state a U that is needed"), log: [] } };
  text("advising", "");
  if (reply.error) refused(reply.error);
  else by("ways").replaceChildren(...reply.ways.map(shown));
}
function given(id, words) {
  const value = by(id).value.trim().replace(",", ".");
  return value ? words(value) : [];
}
function refused({ text: words }) {
  by("advice_error").replaceChildren(element("p", say(words)));
  by("advice_error").hidden = false;
}
function shown(way) {
  const box = element("article"), fits = way.meets ? t("fits") : t("misses what is needed");
  box.append(element("h3", `${t(way.title)} (${way.instrument})`));
  if (way.refused) { box.append(element("p", t("not predicted: {0}", say(way.refused)))); return box; }
  const sizes = Object.entries(units).filter(([name]) => by(`want_${name}`).value.trim()).map(([name, { size, unit }]) =>
    `U(${name}) ${name in way.expanded ? `${number(way.expanded[name] / size, 2)} ${unit}` : t("not determined")}`);
  const work = way.pauses ? [t("{0} × a person’s work, whose time is not counted", way.pauses)] : [];
  box.append(element("p", [fits, t("{0} min", number(way.seconds / 60, 2)), ...sizes, ...work].join(" · ")));
  box.append(element("p", t("not tested for: {0}", way.untested.map((each) => t(each)).join(", ")), "small"));
  const rests = Object.entries(way.rests_on).map(([name, value]) => `${name}=${Array.isArray(value) ? JSON.stringify(value) : value}`).join(", ");
  if (rests) box.append(element("p", t("rests on {0}", rests), "small"));
  const command = element("div", "", "command");
  Object.assign(command, { tabIndex: 0, role: "region", ariaLabel: t("Command") });
  command.append(element("code", way.command));
  box.append(command);
  return box;
}
