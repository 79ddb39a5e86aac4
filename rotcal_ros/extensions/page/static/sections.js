// From a section of the state to its place on the page.
import { draw } from "./charts.js";
import { drawView, facts } from "./plan_view.js";
import { clock, duration, element, number, say, sentence, text, unit } from "./words.js";
import { change } from "./actions.js";

const by = (id) => document.getElementById(id);
let component = "ECC";

export function show(sections, state, whole) {
  for (const [name, render] of Object.entries(RENDER)) {
    if (!whole && !(name in sections)) continue;
    try { render(state[name], state); } catch (error) { console.error(name, error); }
  }
  document.title = title(state);
}

function title({ now, steps, cell }) {
  const mark = ["person", "confirm", "emergency"].includes(now.kind) ? "▶ " : "";
  const place = steps ? `${steps.step}/${steps.total} ` : "";
  return `${mark}${place}${say(now.headline)}${cell.simulated ? " (simulated)" : ""} – rotcal`;
}

const RENDER = {
  cell(cell) {
    text("item", [cell.item || "Rotary table", cell.serial].filter(Boolean).join(" "));
    text("method", [cell.axis && `axis ${cell.axis}`, cell.method].filter(Boolean).join(" · "));
    const known = cell.simulated !== null;
    by("reality").className = cell.simulated ? "reality simulated" : "reality";
    by("reality").hidden = !known;
    text("reality", cell.simulated ? "SIMULATED" : "REAL MACHINE");
  },
  now(now, state) {
    const headline = say(now.headline);
    by("now").dataset.kind = now.kind;
    text("headline", headline);
    by("headline").className = headline.length > 50 ? "long" : "";
    text("detail", sentence(say(now.detail)));
    task(state);
    text("command", now.command);
    by("go_on").hidden = !now.command;
    text("copied", "");
    by("resume").hidden = !now.resume;
    by("stop").hidden = !now.stop;
    by("review").hidden = now.kind !== "confirm";
  },
  steps(steps) {
    text("step", steps ? String(Math.min(steps.step, steps.total)) : "–");
    text("total", steps ? `of ${steps.total}` : "");
    by("bar").value = steps ? steps.step / steps.total : 0;
    text("end", steps?.end_s ? clock(steps.end_s) : "–");
    text("left", steps?.end_s ? `in ${duration(steps.end_s - Date.now() / 1000)}` : "");
    text("rejected", steps ? String(steps.rejected) : "–");
  },
  standing(standing) {
    const { largest_arcsec: largest, rms_arcsec: rms, goal_arcsec: goal, course, withheld } = standing;
    if (withheld) {
      text("uncertainty", "not stated");
      text("goal", withheld);
      by("standing_chart").hidden = true;
      text("standing_words", `U is not stated: ${withheld}.`);
      return;
    }
    text("uncertainty", largest === null ? "–" : `${number(largest)}″`);
    const reached = rms === null ? "unknown" : `${number(rms)}″${rms <= goal ? ", reached" : ""}`;
    const aim = goal === null ? "" : `goal: rms of U ${number(goal)}″, now ${reached}`;
    text("goal", ["largest of the curve", aim].filter(Boolean).join("; "));
    const columns = [course.map((p) => p[0]), course.map((p) => p[1])];
    by("standing_chart").hidden = !course.length;
    const words = "Largest U (k = 2) of the curve, against the number of accepted steps.";
    const about = goal === null ? "" : ` The goal is for the rms of U about the mean: ${number(goal)}″, now ${reached}.`;
    text("standing_words", course.length ? words + about : `Not known yet.${about}`);
    if (course.length) draw("standing_chart", { data: columns, series: [{ label: "U", colour: "blue" }], unit: "″", zero: true, words });
  },
  deviations(found) {
    const names = found ? found.curves.map((c) => c.name) : [];
    if (names.length && !names.includes(component)) component = names[0];
    choices(names, found);
    curve(found);
    marks(found?.marks ?? []);
  },
  view: (_, state) => view(state),
  pointing: (_, state) => view(state),
  task: (_, state) => { view(state); task(state); },
  table_deg: (_, state) => { view(state); task(state); },
  lengths(lengths) {
    text("length_title", lengths?.label ?? "Length");
    text("length", lengths?.now ?? "–");
    text("length_trouble", lengths?.trouble ?? "");
  },
  length_course(course) {
    by("length_chart").hidden = !course.length;
    if (course.length) {
      draw("length_chart", { data: [course.map((p) => p[0]), course.map((p) => p[1])], unit: "",
        series: [{ label: "length", colour: "blue" }], x: { time: true, values: times }, words: "length over the last minute, mm" });
    }
  },
  temperatures(sensors) {
    by("temperatures").replaceChildren(...sensors.map((s) => {
      const line = element("p", `${number(s.now_c)} °C `, "big");
      const drift = s.drift_k_per_h === null ? "" : `, drift ${number(s.drift_k_per_h)} K/h`;
      line.append(element("small", `${s.sensor}: ${number(s.low_c)} to ${number(s.high_c)} °C${drift}`));
      return line;
    }));
    if (!sensors.length) by("temperatures").append(element("p", "No temperature received yet.", "nothing"));
    const [first] = sensors;
    by("temperature_chart").hidden = !first;
    if (first) {
      draw("temperature_chart", { data: [first.course.map((p) => p[0]), first.course.map((p) => p[1])], unit: "",
        series: [{ label: first.sensor, colour: "orange" }], x: { time: true, values: times }, words: `temperature ${first.sensor}, ${number(first.now_c)} °C` });
    }
  },
  rejections(rows) {
    text("rejected_last", rows.length ? `last: ${rows[0].place}` : "");
    fill("rejections", rows, "None.", (row) => [
      element("time", clock(row.time_s, true)),
      element("span", `${sentence(row.place)}: ${row.reason}`)]);
  },
  nodes(nodes, state) {
    if (!state.deviations) {
      const solver = nodes.find((n) => n.name === "solver")?.words ?? "";
      text("curve_words", `No deviations yet. ${solver ? `Solver: ${solver}.` : ""}`);
    }
    by("nodes").replaceChildren(...nodes.map((n) => state_line(n.name, n.words, ["", "warn", "bad", "bad"][n.level])));
  },
  streams(streams) {
    by("streams").replaceChildren(...streams.map((s) => {
      const silent = s.silent_s !== null && s.silent_s > 1;
      return state_line(s.topic, silent ? `silent for ${number(s.silent_s, 1)} s` : `${number(s.rate_hz, s.rate_hz < 10 ? 1 : 0)} per second`, silent ? "bad" : "");
    }));
  },
  recording(recording) {
    const lines = [];
    if (recording) {
      lines.push(state_line("bag", `${recording.messages} messages in ${recording.file}`));
      lines.push(state_line("lost", recording.losses.length ? recording.losses.join(", ") : "nothing", recording.lost ? "bad" : ""));
      if (recording.free_gb !== null) lines.push(state_line("disk", `${number(recording.free_gb, 1)} GB free`, recording.free_gb < 2 ? "bad" : ""));
    }
    by("recording").replaceChildren(...lines);
  },
  log(rows) {
    fill("log", rows, "None.", (row) => [
      element("time", clock(row.time_s, true)),
      (() => { const line = element("span", row.text); line.prepend(element("span", `${row.node}: `, "who")); return line; })()]);
  },
  offer(offer) {
    by("offer").hidden = !offer;
    if (!offer) return;
    const facts = [["hash", offer.confirmation || "none"], ["verdict", offer.verdict + (offer.simulated ? " (SIMULATED)" : "")], ["table", offer.in_force],
      ["remainder", offer.residual], ["bridge", offer.bridge]].filter(([, words]) => words);
    if (offer.angles_deg.length) facts.push(["change", change(offer)]);
    if (offer.applied) facts.push(["applied", "the controller holds this table"]);
    else if (offer.why_not && offer.why_not !== offer.bridge) facts.push(["apply", offer.why_not]);
    by("offer_facts").replaceChildren(...facts.flatMap(([name, words]) => [element("dt", name), element("dd", words, name === "hash" ? "hash" : "")]));
    by("offer_chart").hidden = !offer.angles_deg.length;
    if (offer.angles_deg.length) draw_offer(offer);
    else text("offer_words", "");
  },
};

function draw_offer(offer) {
  const sides = [["", "blue", "increasing angle"]];
  const same = ["after", "before"].every((name) => String(offer[`${name}_reverse_arcsec`]) === String(offer[`${name}_arcsec`]));
  if (!same) sides.push(["_reverse", "orange", "decreasing angle"]);
  const data = [offer.angles_deg], series = [], bands = [];
  for (const [side, colour, way] of sides) {
    const [before, after, wide] = ["before", "after", "expanded"].map((name) => offer[`${name}${side}_arcsec`]);
    data.push(before, after, after.map((v, i) => v + wide[i]), after.map((v, i) => v - wide[i]));
    series.push({ label: `now, ${way}`, colour: same ? "soft" : colour, dash: [0.5, 0.4] }, { label: `after, ${way}`, colour },
      { hidden: true, colour }, { hidden: true, colour });
    bands.push([series.length - 1, series.length]);
  }
  const ways = same ? "" : " Blue for increasing angle, orange for decreasing angle.";
  text("offer_words", `Correction by the controller. Line: with this table; band: its U (k = 2); dashed: during the measurement, as far as known.${ways}`);
  draw("offer_chart", { data, series, bands, unit: "″", x: angles,
    words: `correction of the controller now (dashed) and with this table (line), by angle; ${change(offer)}${ways}` });
}

function marks(found) {
  by("marks").hidden = !found.length;
  by("marks").replaceChildren(...found.map((m) => element("span", sentence(m.line), `mark ${m.kind}`)));
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
  text("curve_title", shown ? `Deviation ${shown.name} ${found.final ? "" : "so far"}` : "Deviation so far");
  by("curve").hidden = !shown;
  if (!shown) return;
  const values = shown.values.filter((v) => v !== null);
  const wide = shown.values.map((_, i) => shown.expanded[i] ?? null); // null: withheld or unknown
  const known = wide.filter((u) => u !== null);
  const range = values.length ? `${number(Math.min(...values))} to ${number(Math.max(...values))}${unit(shown.unit)}` : "no values";
  const band = found.withheld ? `U is not stated: ${found.withheld}`
    : known.length ? `band: expanded uncertainty, k = 2, at most ${number(Math.max(...known))}${unit(shown.unit)}` : "U not known";
  const words = `${shown.name} at ${found.angles_deg.length} angles from ${found.observations} observations, ${range}; ${band}`;
  const edge = (sign) => shown.values.map((v, i) => (v === null || wide[i] === null ? null : v + sign * wide[i]));
  text("curve_words", `${words}.`);
  draw("curve", {
    data: [found.angles_deg, shown.values, edge(1), edge(-1)],
    series: [{ label: shown.name, colour: "blue", points: true }, { hidden: true, colour: "blue" }, { hidden: true, colour: "blue" }],
    bands: [[2, 3]], unit: unit(shown.unit), x: angles, words });
}

const angles = { values: (_, splits) => splits.map((v) => `${number(v, 0)}°`), incrs: [1, 5, 15, 30, 45, 90] };
const times = (_, splits) => splits.map((v) => clock(v, true));

function view(state) {
  if (!state.view) { text("view_words", "Shown once the plan has been announced."); by("view").replaceChildren(); return; }
  const { pointing: p, now, table_deg } = state;
  drawView(by("view"), state.view, p, now.kind === "person" ? (state.task ?? {}) : null, table_deg);
  text("view_words", p ? `Table at ${number(p.table_angle_deg, 1)}°, ${p.visited_deg.length} of ${state.view.angles_deg.length} angles visited. ${sentence(p.place)}.` : "");
}

function task({ now, task: asked, view: seen, table_deg }) {
  const placed = now.kind === "person" && asked?.at && seen;
  for (const id of ["task_view", "task_facts"]) by(id).hidden = !placed;
  by("instruction").hidden = !(now.kind === "person" && asked && !asked.again);
  text("instruction_words", sentence(now.instruction));
  if (!placed) return;
  drawView(by("task_view"), { ...seen, targets: [], stands: [] }, null, asked, table_deg);
  by("task_facts").replaceChildren(...facts(asked, table_deg).flatMap(([name, words]) => [element("dt", name), element("dd", words)]));
}

function fill(id, rows, nothing, parts) {
  const lines = rows.map((row) => { const line = element("li"); line.append(...parts(row)); return line; });
  by(id).replaceChildren(...(lines.length ? lines : [element("li", nothing, "nothing")]));
}

function state_line(name, words, kind = "") {
  const line = element("li");
  line.append(element("span", name, "name"), element("span", words, `${kind} words`));
  line.title = words;
  return line;
}
