// Recordings that the visitor drops or chooses: uploaded in pieces, then played by the server into a session.

import { RoomLightError, type Recording } from "roomlight";
import { isAway, type Api } from "./lib/api";
import { Signal } from "./lib/signal";

export interface NamedFile {
  /** Folder names and file name, joined by `/`, below the dropped folder. */
  readonly path: string;
  readonly file: Blob;
}

export interface Upload {
  readonly name: string;
  readonly bytes: number;
  readonly sent: number;
  readonly recording: Recording | null;
  readonly error: string | null;
}

const PIECE_BYTES = 4 * 2 ** 20;
const PIECE_RETRIES = 6; // within about 16 s
const PARALLEL_FILES = 4;
const POLL_MS = 500;
const STALLED_MS = 60_000; // a piece of another page takes less
const BUSY = new Set([429, 503]);
const IGNORED = /(^|\/)(\.|Thumbs\.db$|desktop\.ini$)/;

/** One recording on its way: watch `state`; `cancel` stops it and deletes it on the server. */
export class RecordingUpload {
  readonly state: Signal<Upload>;
  private readonly files: readonly NamedFile[];
  private readonly stopped = new AbortController();
  private isListed = false; // on the server already, and not played by this page
  private readonly api: Api;

  constructor(
    api: Api,
    name: string,
    files: readonly NamedFile[],
    private readonly sample = false,
    private readonly session: string | null = sessionName(name),
  ) {
    this.api = api.of(session);
    this.files = files.filter(({ path }) => !IGNORED.test(path));
    const bytes = this.files.reduce((sum, { file }) => sum + file.size, 0);
    this.state = new Signal<Upload>({ name, bytes, sent: 0, recording: null, error: null });
  }

  /** The recording that is part of RoomLight: nothing is uploaded. */
  static ofSample(api: Api): RecordingUpload {
    return new RecordingUpload(api, "Sample room", [], true);
  }

  /** One that is on the server already, such as one of this page before it was loaded again. */
  static of(api: Api, recording: Recording): RecordingUpload {
    const upload = new RecordingUpload(api, recording.name, [], false, recording.session);
    const error = recording.problem ? RoomLightError.fromProblem(recording.problem).message : null;
    upload.isListed = true;
    upload.show({ bytes: recording.bytes, sent: recording.received, recording, error });
    return upload;
  }

  get isDone(): boolean {
    const { recording, error } = this.state.value;
    return error !== null || recording?.status === "finished" || recording?.status === "failed";
  }

  /** Whether it has been uploaded, and nobody plays it. */
  get canPlay(): boolean {
    return this.isListed && this.state.value.recording?.status === "ready";
  }

  /** Play one that is on the server already; as `run`. */
  async play(playing: (session: string) => void): Promise<void> {
    this.isListed = false;
    await this.replay(this.state.value.recording!.id, playing).catch((error: unknown) => this.fail(error));
  }

  /** Upload and play; `playing` is called with the session once the server plays it. */
  async run(playing: (session: string) => void): Promise<void> {
    const { name, bytes } = this.state.value;
    try {
      const recording = await (this.sample ? this.api.addSample() : this.api.createRecording(name, bytes, this.files.length));
      this.show({ recording });
      if (this.stopped.signal.aborted) {
        return await this.cancel(); // cancelled while the server made it
      }
      await this.send(recording.id);
      await this.replay(recording.id, playing);
    } catch (error) {
      this.fail(error);
    }
  }

  /** Follow it while it is uploaded and played; other requests would only keep it on the server. */
  async watch(): Promise<void> {
    const { recording } = this.state.value;
    if (recording?.status === "playing" || recording?.status === "uploading") {
      await this.follow(recording.id).catch((error: unknown) => this.fail(error));
    }
  }

  /** Stop the upload or the replay, and delete the files on the server. The session stays. */
  async cancel(): Promise<void> {
    this.stopped.abort();
    const { recording } = this.state.value;
    if (recording) {
      await this.api.deleteRecording(recording.id).catch((error: RoomLightError) => {
        if (error.status !== 404) {
          throw error; // otherwise it is deleted already
        }
      });
    }
  }

  private async send(id: string): Promise<void> {
    const waiting = [...this.files];
    const worker = async () => {
      for (let next = waiting.shift(); next && !this.isDone; next = waiting.shift()) {
        await this.sendFile(id, next);
      }
    };
    await Promise.all(Array.from({ length: PARALLEL_FILES }, worker));
  }

  private async sendFile(id: string, { path, file }: NamedFile): Promise<void> {
    let offset = 0;
    do {
      const piece = file.slice(offset, offset + PIECE_BYTES);
      await this.sendPiece(id, path, offset, piece);
      offset += piece.size;
      this.show({ sent: this.state.value.sent + piece.size });
    } while (offset < file.size && !this.isDone); // a piece of another file may have been refused
  }

  /** Send a piece; after a lost connection or while the server is busy send it again, unless the first one had arrived. */
  private async sendPiece(id: string, path: string, offset: number, piece: Blob): Promise<void> {
    let isRepeated = false;
    const beforeRetry = async () => void (isRepeated = true);
    try {
      await this.api.putPiece(id, path, offset, piece, { signal: this.stopped.signal, retries: PIECE_RETRIES, beforeRetry });
    } catch (error) {
      if (!(isRepeated && error instanceof RoomLightError && error.kind === "upload-offset")) {
        throw error; // otherwise an earlier attempt arrived, and its answer was lost
      }
    }
  }

  private async replay(id: string, playing: (session: string) => void): Promise<void> {
    const session = this.session ?? sessionName(this.state.value.name);
    const recording = await this.api.replay(id, session);
    this.show({ recording });
    playing(recording.session ?? session);
    await this.follow(id);
  }

  private fail(error: unknown): void {
    if (!this.stopped.signal.aborted) {
      this.show({ error: error instanceof Error ? error.message : String(error) });
    }
  }

  private async follow(id: string): Promise<void> {
    let [received, changed_ms] = [-1, performance.now()];
    while (!this.stopped.signal.aborted && !this.isDone && !this.canPlay) {
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      const recording = await this.api.recording(id).catch((error: RoomLightError) => {
        if (isAway(error) || BUSY.has(error.status)) {
          return null; // the replay goes on
        }
        throw error;
      });
      if (recording) {
        this.show({ recording, ...(this.isListed ? { sent: recording.received } : {}) });
      }
      if (recording && recording.received !== received) {
        [received, changed_ms] = [recording.received, performance.now()];
      } else if (recording?.status === "uploading" && performance.now() - changed_ms > STALLED_MS) {
        throw new Error("The upload was interrupted: clear it and choose the recording again.");
      }
      if (recording?.problem) {
        throw RoomLightError.fromProblem(recording.problem);
      }
    }
  }

  private show(change: Partial<Upload>): void {
    this.state.value = { ...this.state.value, ...change };
  }
}

/** The files of a drop: of the dropped folder, or the dropped files themselves. */
export async function droppedFiles(transfer: DataTransfer): Promise<{ name: string; files: NamedFile[] } | null> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const [first] = entries;
  if (!first) {
    return null;
  }
  if (entries.length === 1 && first.isDirectory) {
    return { name: first.name, files: await filesOf(first as FileSystemDirectoryEntry, "") };
  }
  const files = await Promise.all(
    entries.map((entry) =>
      entry.isDirectory
        ? filesOf(entry as FileSystemDirectoryEntry, `${entry.name}/`)
        : fileOf(entry as FileSystemFileEntry).then((file) => [{ path: file.name, file }]),
    ),
  );
  return { name: first.name, files: files.flat() };
}

/** The files of a file input; those of a folder without the folder's own name. */
export function chosenFiles(list: FileList): { name: string; files: NamedFile[] } | null {
  const files = [...list].map((file) => ({ path: file.webkitRelativePath.split("/").slice(1).join("/") || file.name, file }));
  const name = list[0]?.webkitRelativePath.split("/")[0] || list[0]?.name;
  return name ? { name, files } : null;
}

async function filesOf(folder: FileSystemDirectoryEntry, prefix: string): Promise<NamedFile[]> {
  const reader = folder.createReader();
  const found: NamedFile[] = [];
  for (;;) {
    const entries = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (entries.length === 0) {
      return found; // a reader gives at most 100 entries at a time
    }
    for (const entry of entries) {
      if (entry.isDirectory) {
        found.push(...(await filesOf(entry as FileSystemDirectoryEntry, `${prefix}${entry.name}/`)));
      } else {
        found.push({ path: prefix + entry.name, file: await fileOf(entry as FileSystemFileEntry) });
      }
    }
  }
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((resolve, reject) => entry.file(resolve, reject));
}

/** A session's id for a recording: its name with letters that an id may have, and a number that makes it new. */
function sessionName(name: string): string {
  const plain = name.replace(/\.r3d$/i, "").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "");
  return `${plain.slice(0, 48) || "recording"}-${Date.now().toString(36).slice(-4)}`;
}
