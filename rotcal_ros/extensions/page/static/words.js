// Texts: everything from the cell enters the page as text, never as markup.
export function text(id, words) {
  const place = document.getElementById(id);
  if (place.textContent !== words) place.textContent = words;
}

// A text of ours with its places {0}, {1} filled; say: words from the server, a phrase is [text, parts].
export const t = (words, ...parts) => words.replace(/\{(\d)\}/g, (_, place) => parts[place]);
export const say = (words) => (Array.isArray(words) ? t(words[0], ...words.slice(1).map(say)) : words);

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
export const number = (value, digits = 2) => value.toFixed(digits).replace("-", "−");
export const unit = (name) => (name === "arcsec" ? "″" : ` ${name}`);
