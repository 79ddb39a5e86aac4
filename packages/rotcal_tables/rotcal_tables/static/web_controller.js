// The files of a controller, and what a person accepts of what stands against them.
import { ask, by } from "./web_desk.js";
import { work } from "./web_form.js";
import { failed, link } from "./web_result.js";
import { element } from "./words.js";

export async function writeFiles(event) {
  event.preventDefault();
  nothingWritten();
  const in_force = document.querySelector("[name=in_force]:checked")?.value ?? "";
  const trouble = in_force === "add" ? await sendHeld() : undefined;
  const reply = trouble ? { error: trouble } : await work("controller", {
    in_force,
    controller: by("controller").value,
    settings: by("controller_settings").value,
    spacing: by("spacing").valueAsNumber, // none: null
    axis: by("axis").value.trim(),
    serial: by("serial").value.trim(),
    accept: accepted(),
  });
  if (reply.error) {
    failed("controller_error", reply.error);
    if (reply.error.question?.setting === "accept") offer(reply.error.question.answers);
    return;
  }
  by("controller_words").replaceChildren(...reply.words.map((words) => element("li", words)));
  by("controller_links").replaceChildren(...reply.files.map(link));
}
async function sendHeld() {
  await ask("/files/in_force", undefined, "DELETE");
  for (const file of by("held").files) {
    const reply = await ask(`/files/in_force?name=${encodeURIComponent(file.name)}`, file);
    if (reply.error) return reply.error;
  }
}
export function nothingWritten() {
  by("controller_error").hidden = true;
  for (const id of ["controller_links", "controller_words"]) by(id).replaceChildren();
}

// What is accepted holds for the reason that is shown: anything else in the form takes it back.
export function controllerChanged({ target }) {
  by("held_field").hidden = !by("in_force_add").checked;
  if (!target.closest("#accepted")) nothingAccepted();
}
export function nothingAccepted() {
  by("accepted").querySelectorAll("p").forEach((line) => line.remove());
  by("accepted").hidden = true;
}
function accepted() {
  return [...by("accepted").querySelectorAll(":checked")].map((box) => box.value);
}
function offer(reasons) {
  by("accepted").querySelectorAll("p:not(:has(:checked))").forEach((line) => line.remove());
  const offered = reasons.map(([word, reason]) => {
    const line = element("p"), box = element("input"), label = element("label", reason);
    box.type = "checkbox";
    box.value = word;
    box.id = label.htmlFor = `accept_${word}`;
    line.append(box, " ", label);
    return line;
  });
  by("accepted").append(...offered);
  by("accepted").hidden = false;
  offered[0].firstChild.focus();
}
