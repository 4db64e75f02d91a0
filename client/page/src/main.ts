// The live page: lists the sessions, joins the selected one, and connects the panels.

import { RoomLightError, type Position, type SessionSummary } from "roomlight";
import { Api, isAway } from "./lib/api";
import { LiveSession } from "./live";
import { PlacedObjects } from "./objects";
import { parts } from "./lib/parts";
import { cameraPanel, EARLIER, putChosen } from "./panels/camera";
import { askForToken, dialogs } from "./panels/dialogs";
import { downloadsPanel } from "./panels/downloads";
import { filmPanel } from "./panels/film";
import { lightPanel } from "./panels/light";
import { notify, reportError } from "./panels/notices";
import { processingPanel } from "./panels/processing";
import { sessionsPanel } from "./panels/sessions";
import { timelinePanel } from "./panels/timeline";
import { uploadsPanel } from "./panels/uploads";
import type { RoomPanel } from "./room/room";
import type { SurfacePoint } from "./room/surface";
import { SharedScene } from "./scene";
import { State } from "./state";

const POLL_MS = 2000;
const REJOIN_MS = 30_000; // for a session whose stream does not open
const MOST_LETTERS = 80; // of a session's name
const PROBE_ABOVE_M = 0.15; // distance of a new probe from the surface that was clicked

const api = new Api();
const wanted = new URLSearchParams(location.hash.slice(1)); // before `showAddress` writes it
const state = new State();
let live: LiveSession | null = null;
let rejoined: { readonly id: string | null; readonly at_ms: number } | null = null; // until its stream opens
let counted = ""; // the session that was shown at the last look at the list, and how many frames it had processed

const objects = new PlacedObjects(state, () => live?.session ?? null, (file) => api.of(state.selected.value).uploadGlb(file), reportOwn);
const shared = new SharedScene(api, state, objects, reportOwn);

sessionsPanel(state, { onDelete: (session) => void removeSession(session), onRename: (session) => void renameSession(session) });
dialogs(api);
const uploads = uploadsPanel(api, (session) => (state.selected.value = session), (session) => void discard(session));
cameraPanel(api, state, objects);
timelinePanel(api, state);
processingPanel(state);
downloadsPanel(api, state, objects);
filmPanel(api, state, objects);
lightPanel(state, {
  onMove: (name, position) => live?.release(name, position),
  onAdd: () => addProbe(pointAhead()),
  onRemove: (name) => live?.untrack(name),
});
let room: RoomPanel | null = null;
requestAnimationFrame(() => setTimeout(() => void startRoom())); // three.js after the first paint

for (const menu of document.querySelectorAll<HTMLDetailsElement>("details.menu")) {
  addEventListener("pointerdown", ({ target }) => !menu.contains(target as Node) && (menu.open = false));
  menu.addEventListener("keydown", ({ key }) => {
    if (key === "Escape" && menu.open) {
      menu.open = false;
      menu.querySelector("summary")!.focus();
    }
  });
}

state.selected.watch((id) => {
  live?.close();
  objects.clear();
  state.clearSession();
  if (id !== (wanted.get("session") ?? id)) {
    state.wantedProbe = null; // of the address's session
  }
  state.ended.value = null;
  document.title = id ? `${id} · RoomLight` : "RoomLight";
  shared.join(null);
  join(id);
  showAddress();
});
state.selectedProbe.watch(showAddress);
state.selected.value = wanted.get("session");
state.wantedProbe = wanted.get("probe");
addEventListener("hashchange", () => {
  const given = new URLSearchParams(location.hash.slice(1));
  if (["session", "probe", "token"].some((key) => given.has(key))) {
    location.reload(); // another address was given to this tab; the link to the panels is none
  }
});
void poll();
// A page with a connection is not kept for the Back button.
addEventListener("pagehide", () => live?.close());
addEventListener("pageshow", ({ persisted }) => persisted && state.ended.value === null && join(state.selected.value));
document.addEventListener("visibilitychange", () => !document.hidden && void readSessions());

/** The address names the session and the probe, so that it can be kept and shared; Back goes to the session before. */
function showAddress(): void {
  const before = new URLSearchParams(location.hash.slice(1)).get("session");
  const isOther = ![null, state.selected.value].includes(before) && state.selected.value !== null;
  const shown = new URLSearchParams();
  for (const [key, { value }] of [["session", state.selected], ["probe", state.selectedProbe]] as const) {
    if (value !== null) {
      shown.set(key, value);
    }
  }
  const address = `${location.pathname}${location.search}${shown.size > 0 ? `#${shown}` : ""}`;
  history[isOther ? "pushState" : "replaceState"](null, "", address);
}

/** Delete a session on the server, with its light and its pictures. */
async function removeSession({ id, title }: SessionSummary): Promise<void> {
  if (!confirm(`Delete the session ${title || id} with its light and its pictures?`)) {
    return;
  }
  try {
    uploads.cancelOf(id);
    await api.deleteSession(id);
    if (state.selected.value === id) {
      state.selected.value = null;
    }
    await readSessions();
  } catch (error) {
    reportError(error);
  }
}

/** Delete the session of a recording that cannot be played: it has no frame. */
async function discard(id: string): Promise<void> {
  try {
    if (state.selected.value === id) {
      state.selected.value = null;
    }
    await api.deleteSession(id);
    await readSessions();
  } catch (error) {
    reportError(error);
  }
}

async function renameSession({ id, title }: SessionSummary): Promise<void> {
  let name: string | undefined = title || id;
  do {
    const most = `at most ${MOST_LETTERS} letters`;
    const rule: string = name.length > MOST_LETTERS ? `${most}, not ${name.length}` : most;
    name = prompt(`Name of the session, for everyone who looks at it (${rule}); empty: its id`, name)?.trim();
    if (name === undefined) {
      return;
    }
  } while (name.length > MOST_LETTERS);
  try {
    await shared.rename(id, name === id ? "" : name);
    await readSessions();
  } catch (error) {
    reportError(error);
  }
}

function join(id: string | null): void {
  const opened = () => {
    if (rejoined?.id === id) {
      notify(`${id} is back`, true);
    }
    rejoined = null;
  };
  live = id === null ? null : new LiveSession(api, state, id, reportOwn, () => shared.join(id), opened);
  void live?.open();
}

/** Show an error of what the page does by itself; that the server is away, which has a cause, the banner says. */
function reportOwn(error: unknown): void {
  if (!(error instanceof RoomLightError && isAway(error) && (error.status > 0 || error.cause !== undefined))) {
    reportError(error);
  }
}

/** The room in 3D; without WebGL the other panels still work. */
async function startRoom(): Promise<void> {
  try {
    const { RoomPanel } = await import("./room/room");
    room = new RoomPanel(state, objects, {
      onDrag: (name, position) => live?.preview(name, position),
      onDrop: (name, position) => live?.release(name, position),
      onPick: pick,
      lightAt: async (positions) => (await live?.lightAt(positions)) ?? null,
      report: reportOwn,
    });
  } catch (error) {
    const reason = error instanceof Error ? error.message : String(error);
    document.getElementById("room-waiting")!.textContent = `The room is not shown: ${reason}.`;
    console.warn(error);
  }
}

function pick(tool: "object" | "probe", { point, normal }: SurfacePoint): void {
  if (tool === "probe") {
    addProbe(point.clone().addScaledVector(normal, PROBE_ABOVE_M).toArray());
  } else if (state.shownEntry.value === null) {
    putChosen(objects, { position: point.toArray() });
  } else {
    notify(EARLIER, true);
  }
}

/** Track a new probe under the first free name, and select it. */
function addProbe(position: Position): void {
  let number = 1;
  while (live?.hasProbe(`probe-${number}`)) {
    number++;
  }
  live?.track(`probe-${number}`, position);
  state.selectedProbe.value = `probe-${number}`;
}

/** A point 1.2 m in front of the camera. */
function pointAhead(): Position {
  const pose = state.camera.value?.camera_to_world;
  return pose ? ([0, 1, 2].map((axis) => pose[12 + axis]! - 1.2 * pose[8 + axis]!) as unknown as Position) : [0, 1, 0];
}

/** Read the sessions now and then; a page in the background asks nothing. */
async function poll(): Promise<void> {
  for (;;) {
    if (!document.hidden) {
      await readSessions();
    }
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
}

async function readSessions(): Promise<void> {
  try {
    const { sessions } = await api.sessions();
    if (state.sessions.value === null) {
      uploads.resume().catch(reportError);
    }
    state.sessions.value = sessions;
    if (state.ended.value === null) {
      shared.read();
    }
    if (state.selected.value === null || state.ended.value !== null) {
      state.connection.value = { state: "live", text: "Connected" };
    }
    live?.showConnection();
    await follow(sessions);
  } catch (error) {
    if (error instanceof RoomLightError && error.status === 401) {
      await askForToken(api);
      live?.close(); // refused as well
      state.ended.value = null;
      return join(state.selected.value);
    }
    if (error instanceof RoomLightError && isAway(error)) {
      state.connection.value = { state: "disconnected", text: "Server not reachable" };
      return;
    }
    reportError(error);
  }
}

/** Show a session where none is shown; join one again that has ended and is back. */
async function follow(sessions: NonNullable<State["sessions"]["value"]>): Promise<void> {
  const { selected, ended } = state;
  if (selected.value === null && ended.value === null && sessions[0]) {
    state.selected.value = sessions[0].id;
  } else if (ended.value !== null && sessions.some(({ id, status }) => id === selected.value && status !== "failed")) {
    const back = selected.value!;
    const isDue = rejoined?.id !== back || performance.now() - rejoined.at_ms > REJOIN_MS;
    const isBack = isDue && (await api.client(0).join(back).then(() => true, () => false)); // one on disk may wait for a place
    if (isBack && back === selected.value && ended.value !== null) {
      rejoined = { id: back, at_ms: performance.now() };
      selected.changed();
    }
  }
  const summary = sessions.find(({ id }) => id === selected.value);
  const count = `${summary?.frames.processed} ${selected.value}`;
  if (count !== counted) {
    live?.refresh(); // frames of a session without probes bring no light message
  }
  counted = count;
}

/** For the tests and scripts/measure.mjs: drawings of the room, time by part, and where a probe is in the window. */
Object.assign(globalThis, {
  roomlightPage: {
    get frames() {
      return room?.view.frames ?? 0;
    },
    get view() {
      return room?.view ?? null;
    },
    get litObjects() {
      return room?.objects.lit ?? [];
    },
    parts,
    probeAt: (name: string) => room?.view.project(room.probes.spheres.get(name)!.position),
  },
});
