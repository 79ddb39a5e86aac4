// From a section of the state to its place on the page.
import { draw } from "./charts.js";
import { angles, showDeviations } from "./deviations.js";
import { drawView, facts } from "./plan_view.js";
import { clock, duration, element, localised, number, say, sentence, t, text } from "./words.js";
import { change } from "./actions.js";

const by = (id) => document.getElementById(id);

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
  return `${mark}${place}${say(now.headline)}${cell.simulated ? ` (${t("simulated")})` : ""} – rotcal`;
}

const RENDER = {
  cell(cell) {
    text("item", [cell.item || t("Rotary table"), cell.serial].filter(Boolean).join(" "));
    text("method", [cell.axis && t("axis {0}", cell.axis), say(cell.method)].filter(Boolean).join(" · "));
    const known = cell.simulated !== null;
    by("reality").className = cell.simulated ? "reality simulated" : "reality";
    by("reality").hidden = !known;
    text("reality", cell.simulated ? t("SIMULATED") : t("REAL MACHINE"));
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
    text("total", steps ? t("of {0}", steps.total) : "");
    by("bar").value = steps ? steps.step / steps.total : 0;
    text("end", steps?.end_s ? clock(steps.end_s) : "–");
    text("left", steps?.end_s ? t("in {0}", duration(steps.end_s - Date.now() / 1000)) : "");
    text("rejected", steps ? String(steps.rejected) : "–");
  },
  standing(standing) {
    const { largest_arcsec: largest, rms_arcsec: rms, goal_arcsec: goal, course, withheld } = standing;
    if (withheld) {
      text("uncertainty", t("not stated"));
      text("goal", say(withheld));
      by("standing_chart").hidden = true;
      text("standing_words", t("U is not stated: {0}.", say(withheld)));
      return;
    }
    text("uncertainty", largest === null ? "–" : `${number(largest)}″`);
    const reached = rms === null ? t("unknown") : rms <= goal ? t("{0}, reached", `${number(rms)}″`) : `${number(rms)}″`;
    const aim = goal === null ? "" : t("goal: rms of U {0}″, now {1}", number(goal), reached);
    text("goal", [t("largest of the curve"), aim].filter(Boolean).join("; "));
    const columns = [course.map((p) => p[0]), course.map((p) => p[1])];
    by("standing_chart").hidden = !course.length;
    const words = t("Largest U (k = 2) of the curve, against the number of accepted steps.");
    const about = goal === null ? "" : t("The goal is for the rms of U about the mean: {0}″, now {1}.", number(goal), reached);
    text("standing_words", `${course.length ? words : t("Not known yet.")} ${about}`.trim());
    if (course.length) draw("standing_chart", { data: columns, series: [{ label: "U", colour: "blue" }], unit: "″", zero: true, words });
  },
  deviations: showDeviations,
  view: (_, state) => view(state),
  pointing: (_, state) => view(state),
  task: (_, state) => { view(state); task(state); },
  table_deg: (_, state) => { view(state); task(state); },
  lengths(lengths) {
    text("length_title", say(lengths?.label ?? t("Length")));
    text("length", localised(lengths?.now ?? "–"));
    text("length_trouble", say(lengths?.trouble ?? ""));
  },
  length_course(course) {
    by("length_chart").hidden = !course.length;
    if (course.length) {
      draw("length_chart", { data: [course.map((p) => p[0]), course.map((p) => p[1])], unit: "",
        series: [{ label: "length", colour: "blue" }], x: { time: true, values: times }, words: t("length over the last minute, mm") });
    }
  },
  temperatures(sensors) {
    by("temperatures").replaceChildren(...sensors.map((s) => {
      const line = element("p", `${number(s.now_c)} °C `, "big");
      const drift = s.drift_k_per_h === null ? "" : t(", drift {0} K/h", number(s.drift_k_per_h));
      line.append(element("small", t("{0}: {1} to {2} °C{3}", s.sensor, number(s.low_c), number(s.high_c), drift)));
      return line;
    }));
    if (!sensors.length) by("temperatures").append(element("p", t("No temperature received yet."), "nothing"));
    const [first] = sensors;
    by("temperature_chart").hidden = !first;
    if (first) {
      draw("temperature_chart", { data: [first.course.map((p) => p[0]), first.course.map((p) => p[1])], unit: "",
        series: [{ label: first.sensor, colour: "orange" }], x: { time: true, values: times }, words: t("temperature {0}, {1} °C", first.sensor, number(first.now_c)) });
    }
  },
  rejections(rows) {
    text("rejected_last", rows.length ? t("last: {0}", say(rows[0].place)) : "");
    fill("rejections", rows, t("None."), (row) => [
      element("time", clock(row.time_s, true)),
      element("span", `${sentence(say(row.place))}: ${say(row.reason)}`)]);
  },
  nodes(nodes, state) {
    if (!state.deviations) {
      const solver = nodes.find((n) => n.name === "solver");
      text("curve_words", `${t("No deviations yet.")} ${solver ? t("Solver: {0}.", say(solver.words)) : ""}`);
    }
    by("nodes").replaceChildren(...nodes.map((n) => state_line(n.name, say(n.words), ["", "warn", "bad", "bad"][n.level])));
  },
  streams(streams) {
    by("streams").replaceChildren(...streams.map((s) => {
      const silent = s.silent_s !== null && s.silent_s > 1;
      return state_line(s.topic, silent ? t("silent for {0} s", number(s.silent_s, 1)) : t("{0} per second", number(s.rate_hz, s.rate_hz < 10 ? 1 : 0)), silent ? "bad" : "");
    }));
  },
  recording(recording) {
    const lines = [];
    if (recording) {
      lines.push(state_line(t("bag"), t("{0} messages in {1}", recording.messages, recording.file)));
      lines.push(state_line(t("lost"), recording.losses.length ? recording.losses.join(", ") : t("nothing"), recording.lost ? "bad" : ""));
      if (recording.free_gb !== null) lines.push(state_line(t("disk"), t("{0} GB free", number(recording.free_gb, 1)), recording.free_gb < 2 ? "bad" : ""));
    }
    by("recording").replaceChildren(...lines);
  },
  log(rows) {
    fill("log", rows, t("None."), (row) => [
      element("time", clock(row.time_s, true)),
      (() => { const line = element("span", row.text); line.prepend(element("span", `${row.node}: `, "who")); return line; })()]);
  },
  offer(offer) {
    by("offer").hidden = !offer;
    if (!offer) return;
    const facts = [[t("hash"), offer.confirmation || t("none")], [t("verdict"), say(offer.verdict) + (offer.simulated ? ` (${t("SIMULATED")})` : "")], [t("table"), say(offer.in_force)],
      [t("remainder"), say(offer.residual)], [t("bridge"), say(offer.bridge)]].filter(([, words]) => words);
    if (offer.angles_deg.length) facts.push([t("change"), change(offer)]);
    if (offer.applied) facts.push([t("applied"), t("the controller holds this table")]);
    else if (offer.why_not && String(offer.why_not) !== String(offer.bridge)) facts.push([t("apply"), say(offer.why_not)]);
    by("offer_facts").replaceChildren(...facts.flatMap(([name, words]) => [element("dt", name), element("dd", words, name === t("hash") ? "hash" : "")]));
    by("offer_chart").hidden = !offer.angles_deg.length;
    if (offer.angles_deg.length) draw_offer(offer);
    else text("offer_words", "");
  },
};

function draw_offer(offer) {
  const sides = [["", "blue", t("increasing angle")]];
  const same = ["after", "before"].every((name) => String(offer[`${name}_reverse_arcsec`]) === String(offer[`${name}_arcsec`]));
  if (!same) sides.push(["_reverse", "orange", t("decreasing angle")]);
  const data = [offer.angles_deg], series = [], bands = [];
  for (const [side, colour, way] of sides) {
    const [before, after, wide] = ["before", "after", "expanded"].map((name) => offer[`${name}${side}_arcsec`]);
    data.push(before, after, after.map((v, i) => v + wide[i]), after.map((v, i) => v - wide[i]));
    series.push({ label: t("now, {0}", way), colour: same ? "soft" : colour, dash: [0.5, 0.4] }, { label: t("after, {0}", way), colour },
      { hidden: true, colour }, { hidden: true, colour });
    bands.push([series.length - 1, series.length]);
  }
  const ways = same ? "" : ` ${t("Blue for increasing angle, orange for decreasing angle.")}`;
  text("offer_words", `${t("Correction by the controller. Line: with this table; band: its U (k = 2); dashed: during the measurement, as far as known.")}${ways}`);
  draw("offer_chart", { data, series, bands, unit: "″", x: angles,
    words: `${t("correction of the controller now (dashed) and with this table (line), by angle; {0}", change(offer))}${ways}` });
}

const times = (_, splits) => splits.map((v) => clock(v, true));

function view(state) {
  if (!state.view) { text("view_words", t("Shown once the plan has been announced.")); by("view").replaceChildren(); return; }
  const { pointing: p, now, table_deg } = state;
  drawView(by("view"), state.view, p, now.kind === "person" ? (state.task ?? {}) : null, table_deg);
  text("view_words", p ? t("Table at {0}°, {1} of {2} angles visited. {3}.", number(p.table_angle_deg, 1), p.visited_deg.length, state.view.angles_deg.length, sentence(say(p.place))) : "");
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
