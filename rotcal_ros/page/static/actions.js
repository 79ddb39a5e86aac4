// What a person asks for: continue, stop, confirm a table.
import { number, offerLanguages, say, sentence, t, text } from "./words.js";

let token = "";
let answering = false; // a Continue has been sent and not been answered
let dead = false;
const by = (id) => document.getElementById(id);

export function useToken(given) { token = given; }

export function disable(off) {
  dead = off;
  for (const id of ["stop", "review"]) by(id).disabled = off;
  by("resume").disabled = off || answering;
  if (off) for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close("no");
}

async function ask(what, values = {}) {
  text("answer", "…");
  try {
    const response = await fetch(`/${what}`, {
      method: "POST",
      headers: { "content-type": "application/json", "x-rotcal-token": token },
      body: JSON.stringify(values),
    });
    const words = await response.text();
    const answer = response.headers.get("content-type")?.includes("json") ? JSON.parse(words) : { message: words };
    const seen = what === "stop" && answer.success; // the large line says "Stopping", then "Stopped"
    text("answer", seen ? "" : sentence(say(answer.message)));
    setTimeout(() => text("answer", ""), answer.success ? 6000 : 30000);
    return Boolean(answer.success);
  } catch {
    text("answer", t("The server of this page does not answer: it is not known whether the request arrived."));
    return false;
  }
}

async function resume(instruction) { // what is looked at is what is done
  if (answering) return;
  answering = true;
  disable(dead);
  const done = await ask("resume", { instruction });
  answering = false;
  disable(dead);
  if (done) by("headline").focus(); // the button is gone
}

export function prepare(state) {
  offerLanguages();
  by("resume").addEventListener("click", () => resume(state.now.instruction));
  by("stop").addEventListener("click", () => by("stop_dialog").showModal());
  by("stop_dialog").addEventListener("close", () => {
    if (by("stop_dialog").returnValue === "yes") ask("stop");
    by("stop_dialog").returnValue = "no";
  });
  by("copy").addEventListener("click", copy);
  let confirmation = "";
  by("review").addEventListener("click", () => {
    confirmation = state.offer.confirmation; // what is looked at is what is confirmed
    text("apply_hash", confirmation);
    by("apply_simulated").hidden = !state.offer.simulated;
    text("apply_change", change(state.offer));
    by("apply_dialog").showModal();
    by("secret").focus();
  });
  by("apply_not_now").addEventListener("click", () => by("apply_dialog").close("no"));
  by("apply_dialog").addEventListener("close", () => {
    const secret = by("secret").value;
    by("secret").value = "";
    if (by("apply_dialog").returnValue === "yes") ask("apply", { confirmation, secret });
    by("apply_dialog").returnValue = "no";
  });
}

async function copy() {
  getSelection().selectAllChildren(by("command")); // what a browser refuses to copy is ready for Ctrl-C
  try {
    await navigator.clipboard.writeText(by("command").textContent);
    text("copied", t("Copied"));
  } catch { // only for pages of this machine, or encrypted ones
    text("copied", document.execCommand("copy") ? t("Copied") : t("Press Ctrl+C"));
  }
}

export function change(offer) {
  if (!offer.angles_deg.length) return "";
  const changes = ["", "_reverse"].flatMap((side) => offer[`after${side}_arcsec`]
    .map((after, i) => Math.abs(after - offer[`before${side}_arcsec`][i])));
  return t("Largest change of the correction: {0}″.", number(Math.max(...changes)));
}
