// Files of the light at the selected probe, of the room and of the picture.

import { sessionPath, type Api } from "../lib/api";
import { byId, element } from "../lib/dom";
import { asRequest, type PlacedObject, type PlacedObjects } from "../objects";
import type { State } from "../state";
import { notify, reportError } from "./notices";

const READ_MS = 60_000; // the browser reads a file after the click

interface Download {
  readonly label: string;
  readonly title: string;
  readonly ending: string;
  /** Path of the file for a session and a probe. */
  readonly path: (session: string, probe: string) => string;
  /** Path of the file of an earlier frame; without, there is none. */
  readonly pastPath?: (session: string, probe: string, frame: number) => string;
  readonly needsProbe: boolean;
}

const light = (label: string, format: string, ending: string, title: string): Download => ({
  label,
  title,
  ending,
  path: (session, probe) => `${sessionPath(session)}/probes/${encodeURIComponent(probe)}?format=${format}`,
  needsProbe: true,
});

const DOWNLOADS: readonly Download[] = [
  light("EXR", "exr", "exr", "Panorama, linear, half floats"),
  {
    ...light("HDR", "hdr", "hdr", "Panorama, Radiance"),
    pastPath: (session, probe, frame) => `${sessionPath(session)}/history/${frame}/probes/${encodeURIComponent(probe)}`,
  },
  light("PNG", "png", "png", "Panorama, 8 bits"),
  light("KTX2", "ktx2", "ktx2", "Cube map"),
  light("USDZ", "usdz", "usdz", "Dome light, and lamps and windows"),
  light("GLB", "glb", "glb", "Image-based light, and lamps and windows"),
  light("SH", "sh", "sh.json", "Spherical harmonics, JSON"),
  light("Main lights", "main_light", "lights.json", "Main lights, JSON"),
  {
    label: "Mesh",
    title: "The room, GLB",
    ending: "glb",
    path: (session) => `${sessionPath(session)}/mesh`,
    needsProbe: false,
  },
];

export function downloadsPanel(api: Api, state: State, objects: PlacedObjects): void {
  const buttons = DOWNLOADS.map((download) => {
    const start = () => saveLight(download);
    return { download, button: element("button", { class: "button", type: "button", title: download.title, click: start }, download.label) };
  });
  const picture = element("button", { class: "button", type: "button", title: "The camera's picture with objects", click: savePicture }, "Picture");
  const scene = element("button", { class: "button", type: "button", title: "The placed objects, for roomlight composite --scene", click: saveScene }, "Scene");
  byId("downloads").replaceChildren(...buttons.map(({ button }) => button), picture, scene, byId("open-film"));
  byId("share").addEventListener("click", () => void share());

  function savePicture(): void {
    const [session, past] = [state.selected.value!, pastFrame(state)];
    if (past !== null) {
      return void save(api, `${sessionPath(session)}/history/${past}/colour`, `${session}-${past}.jpg`);
    }
    const shown = objects.composite.value ?? state.picture.value;
    if (shown) {
      offer(shown.blob, `${session}-${shown.frame}.jpg`);
    }
  }
  function saveLight({ path, pastPath, ending, needsProbe }: Download): void {
    const [session, probe, past] = [state.selected.value!, state.selectedProbe.value ?? "", pastFrame(state)];
    const name = `${session}${needsProbe ? `-${probe}` : ""}${past === null ? "" : `-${past}`}.${ending}`;
    void save(api, past === null ? path(session, probe) : pastPath!(session, probe, past), name);
  }
  function saveScene(): void {
    const text = JSON.stringify({ objects: objects.list.value.map(sceneObject) }, null, 2);
    offer(new Blob([text], { type: "application/json" }), `${state.selected.value}.scene.json`);
    const files = objects.list.value.flatMap(({ file }) => (file && !file.data ? [file.name] : []));
    if (files.length > 0) {
      notify(`The scene names ${files.join(", ")}: put the files of these objects beside it, by these names.`, true);
    }
  }
  objects.list.watch((list) => (scene.disabled = list.length === 0 || list.some(({ pose }) => pose === null)));
  state.selected.watch((id) => (byId<HTMLButtonElement>("share").disabled = id === null));
  const enable = () => {
    for (const { download, button } of buttons) {
      const isThere = download.needsProbe ? state.selectedProbe.value !== null : state.mesh.value !== null;
      const isOfFrame = pastFrame(state) === null || (download.pastPath !== undefined && state.probe !== null);
      button.disabled = !isThere || !isOfFrame;
      button.title = isOfFrame ? download.title : "This is an earlier frame: press Live to save it.";
    }
    picture.disabled = state.picture.value === null;
  };
  state.watchProbes(enable);
  state.shownEntry.watch(enable);
  state.mesh.watch(enable);
  state.picture.watch(enable);
}

/** An object as `scene.json` has it: poses row by row, files by name. */
function sceneObject(placed: PlacedObject): object {
  const { object, pose, ...kept } = asRequest(placed);
  const rows = [0, 1, 2, 3].map((row) => [0, 1, 2, 3].map((column) => pose![4 * column + row]));
  return { ...kept, ...(object === undefined ? {} : { file: placed.file!.name }), pose: rows };
}

/** Give the page's address, which names the session and the probe, to the phone's menu or the clipboard. */
async function share(): Promise<void> {
  const { href: url, hostname } = location;
  const isOwn = ["localhost", "127.0.0.1", "[::1]"].includes(hostname);
  try {
    if ("share" in navigator && matchMedia("(pointer: coarse)").matches) {
      return await navigator.share({ title: document.title, url });
    }
    await navigator.clipboard.writeText(url);
    notify(`Address copied${isOwn ? ". It works on this computer; roomlight serve --lan serves others too." : ""}`, true);
  } catch (error) {
    if (!(error instanceof DOMException && error.name === "AbortError")) {
      prompt("The address of this session", url); // no clipboard without HTTPS
    }
  }
}

/** The earlier frame that the timeline shows; null: live. */
function pastFrame({ shownEntry, entry }: State): number | null {
  return shownEntry.value === null ? null : (entry?.index ?? null);
}

async function save(api: Api, path: string, name: string): Promise<void> {
  try {
    const file = await api.file(path);
    offer(file!.blob, name);
    notify(`Saved ${name}`, true);
  } catch (error) {
    reportError(error);
  }
}

export function offer(file: Blob, name: string): void {
  const url = URL.createObjectURL(file);
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), READ_MS);
}
