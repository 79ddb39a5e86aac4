// Charts with uPlot; each place keeps what it shows, so that it can be drawn anew.
import { number } from "./words.js";

const places = new Map();
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const rem = () => parseFloat(getComputedStyle(document.documentElement).fontSize);

// series: [{label, colour, dash, width, points}], data: uPlot's columns, bands: [[upper, lower]]
export function draw(id, { data, series, bands = [], unit = "", words, zero = false, x = {} }) {
  const place = document.getElementById(id);
  place.setAttribute("aria-label", words);
  const old = places.get(id);
  const alike = old && old.chart && JSON.stringify([old.series, bands, unit]) === JSON.stringify([series, bands, unit]);
  if (alike) {
    old.data = data;
    old.chart.setData(data);
    places.set(id, { ...old, data, words });
    return;
  }
  old?.chart?.destroy();
  places.set(id, { data, series, bands, unit, words, zero, x, chart: make(place, data, series, bands, unit, zero, x) });
}

export function redraw() {
  for (const [id, kept] of places) {
    kept.chart?.destroy();
    const place = document.getElementById(id);
    kept.chart = make(place, kept.data, kept.series, kept.bands, kept.unit, kept.zero, kept.x);
  }
}

function make(place, data, series, bands, unit, zero, x) {
  const box = place.getBoundingClientRect();
  if (!box.width) return null;
  const size = rem();
  const axis = {
    stroke: colour("soft"), font: `${0.8 * size}px system-ui, "DejaVu Sans", sans-serif`,
    grid: { stroke: colour("line"), width: 1 }, ticks: { show: false },
  };
  const options = {
    width: Math.floor(box.width), height: Math.floor(box.height), legend: { show: false },
    cursor: { show: false }, padding: [0.5 * size, 1.8 * size, 0, 0],
    scales: { x: { time: Boolean(x.time), ...(x.range ? { range: x.range } : {}) },
      y: { range: (_, low, high) => range(low, high, zero) } },
    axes: [
      { ...axis, size: 1.7 * size, space: (x.time ? 6 : 4) * size, ...(x.values ? { values: x.values } : {}), ...(x.splits ? { splits: x.splits } : {}), ...(x.incrs ? { incrs: x.incrs } : {}) },
      { ...axis, size: 3.9 * size, space: 2 * size, values: (_, splits) => splits.map((v) => `${plain(v, splits)}${unit}`) },
    ],
    series: [{}, ...series.map((s) => ({
      label: s.label, stroke: s.hidden ? "transparent" : colour(s.colour), width: s.hidden ? 0 : (s.width ?? 0.14) * size,
      dash: s.dash ? s.dash.map((d) => d * size) : undefined, spanGaps: true,
      points: { show: Boolean(s.points), size: 0.42 * size, fill: colour(s.colour), stroke: colour(s.colour) },
    }))],
    bands: bands.map((pair) => ({ series: pair, fill: colour("blue_fill") })),
  };
  return new uPlot(options, data, place);
}

function plain(value, splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  const digits = Math.max(0, Math.min(5, Math.ceil(-Math.log10(step) - 1e-9)));
  return number(value, digits);
}

function range(low, high, zero) {
  if (low === null || high === null) return [0, 1];
  if (zero) low = Math.min(0, low);
  const margin = 0.08 * (high - low) || Math.abs(high) * 1e-6 || 1;
  return [zero && low === 0 ? 0 : low - margin, high + margin];
}
