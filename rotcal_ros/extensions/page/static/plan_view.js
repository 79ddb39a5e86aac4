// The cell seen from above, in SVG: table, angles, targets, where the instrument stands, its beam.
const SVG = "http://www.w3.org/2000/svg";

function shape(name, values, kind) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  if (kind) made.setAttribute("class", kind);
  return made;
}

export function drawView(place, view, pointing) {
  const known = [...view.targets, ...view.stands];
  const reach = Math.max(0.05, ...known.map(([x, y]) => Math.hypot(x, y)));
  const far = known.map(([x, y]) => Math.hypot(x, y)).filter((r) => r > 0);
  const table = Math.min(0.45 * reach, 1.35 * Math.min(...far, reach));
  const rim = Math.max(table, 0.22 * reach);
  const half = 1.12 * Math.max(reach, 1.2 * rim);
  const svg = shape("svg", { viewBox: `${-half} ${-half} ${2 * half} ${2 * half}`, role: "img" });
  svg.setAttribute("aria-label", words(view, pointing));
  const thin = 0.008 * half;
  svg.append(shape("circle", { cx: 0, cy: 0, r: rim, "stroke-width": 2 * thin }, "table"));
  const visited = new Set(pointing?.visited_deg ?? []);
  for (const angle of view.angles_deg) {
    const a = (angle * Math.PI) / 180;
    const [c, s] = [Math.cos(a), -Math.sin(a)];
    svg.append(shape("line", {
      x1: 0.86 * rim * c, y1: 0.86 * rim * s, x2: 1.14 * rim * c, y2: 1.14 * rim * s,
      "stroke-width": (visited.has(angle) ? 4 : 2) * thin, "stroke-linecap": "round",
    }, visited.has(angle) ? "mark visited" : "mark"));
  }
  for (const [x, y] of view.stands) svg.append(shape("circle", { cx: x, cy: -y, r: 2.4 * thin, "stroke-width": thin }, "stand"));
  for (const [x, y] of view.targets) svg.append(shape("circle", { cx: x, cy: -y, r: 1.8 * thin }, "target"));
  if (pointing) {
    const [x, y] = pointing.target;
    if (pointing.stand) {
      const [u, v] = pointing.stand;
      svg.append(shape("line", { x1: u, y1: -v, x2: x, y2: -y, "stroke-width": 1.6 * thin }, "beam"));
      svg.append(shape("circle", { cx: u, cy: -v, r: 4.5 * thin }, "stand now"));
    }
    svg.append(shape("circle", { cx: x, cy: -y, r: 4 * thin }, "target now"));
  }
  place.replaceChildren(svg);
}

function words(view, pointing) {
  const all = `${view.angles_deg.length} table angles, ${view.targets.length} targets seen from above`;
  return pointing ? `${all}; the table is at ${pointing.table_angle_deg} degrees` : all;
}
