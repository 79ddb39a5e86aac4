// What is dropped: each row takes one file, and so does the whole card.
import { ask, by, desk } from "./web_desk.js";
import { form, withSetup, work } from "./web_form.js";
import { asTold, understand } from "./web_reading.js";
import { element, say, t, text } from "./words.js";

const ROLES = { table: t("Measurements"), targets: t("Targets"), setup: t("Set-up file") };

export function files() {
  by("files").replaceChildren(...Object.entries(ROLES).map(([role, words]) => {
    const line = element("li"), name = desk.names[role];
    line.append(element("span", words), element("span", name ?? t("none yet"), name ? "name there" : "name nothing"));
    line.append(name ? away(role, words) : choice(role, words));
    return line;
  }));
}
function choice(role, words) {
  const choose = element("label", t("Choose …"), "button"), input = element("input");
  input.type = "file";
  input.setAttribute("aria-label", `${words}: ${t("choose a file")}`);
  input.addEventListener("change", () => send(role, input.files[0]));
  choose.append(input);
  return choose;
}
function away(role, words) {
  const button = element("button", t("Remove"), "quiet");
  button.setAttribute("aria-label", `${t("Remove")}: ${words}`);
  button.addEventListener("click", async () => {
    await send(role, null);
    by("files").querySelector("input, button").focus();
  });
  return button;
}

async function send(role, file) {
  text("file_trouble", "");
  const reply = await ask(`/files/${role}?name=${encodeURIComponent(file?.name ?? "")}`, file ?? undefined, file ? "POST" : "DELETE");
  if (reply.error) { text("file_trouble", say(reply.error.text)); return; }
  desk.names = reply.names;
  if (role === "table") asTold();
  files();
  if (role === "table" && file) await methodOfTheTable();
  withSetup();
  await understand();
}

async function methodOfTheTable() { // several may fit, and a person may have chosen
  const { methods = [] } = await work("fit");
  if (methods.length && !desk.typed.has("method") && !methods.includes(by("method").value)) {
    by("method").value = methods[0];
    await form();
  }
  const others = [...by("method").options].filter(({ value, selected }) => !selected && methods.includes(value));
  const titles = others.map((option) => option.text).join("; ");
  text("method_fits", titles && t("The columns also fit: {0}", titles));
}

export function dropping(event) {
  event.preventDefault();
  by("dropped").classList.toggle("over", event.type === "dragover");
}
const roleOf = ({ name }) => (/\.ya?ml$/i.test(name) ? "setup" : /^(target|ziel|cible|目标|ターゲット)/i.test(name) ? "targets" : "table");
export async function dropped({ dataTransfer }) {
  const tableLast = [...dataTransfer.files].sort((a, b) => (roleOf(a) === "table") - (roleOf(b) === "table"));
  for (const file of tableLast) await send(roleOf(file), file);
}
