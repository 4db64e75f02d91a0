// Files of the light at the selected probe, of the room and of the picture.

import { sessionPath, type Api } from "../lib/api";
import { byId, element } from "../lib/dom";
import type { PlacedObjects } from "../objects";
import type { State } from "../state";
import { notify, reportError } from "./notices";

const READ_MS = 60_000; // the browser reads a file after the click

interface Download {
  readonly label: string;
  readonly title: string;
  readonly ending: string;
  /** Path of the file for a session and a probe. */
  readonly path: (session: string, probe: string) => string;
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
  light("HDR", "hdr", "hdr", "Panorama, Radiance"),
  light("PNG", "png", "png", "Panorama, 8 bits"),
  light("KTX2", "ktx2", "ktx2", "Cube map"),
  {
    label: "USDZ",
    title: "Scene with a dome light",
    ending: "usdz",
    path: (session, probe) => `${sessionPath(session)}/usdz?name=${encodeURIComponent(probe)}`,
    needsProbe: true,
  },
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
    const start = () => void save(api, state, download);
    return { download, button: element("button", { class: "button", type: "button", title: download.title, click: start }, download.label) };
  });
  const picture = element("button", { class: "button", type: "button", title: "The camera's picture with objects", click: savePicture }, "Picture");
  byId("downloads").replaceChildren(...buttons.map(({ button }) => button), picture);

  function savePicture(): void {
    const shown = objects.composite.value ?? state.picture.value;
    if (shown) {
      offer(shown.blob, `${state.selected.value}-${shown.frame}.jpg`);
    }
  }
  const enable = () => {
    for (const { download, button } of buttons) {
      button.disabled = download.needsProbe ? state.selectedProbe.value === null : state.mesh.value === null;
    }
    picture.disabled = state.picture.value === null;
  };
  state.selectedProbe.watch(enable);
  state.mesh.watch(enable);
  state.picture.watch(enable);
}

async function save(api: Api, state: State, { path, ending, needsProbe }: Download): Promise<void> {
  const [session, probe] = [state.selected.value, state.selectedProbe.value ?? ""];
  if (!session) {
    return;
  }
  try {
    const file = await api.file(path(session, probe));
    const name = `${session}${needsProbe ? `-${probe}` : ""}.${ending}`;
    offer(file!.blob, name);
    notify(`Saved ${name}`, true);
  } catch (error) {
    reportError(error);
  }
}

function offer(file: Blob, name: string): void {
  const url = URL.createObjectURL(file);
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), READ_MS);
}
