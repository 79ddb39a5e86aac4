// A sound, and a notification of the browser, when a person is needed or it ends; only if asked for.
import { recall, remember, say } from "./words.js";

const TONES = { // Hz, one after the other
  person: [660, 880], confirm: [660, 880], emergency: [440, 440, 440], failed: [440, 330],
  done: [660, 660], stopped: [660, 660],
};
const TONE_S = 0.25;
const asked = document.getElementById("alerts");
let sound = null;
let last = null;

function play(tones) {
  sound ??= new AudioContext();
  sound.resume(); // allowed once somebody has clicked or typed
  tones.forEach((hertz, i) => {
    const tone = new OscillatorNode(sound, { frequency: hertz });
    const volume = new GainNode(sound, { gain: 0.3 });
    tone.connect(volume).connect(sound.destination);
    tone.start(sound.currentTime + i * TONE_S);
    tone.stop(sound.currentTime + (i + 0.8) * TONE_S);
  });
}

function notify(now) {
  if (globalThis.Notification?.permission !== "granted") return;
  try { new Notification(say(now.headline), { body: say(now.detail), tag: "rotcal" }); } catch { /* phones: sound alone */ }
}

// Every change to a state that calls for a person is announced once; what a page finds at its start is not.
export function announce(now) {
  const call = `${now.kind} ${now.instruction}`;
  const known = last === null || call === last || !(now.kind in TONES);
  last = call;
  if (known || !asked.checked) return;
  play(TONES[now.kind]);
  notify(now);
}

export function prepare() {
  asked.checked = recall("alerts") === "on";
  asked.addEventListener("change", () => {
    remember("alerts", asked.checked ? "on" : "off");
    if (!asked.checked) return;
    play(TONES.person);
    globalThis.Notification?.requestPermission();
  });
  const wake = () => { if (asked.checked) (sound ??= new AudioContext()).resume(); };
  for (const kind of ["pointerdown", "keydown"]) addEventListener(kind, wake, { once: true });
}
