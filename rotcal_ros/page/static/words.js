// Texts: everything from the cell enters the page as text, never as markup.
export function text(id, words) {
  const place = document.getElementById(id);
  if (place.textContent !== words) place.textContent = words;
}

const catalogues = await fetch("/words").then((answer) => answer.json()).catch(() => ({}));
export const languages = ["en", ...Object.keys(catalogues)];
export const language = [recall("language"), ...navigator.languages.map((code) => code.slice(0, 2))]
  .find((code) => languages.includes(code)) ?? "en";
const texts = catalogues[language] ?? {};
const point = (1.5).toLocaleString(language)[1];

// A text of the catalogue with its places {0}, {1} filled; say: words from the server, [text, parts] is a phrase.
export const t = (words, ...parts) => (texts[words] ?? words).replace(/\{(\d+)[^{}]*\}/g, (whole, place) => parts[place] ?? whole);
export const say = (words) => (Array.isArray(words) ? t(words[0], ...words.slice(1).map(say)) : words);

// Translates what stands in the page itself.
export function translatePage() {
  document.documentElement.lang = language;
  const found = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (found.nextNode()) {
    const node = found.currentNode;
    node.data = node.data.replace(/\S(?:[^]*\S)?/, (words) => t(words.replace(/\s+/g, " ")));
  }
  for (const named of document.querySelectorAll("[aria-label]")) named.ariaLabel = t(named.ariaLabel);
}

export function offerLanguages() {
  const choice = document.getElementById("language");
  for (const code of languages) {
    const name = new Intl.DisplayNames([code], { type: "language" }).of(code);
    choice.append(new Option(name, code, false, code === language));
  }
  choice.addEventListener("change", () => { remember("language", choice.value); location.reload(); });
}

// What this browser keeps for the next visit; some are told to keep nothing.
export function recall(name) { try { return localStorage.getItem(`rotcal.${name}`); } catch { return null; } }
export function remember(name, value) { try { localStorage.setItem(`rotcal.${name}`, value); } catch { /* until it is closed */ } }

export function element(name, words = "", kind = "") {
  const made = document.createElement(name);
  made.textContent = words;
  if (kind) made.className = kind;
  return made;
}

export function clock(time_s, seconds = false) {
  const when = new Date(time_s * 1000);
  const options = { hour: "2-digit", minute: "2-digit", hour12: false };
  if (seconds) options.second = "2-digit";
  const time = when.toLocaleTimeString("en-GB", options);
  const today = when.toDateString() === new Date().toDateString();
  return today ? time : `${when.toLocaleDateString("en-CA")} ${time}`;
}

export function duration(seconds) {
  if (seconds < 90) return `${Math.max(0, Math.round(seconds))} s`;
  const minutes = Math.round(seconds / 60);
  return minutes < 90 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export const sentence = (words) => words.charAt(0).toUpperCase() + words.slice(1);
export const number = (value, digits = 2) => localised(value.toFixed(digits).replace("-", "−"));
export const localised = (words) => words.replace(/(\d)\.(\d)/g, `$1${point}$2`);
export const unit = (name) => (name === "arcsec" ? "″" : ` ${name}`);
