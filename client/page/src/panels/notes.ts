// What a file states and the server left out, guessed or changed: one line, which unfolds.

import { element } from "../lib/dom";

/** Show notes in `line`, an element that stays while its surroundings are drawn again; without notes it is hidden. */
export function showNotes(line: HTMLDetailsElement, subject: string, notes: readonly string[]): HTMLDetailsElement {
  const text = JSON.stringify([subject, notes]);
  line.hidden = notes.length === 0;
  if (line.dataset["shown"] !== text) {
    line.dataset["shown"] = text;
    line.className = "file-notes";
    const count = notes.length === 1 ? "1 note" : `${notes.length} notes`;
    line.replaceChildren(
      element("summary", { title: "What was left out or changed, what it means, and what to do" }, `${count} on ${subject}`),
      element("ul", {}, ...notes.map((note) => element("li", {}, note))),
    );
  }
  return line;
}
