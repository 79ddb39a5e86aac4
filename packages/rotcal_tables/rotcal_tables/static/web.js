// The page of rotcal web: a table is dropped, looked at, corrected, solved and taken along.
import { redraw } from "./charts.js";
import { controllerChanged, nothingAccepted, nothingWritten, writeFiles } from "./web_controller.js";
import { begin, by, desk, typed } from "./web_desk.js";
import { dropped, dropping, files } from "./web_files.js";
import { form, oneInstrument, select } from "./web_form.js";
import { readingFields, soon, understand } from "./web_reading.js";
import { solve } from "./web_result.js";
import { measuredAgain, nothingVerified } from "./web_verify.js";
import { offerLanguages, say, t, translatePage } from "./words.js";

translatePage();
offerLanguages();
const { methods, method, controllers } = await begin();
by("method").append(...select(methods.map(([name, title]) => [name, say(title)])).children);
by("method").value = desk.typed.get("method") ?? method;
by("controller").append(...select([["", t("choose …")], ...controllers.map((name) => [name, name])]).children);
by("controller").value = "";
by("reading").append(...readingFields());
files();
await form();
by("held_field").hidden = !by("in_force_add").checked;

for (const name of ["input", "change"]) document.addEventListener(name, typed);
by("method").addEventListener("change", async () => { await form(); understand(); });
by("form").addEventListener("submit", (event) => event.preventDefault());
by("form").addEventListener("change", ({ target }) => { if (target.dataset.name) soon(); });
by("instrument").addEventListener("change", oneInstrument);
by("solve").addEventListener("click", () => { nothingWritten(); nothingAccepted(); nothingVerified(); solve(); });
by("after").addEventListener("change", measuredAgain);
by("controller_form").addEventListener("submit", writeFiles);
by("controller_form").addEventListener("change", controllerChanged);
for (const name of ["dragover", "dragleave", "drop"]) document.addEventListener(name, dropping);
document.addEventListener("drop", dropped);
let resizing = 0;
addEventListener("resize", () => { clearTimeout(resizing); resizing = setTimeout(redraw, 150); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
await understand();
