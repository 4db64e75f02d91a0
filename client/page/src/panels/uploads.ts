// Recordings in the list of sessions, with progress and a button to cancel; dropping and choosing them.

import type { Api } from "../lib/api";
import { byId, element } from "../lib/dom";
import { chosenFiles, droppedFiles, RecordingUpload, type NamedFile, type Upload } from "../recordings";
import { showNotes } from "./notes";
import { notify, reportError } from "./notices";

const OBJECT = /\.(glb|gltf|obj|ply|usdz|fbx)$/i;

export interface Uploads {
  /** Show the recordings that are on the server already. */
  readonly resume: () => Promise<void>;
  /** Delete the recordings that play into a session. */
  readonly cancelOf: (session: string) => void;
}

/** `opened` is called with the session that a recording plays into, `failed` if not even a frame of it could be played. */
export function uploadsPanel(api: Api, opened: (session: string) => void, failed: (session: string) => void): Uploads {
  const uploads = new Map<RecordingUpload, HTMLElement>();
  const start = (found: { name: string; files: NamedFile[] } | null) => {
    byId<HTMLDialogElement>("recording-dialog").close();
    if (!found || found.files.length === 0) {
      return notify("There are no files in what was chosen.");
    }
    if (found.files.every(({ path }) => OBJECT.test(path))) {
      return notify(`${found.name} is a 3D object, not a recording of a room. In an open session, choose “GLB file” under Object.`);
    }
    void play(new RecordingUpload(api, found.name, found.files));
  };
  const list = (upload: RecordingUpload) => {
    const item = element("li", { class: "upload" });
    byId("uploads").append(item);
    uploads.set(upload, item);
    upload.state.watch((state) => showUpload(item, state, upload, () => void followed(upload, item, upload.play(opened))));
    return item;
  };
  const play = (upload: RecordingUpload) => followed(upload, list(upload), upload.run(opened));
  const followed = (upload: RecordingUpload, item: HTMLElement, done: Promise<void>) => {
    return done.then(() => {
      const { recording } = upload.state.value;
      item.scrollIntoView({ block: "nearest", inline: "nearest" }); // the strip of a phone
      if (recording?.problem && recording.session && recording.frame === 0) {
        failed(recording.session);
      }
    });
  };
  for (const [button, input] of [["choose-file", "file-input"], ["choose-folder", "folder-input"]] as const) {
    const files = byId<HTMLInputElement>(input);
    byId(button).addEventListener("click", () => files.click());
    files.addEventListener("change", () => {
      start(files.files && chosenFiles(files.files));
      files.value = "";
    });
  }
  const sample = byId<HTMLButtonElement>("play-sample");
  sample.addEventListener("click", () => {
    const upload = RecordingUpload.ofSample(api);
    // a double click plays it once
    upload.state.watch(({ recording, error }) => (sample.disabled = !recording?.session && error === null));
    void play(upload).finally(() => (sample.disabled = false)); // also after it was cancelled
  });
  listenToDrops((transfer) => void droppedFiles(transfer).then(start, reportError));
  const resume = async () => {
    const { recordings } = await api.recordings();
    const own = [...uploads.keys()].map(({ state }) => state.value);
    if (own.some(({ recording, error }) => recording === null && error === null)) {
      return; // one of this page is among them, and does not know its id yet
    }
    for (const recording of recordings.filter(({ id }) => !own.some((upload) => upload.recording?.id === id))) {
      const upload = RecordingUpload.of(api, recording);
      list(upload);
      void upload.watch();
    }
  };
  const cancelOf = (session: string) => {
    for (const [upload, item] of uploads) {
      if (upload.state.value.recording?.session === session) {
        uploads.delete(upload);
        item.remove();
        upload.cancel().catch(reportError);
      }
    }
  };
  return { resume, cancelOf };
}

function showUpload(item: HTMLElement, state: Upload, upload: RecordingUpload, play: () => void): void {
  const { name, recording, error } = state;
  const remove = () => {
    item.remove();
    if (!upload.isDone || recording) {
      upload.cancel().catch(reportError);
    }
  };
  const isPlaying = recording !== null && ["playing", "finished"].includes(recording.status);
  const [done, all] = isPlaying ? [recording.frame, recording.frames ?? 0] : [state.sent, state.bytes];
  const bar = element("progress", { max: Math.max(1, all), value: Math.min(done, Math.max(1, all)), "aria-label": name });
  const status = isPlaying ? `Frame ${done} of ${all || "?"}` : uploadText(state);
  const text = recording?.status === "finished" ? finishedText(state) : status;
  const label = upload.isDone ? "Clear" : "Cancel";
  const button = element("button", { class: "button quiet", type: "button", "aria-label": `${label} ${name}`, click: remove }, label);
  const start = element("button", { class: "button", type: "button", "aria-label": `Play ${name}`, hidden: !upload.canPlay, click: play }, "Play");
  const hadFocus = item.contains(document.activeElement);
  const notes = item.querySelector<HTMLDetailsElement>(".file-notes") ?? element("details");
  const wasOnNotes = notes.contains(document.activeElement);
  item.replaceChildren(
    element("b", {}, name),
    ...(upload.isDone ? [] : [bar]),
    element("div", { class: "row" }, error === null ? element("span", { class: "hint" }, text) : failure(error), start, button),
    showNotes(notes, name, recording?.notes ?? []),
  );
  if (hadFocus) {
    (wasOnNotes ? notes.querySelector("summary")! : button).focus();
  }
}

/** One line, and the server's words under it. */
function failure(error: string): HTMLElement {
  const [, line = error, detail = ""] = /^([^:]{3,60}): (.*)$/s.exec(error) ?? [];
  return detail === "" ? element("span", { class: "error" }, line) : element("details", { class: "error" }, element("summary", {}, line), element("p", {}, detail));
}

function uploadText({ sent, bytes, recording }: Upload): string {
  return recording?.status === "ready" ? "Uploaded" : `Uploading ${(sent / 2 ** 20).toFixed(1)} of ${(bytes / 2 ** 20).toFixed(1)} MB`;
}

function finishedText({ recording }: Upload): string {
  const bad = recording!.unreadable > 0 ? `, ${recording!.unreadable} unreadable` : "";
  return `Played ${recording!.frame} frames${bad}`;
}

function listenToDrops(dropped: (transfer: DataTransfer) => void): void {
  const target = byId("drop");
  let depth = 0; // dragenter and dragleave also come from the children
  const show = (change: number) => {
    depth = Math.max(0, depth + change);
    target.hidden = depth === 0;
  };
  const hasFiles = (event: DragEvent) => event.dataTransfer?.types.includes("Files") ?? false;
  addEventListener("dragenter", (event) => hasFiles(event) && show(1));
  addEventListener("dragleave", (event) => hasFiles(event) && show(-1));
  addEventListener("dragover", (event) => hasFiles(event) && event.preventDefault());
  addEventListener("drop", (event) => {
    depth = 0;
    show(0);
    if (event.dataTransfer && hasFiles(event)) {
      event.preventDefault();
      dropped(event.dataTransfer);
    }
  });
}
