// Short notices of errors and events; each can be closed, and the same text is shown once.

import { RoomLightError } from "roomlight";
import { isGone } from "../lib/api";
import { byId, element } from "../lib/dom";

const SHOWN_MS = 12_000;

/** Show a notice. `calm` ones report an event, the others an error. */
export function notify(text: string, calm = false): void {
  const list = byId("notices");
  if ([...list.children].some((notice) => notice.firstElementChild?.textContent === text)) {
    return;
  }
  const notice = element("div", { class: calm ? "notice calm" : "notice" }, element("p", {}, text));
  if (calm) {
    list.querySelectorAll(".calm").forEach((earlier) => earlier.remove()); // nine downloads would hide their own buttons
  }
  const close = element("button", { class: "button quiet", type: "button", click: () => notice.remove() }, "Close");
  notice.append(close);
  list.append(notice);
  setTimeout(() => notice.remove(), SHOWN_MS);
}

/** Show an error; what the visitor aborted is none, and the page itself says that its session has ended. */
export function reportError(error: unknown): void {
  if ((error instanceof DOMException && error.name === "AbortError") || (error instanceof RoomLightError && isGone(error))) {
    return;
  }
  notify(messageOf(error));
}

/** The text of an error: for a notice, or for an open dialog, which lies over the notices. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
