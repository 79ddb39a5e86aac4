// The deviations of a result, or of what is known so far, with their marks.
import { draw } from "./charts.js";
import { element, number, say, sentence, t, text, unit } from "./words.js";

const by = (id) => document.getElementById(id);
let component = "ECC";

export function showDeviations(found) {
  const names = found ? found.curves.map((c) => c.name) : [];
  if (names.length && !names.includes(component)) component = names[0];
  choices(names, found);
  curve(found);
  marks(found?.marks ?? []);
}

function marks(found) {
  by("marks").hidden = !found.length;
  const remarks = found.filter((m) => m.remark).map((m) => element("span", say(m.remark), "remark"));
  by("marks").replaceChildren(...found.map((m) => element("span", sentence(say(m.line)), `mark ${m.kind}`)), ...remarks);
}

function choices(names, found) {
  by("components").replaceChildren(...(names.length > 1 ? names : []).map((name) => {
    const button = element("button", name);
    button.setAttribute("aria-pressed", String(name === component));
    button.addEventListener("click", () => { component = name; choices(names, found); curve(found); });
    return button;
  }));
}

function curve(found) {
  const shown = found?.curves.find((c) => c.name === component);
  text("curve_title", shown ? (found.final ? t("Deviation {0}", shown.name) : t("Deviation {0} so far", shown.name)) : t("Deviation so far"));
  by("curve").hidden = !shown;
  if (!shown) return;
  const values = shown.values.filter((v) => v !== null);
  const wide = shown.values.map((_, i) => shown.expanded[i] ?? null); // null: withheld or unknown
  const known = wide.filter((u) => u !== null);
  const range = values.length ? t("{0} to {1}{2}", number(Math.min(...values)), number(Math.max(...values)), unit(shown.unit)) : t("no values");
  const band = found.withheld ? t("U is not stated: {0}", say(found.withheld))
    : known.length ? t("band: expanded uncertainty, k = 2, at most {0}{1}", number(Math.max(...known)), unit(shown.unit)) : t("U not known");
  const words = t("{0} at {1} angles from {2} observations, {3}; {4}", shown.name, found.angles_deg.length, found.observations, range, band);
  const edge = (sign) => shown.values.map((v, i) => (v === null || wide[i] === null ? null : v + sign * wide[i]));
  text("curve_words", `${words}.`);
  draw("curve", {
    data: [found.angles_deg, shown.values, edge(1), edge(-1)],
    series: [{ label: shown.name, colour: "blue", points: true }, { hidden: true, colour: "blue" }, { hidden: true, colour: "blue" }],
    bands: [[2, 3]], unit: unit(shown.unit), x: angles, words });
}

export const angles = { values: (_, splits) => splits.map((v) => `${number(v, 0)}°`), incrs: [1, 5, 15, 30, 45, 90] };
