// The list of sessions, and which message stands in place of the panels.

import type { SessionSummary } from "roomlight";
import { byId, element, replaceKeepingFocus } from "../lib/dom";
import type { State } from "../state";

export interface SessionEvents {
  readonly onDelete: (session: SessionSummary) => void;
  readonly onRename: (session: SessionSummary) => void;
}

export function sessionsPanel(state: State, events: SessionEvents): void {
  const list = byId("sessions");
  let shown = "";
  let order: readonly string[] = []; // new ones first; looking at one does not move it
  const show = () => {
    const listed = state.sessions.value ?? [];
    order = [...listed.map(({ id }) => id).filter((id) => !order.includes(id)), ...order];
    const sessions = [...listed].sort((one, other) => order.indexOf(one.id) - order.indexOf(other.id));
    showMessage(state);
    const content = JSON.stringify([state.selected.value, sessions.map((session) => [session.id, session.title, session.status, summary(session)])]);
    if (content === shown) {
      return;
    }
    shown = content;
    const row = (session: SessionSummary) => element("li", { class: "session-row" }, button(session, state), ...tools(session, events));
    replaceKeepingFocus(list, sessions.map(row));
    byId("sessions-none").hidden = sessions.length > 0;
  };
  state.sessions.watch(show);
  state.selected.watch(show);
  state.ended.watch(() => showMessage(state));
  state.connection.watch(({ state: kind, text }) => {
    const pill = byId("connection");
    pill.dataset["state"] = kind;
    pill.textContent = text;
    byId("gone").hidden = !["reconnecting", "disconnected"].includes(kind) || state.selected.value === null;
    showMessage(state);
  });
  byId("ended-close").addEventListener("click", () => {
    state.ended.value = null;
    state.selected.value = null;
  });
}

function button(session: SessionSummary, state: State): HTMLButtonElement {
  const { id, title, status, model } = session;
  const isCurrent = id === state.selected.value;
  const failed = status === "failed" ? [element("span", { class: "failed" }, "failed")] : [];
  return element(
    "button",
    {
      class: "session",
      type: "button",
      "data-session": id,
      "data-name": id,
      "aria-current": isCurrent ? "true" : null,
      click: () => {
        state.selected.value = id;
        if (state.ended.value !== null) {
          state.selected.changed(); // joins it again
        }
      },
    },
    element("b", { title: `${id}, model ${model}` }, title || id),
    ...failed,
    element("small", {}, summary(session)),
  );
}

function tools(session: SessionSummary, { onDelete, onRename }: SessionEvents): HTMLButtonElement[] {
  const tool = (what: string, sign: string, click: () => void) => {
    const label = `${what} ${session.title || session.id}`;
    const names = { "aria-label": label, title: label, "data-name": `${what} ${session.id}` };
    return element("button", { class: "button quiet", type: "button", ...names, click }, sign);
  };
  return [tool("Rename", "✎", () => onRename(session)), tool("Delete", "×", () => onDelete(session))];
}

function summary({ frames, idle_s }: SessionSummary): string {
  const idle = idle_s < 90 ? `idle ${Math.round(idle_s)} s` : `idle ${Math.round(idle_s / 60)} min`;
  return `${frames.processed} ${frames.processed === 1 ? "frame" : "frames"} · ${idle_s < 5 ? "active" : idle}`;
}

/** Show the panels of a session, or the message that fits. */
function showMessage(state: State): void {
  const { sessions, selected, ended, connection } = state;
  const isLoading = sessions.value === null;
  const isLost = connection.value.state === "disconnected" && selected.value === null;
  const isWaiting = isLoading || isLost;
  const shown = ended.value !== null ? "ended" : isWaiting ? "loading" : selected.value !== null ? "workspace" : "empty";
  for (const id of ["loading", "empty", "ended", "workspace"]) {
    byId(id).hidden = id !== shown;
  }
  byId("ended-title").textContent = ended.value?.title ?? "";
  byId("ended-text").textContent = ended.value?.text ?? "";
  byId("loading-title").textContent = isLost ? "The server does not answer" : "Loading";
  const help = `Is roomlight serve still running at ${location.host}? The page connects by itself when it is.`;
  byId("loading").querySelector("p")!.textContent = isLost ? help : "The page asks the server for its sessions.";
}
