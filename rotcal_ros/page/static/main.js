// The connection: one stream of events. What arrives is shown, and so is its silence.
import { show } from "./sections.js";
import { redraw } from "./charts.js";
import { clock, t, text, translatePage } from "./words.js";
import * as actions from "./actions.js";
import * as alerts from "./alerts.js";

const SILENCE_MS = 4000; // the page hears something every second
const RETRY_MS = 2000;
const state = {};
let source = null;
let heard = null;
let tried = 0;
let ended = false;

function connect() {
  source?.close();
  tried = Date.now();
  source = new EventSource("/events");
  source.addEventListener("state", (event) => {
    for (const name of Object.keys(state)) delete state[name];
    take(event);
  });
  source.addEventListener("change", take);
  source.addEventListener("tick", take);
  source.onerror = () => {
    if (ended) source.close();
    else if (source.readyState === EventSource.CLOSED) setTimeout(connect, RETRY_MS);
  };
}

function take(event) {
  const { time_s, token, ...sections } = JSON.parse(event.data);
  heard = Date.now();
  if (token) actions.useToken(token);
  Object.assign(state, sections);
  ended = Boolean(state.ended);
  document.body.className = ended ? "ended" : "live";
  text("alive", t("Live {0}", clock(time_s, true)));
  show(sections, state, Boolean(token));
  alerts.announce(state.now);
  if (ended) {
    source.close();
    banner(t("Switched off at {0}", clock(time_s)), t("Final state: this page is no longer updated."));
    text("alive", t("Ended {0}", clock(time_s)));
    actions.disable(true);
  } else {
    document.getElementById("lost").hidden = true;
    actions.disable(false);
  }
}

function banner(large, small) {
  const place = document.getElementById("lost");
  if (place.hidden || place.firstChild?.data !== large) {
    const words = document.createElement("small");
    words.textContent = small;
    place.replaceChildren(large, words);
  }
  place.hidden = false;
}

function watch() {
  if (ended || heard === null || Date.now() - heard < SILENCE_MS) return;
  document.body.className = "dead";
  text("alive", t("No contact"));
  document.title = `${t("No contact")} – rotcal`;
  banner(t("Connection lost at {0}", clock(heard / 1000, true)),
    t("The data below are out of date. The calibration may still be running; this page keeps trying to reconnect."));
  actions.disable(true);
  if (Date.now() - tried < SILENCE_MS) return; // an attempt gets the time to be answered
  if (source.readyState === EventSource.CLOSED || Date.now() - heard > 5 * SILENCE_MS) connect();
}

setInterval(watch, 500);
let resizing = 0;
addEventListener("resize", () => { clearTimeout(resizing); resizing = setTimeout(redraw, 150); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
translatePage();
actions.prepare(state);
alerts.prepare();
connect();
