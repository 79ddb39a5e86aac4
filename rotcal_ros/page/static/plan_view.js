// The cell seen from above, in SVG: table, angles, targets, where the instrument stands, its beam.
// In a pause: where it is to stand, its angle and its distance, instead of the beam of the last step.
import { number, t } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const radians = (degrees) => (degrees * Math.PI) / 180;
const mm = (metres) => `${number(metres * 1000, 0)} mm`;

function shape(name, values, kind) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  if (kind) made.setAttribute("class", kind);
  return made;
}

// Where a person is to put something: angle and distance as they are measured, and as they are drawn.
export function place(task, table_deg) {
  const [x, y, z] = task.at;
  const from = task.rides ? (table_deg ?? 0) : 0;
  const angle = (((Math.atan2(y, x) * 180) / Math.PI) + 360) % 360;
  const radius = Math.hypot(x, y);
  const drawn = radians(from + angle);
  return { angle, radius, height: z, from, rides: task.rides, at: [radius * Math.cos(drawn), radius * Math.sin(drawn)] };
}

// Draws task alone, with its angle and its distance, where there are no targets beside it.
export function drawView(where, view, pointing, task, table_deg) {
  const goal = task?.at ? place(task, table_deg) : null;
  const known = [...view.targets, ...view.stands];
  const reach = Math.max(0.05, ...known.map(([x, y]) => Math.hypot(x, y)), goal?.radius ?? 0);
  const far = known.map(([x, y]) => Math.hypot(x, y)).filter((r) => r > 0);
  const table = Math.min(0.45 * reach, 1.35 * Math.min(...far, reach));
  const rim = Math.max(table, 0.22 * reach, goal && task.rides ? 1.15 * goal.radius : 0);
  const half = 1.12 * Math.max(reach, 1.2 * rim);
  const svg = shape("svg", { viewBox: `${-half} ${-half} ${2 * half} ${2 * half}`, role: "img" });
  svg.setAttribute("aria-label", words(view, table_deg, task, goal));
  const thin = 0.008 * half;
  svg.append(shape("circle", { cx: 0, cy: 0, r: rim, "stroke-width": 2 * thin }, "table"));
  const visited = new Set(pointing?.visited_deg ?? []);
  for (const angle of view.angles_deg) {
    const [c, s] = [Math.cos(radians(angle)), -Math.sin(radians(angle))];
    svg.append(shape("line", {
      x1: 0.86 * rim * c, y1: 0.86 * rim * s, x2: 1.14 * rim * c, y2: 1.14 * rim * s,
      "stroke-width": (visited.has(angle) ? 4 : 2) * thin, "stroke-linecap": "round",
    }, visited.has(angle) ? "mark visited" : "mark"));
  }
  if (table_deg !== null) svg.append(...zero(table_deg, rim, thin));
  for (const [x, y] of view.stands) svg.append(shape("circle", { cx: x, cy: -y, r: 2.4 * thin, "stroke-width": thin }, "stand"));
  for (const [x, y] of view.targets) svg.append(shape("circle", { cx: x, cy: -y, r: 1.8 * thin }, "target"));
  if (goal) svg.append(...placing(goal, rim, thin, !view.targets.length));
  else if (pointing && !task) svg.append(...beam(pointing, thin));
  where.replaceChildren(svg);
}

function beam({ target: [x, y], stand }, thin) {
  const drawn = [shape("circle", { cx: x, cy: -y, r: 4 * thin }, "target now")];
  if (stand) {
    const [u, v] = stand;
    drawn.unshift(shape("line", { x1: u, y1: -v, x2: x, y2: -y, "stroke-width": 1.6 * thin }, "beam"),
      shape("circle", { cx: u, cy: -v, r: 4.5 * thin }, "stand now"));
  }
  return drawn;
}

// The zero mark of the table, where the table stands now.
function zero(table_deg, rim, thin) {
  const [c, s] = [Math.cos(radians(table_deg)), -Math.sin(radians(table_deg))];
  return [shape("line", { x1: 0.72 * rim * c, y1: 0.72 * rim * s, x2: rim * c, y2: rim * s, "stroke-width": 5 * thin }, "zero"),
    label("0°", 0.62 * rim * c, 0.62 * rim * s, 10 * thin, "zero_words")];
}

function placing({ at: [x, y], angle, radius, from, rides }, rim, thin, whole) {
  const spot = shape("circle", { cx: x, cy: -y, r: 7 * thin, "stroke-width": 2.5 * thin }, "place");
  if (!whole) return [spot];
  const [start, end, r] = [radians(from), radians(from + angle), 0.4 * Math.min(rim, radius)];
  const on = (a, far) => [far * Math.cos(a), -far * Math.sin(a)];
  const size = 13 * thin;
  const middle = on((start + end) / 2, r + 1.6 * size);
  const beside = on(end + Math.PI / 2, 2.4 * size); // next to the line, outside of the angle
  return [
    shape("line", { x1: 0, y1: 0, x2: on(start, 0.55 * rim)[0], y2: on(start, 0.55 * rim)[1], "stroke-width": thin, "stroke-dasharray": `${4 * thin} ${3 * thin}` }, "reach"),
    shape("path", { d: `M ${on(start, r)} A ${r} ${r} 0 ${angle > 180 ? 1 : 0} 0 ${on(end, r)}`, "stroke-width": 2 * thin }, "reach"),
    shape("line", { x1: 0, y1: 0, x2: x, y2: -y, "stroke-width": 2 * thin }, "reach"),
    spot,
    ...(rides ? [] : [label("x", ...on(start, 0.62 * rim), size, "place_words")]),
    label(`${number(angle, 1)}°`, ...middle, size, "place_words"),
    label(mm(radius), 0.6 * x + beside[0], -0.6 * y + beside[1], size, "place_words"),
  ];
}

function label(text, x, y, size, kind) {
  const made = shape("text", { x, y, "font-size": size, "text-anchor": "middle", "dominant-baseline": "middle" }, kind);
  made.textContent = text;
  return made;
}

function words(view, table_deg, task, goal) {
  const all = [t("{0} table angles, {1} targets seen from above", view.angles_deg.length, view.targets.length)];
  if (table_deg !== null) all.push(t("the table is at {0}°", number(table_deg, 1)));
  if (goal) all.push(facts(task, table_deg).map(([name, value]) => `${name}: ${value}`).join(", "));
  return all.join("; ");
}

// What a person needs to know of a place, as names and values.
export function facts(task, table_deg) {
  const { angle, radius, height } = place(task, table_deg);
  const turn = task.rides ? t("counter-clockwise from its 0°") : t("counter-clockwise from the x axis");
  return [
    [task.rides ? t("Angle on the table") : t("Direction from the axis"), `${number(angle, 1)}°, ${turn}`],
    [t("Distance from the axis"), mm(radius)],
    [task.rides ? t("Height above the table") : t("Height above the origin"), mm(height)],
    [t("The table stands at"), table_deg === null ? t("not known") : `${number(table_deg, 1)}°`],
    [t("Number in the data"), String(task.station)],
  ];
}
