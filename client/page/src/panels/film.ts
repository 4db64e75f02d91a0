// A film of the recording that plays in the session, with the placed objects: range, quality, progress, cancel.

import type { Recording } from "roomlight";
import type { Api } from "../lib/api";
import { byId } from "../lib/dom";
import { asRequest, type PlacedObjects, type Quality } from "../objects";
import type { State } from "../state";
import { offer } from "./downloads";
import { messageOf, reportError } from "./notices";

/** Of the server: see `MAX_FILM_FRAMES` and `MAX_FILM_BYTES` there. */
const MOST_FRAMES = 300;
const MOST_BYTES = 128 * 2 ** 20;
const POLL_MS = 500;
const NO_RECORDING =
  "This session is not played from a recording on this server. Of a stream the server keeps keyframes alone: record the room, and open the recording here.";

/** The session's recording, and what the recordings of its token take. */
interface Known {
  readonly recording: Recording | null;
  readonly bytes: number;
  readonly limit_bytes: number;
}

export function filmPanel(api: Api, state: State, objects: PlacedObjects): void {
  const dialog = byId<HTMLDialogElement>("film-dialog");
  const [make, cancel, save] = ["film-make", "film-cancel", "film-save"].map((id) => byId<HTMLButtonElement>(id)) as [
    HTMLButtonElement, HTMLButtonElement, HTMLButtonElement,
  ];
  const [from, length] = [byId<HTMLInputElement>("film-from"), byId<HTMLInputElement>("film-length")];
  const bar = byId<HTMLProgressElement>("film-progress");
  let known: Known | null = null;
  let refused = ""; // the last request of this dialog
  let isAsking = false; // that request has no answer so far
  const own = () => api.of(state.selected.value);
  let polling = false;

  /** First frame and number of frames. */
  const range = (fps: number) => ({ first: Math.round(from.valueAsNumber * fps), frames: Math.round(length.valueAsNumber * fps) });
  const show = () => {
    const film = known?.recording?.film ?? null;
    const isRunning = film?.status === "reading" || film?.status === "making";
    const refusal = known === null ? "Asking the server" : refusalOf(known, objects, range(known.recording?.film_fps ?? 1));
    make.disabled = isAsking || isRunning || refusal !== null;
    cancel.hidden = bar.hidden = !isRunning;
    save.hidden = film?.status !== "ready";
    const done = film ? `${film.frame} of ${film.frames || "?"}` : "";
    bar.max = Math.max(1, film?.frames ?? 1);
    bar.value = film?.frame ?? 0;
    const texts = { reading: `Reading the room: frame ${done}`, making: `Making frame ${done}`, ready: "The film is ready", failed: "" };
    byId("film-text").textContent = refused || (film ? (film.problem?.detail ?? texts[film.status]) : "");
    byId("film-refusal").textContent = isRunning ? "" : (refusal ?? "");
    byId("film-text").className = refused || film?.problem ? "error" : "hint";
  };
  const read = async () => {
    const { recordings, bytes, limit_bytes } = await own().recordings();
    const recording = recordings.find(({ session }) => session !== null && session === state.selected.value) ?? null;
    known = { recording, bytes, limit_bytes };
    show();
  };
  /** Follow the recording while the dialog is open. */
  const follow = async () => {
    if (polling) {
      return;
    }
    polling = true;
    try {
      for (; dialog.open; await new Promise((resolve) => setTimeout(resolve, POLL_MS))) {
        await read();
      }
    } catch (error) {
      dialog.close();
      reportError(error);
    } finally {
      polling = false;
    }
  };
  const change = (ask: (recording: Recording) => Promise<unknown>) => async () => {
    refused = "";
    isAsking = true;
    show();
    try {
      await ask(known!.recording!);
      await read();
    } catch (error) {
      refused = messageOf(error);
    } finally {
      isAsking = false;
      show();
    }
  };

  byId("open-film").addEventListener("click", () => {
    byId<HTMLSelectElement>("film-quality").value = objects.quality;
    known = null;
    refused = "";
    show();
    dialog.showModal();
    void follow();
  });
  make.addEventListener("click", change((recording) => {
    const quality = byId<HTMLSelectElement>("film-quality").value as Quality;
    const { first, frames } = range(recording.film_fps!);
    return own().makeFilm(recording.id, { objects: objects.list.value.map(asRequest), quality, first, frames });
  }));
  cancel.addEventListener("click", change(({ id }) => own().deleteFilm(id)));
  save.addEventListener("click", change(async ({ id }) => {
    const file = await own().file(`v1/recordings/${id}/film`);
    offer(file!.blob, `${state.selected.value}.mp4`);
  }));
  from.addEventListener("input", show);
  length.addEventListener("input", show);
  objects.list.watch(show);
  state.selected.watch((id) => (byId<HTMLButtonElement>("open-film").disabled = id === null));
}

/** Why the server would not make this film; null: it would. */
function refusalOf({ recording, bytes, limit_bytes }: Known, objects: PlacedObjects, { first, frames }: { first: number; frames: number }): string | null {
  if (recording === null) {
    return NO_RECORDING;
  }
  const { film_frames: count, film_fps: fps } = recording;
  if (count === null || fps === null) {
    return "The server has not opened the recording yet.";
  }
  if (objects.list.value.length === 0) {
    return "Place an object first: a film shows the recording with objects in it.";
  }
  if (objects.list.value.some(({ pose }) => pose === null)) {
    return "The server has not placed an object yet.";
  }
  if (!(first >= 0 && first < count)) {
    return `The film must begin from 0 s to before ${(count / fps).toFixed(1)} s, where the recording ends.`;
  }
  if (!(frames >= 1 && frames <= MOST_FRAMES)) {
    return `A film has 1 to ${MOST_FRAMES} frames, so at most ${(MOST_FRAMES / fps).toFixed(1)} s of this recording.`;
  }
  if (bytes + MOST_BYTES > limit_bytes) {
    const [used, limit] = [bytes, limit_bytes].map((value) => Math.round(value / 2 ** 20));
    return `Recordings and films take ${used} of ${limit} MB, and a film may take 128 MB: clear a recording first.`;
  }
  return null;
}
