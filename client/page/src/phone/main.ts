// The phone's page: one button that sends what the camera sees to the server that delivered the page.

import { RoomLightError } from "roomlight";
import "../tokens.css";
import { Api } from "../lib/api";
import { PictureView } from "../lib/picture";
import { openCamera, sendPhotos } from "./camera";
import { EMPTY, PhotoLink, StreamLink, type LinkView } from "./link";
import "./phone.css";
import { hasAugmentedReality, requestCameraSession, sendViews } from "./xr";

const NEEDS_TLS =
  "This browser gives its camera to secure pages only. Start the server with roomlight serve --lan, which has TLS, and open its address.";
const HOW = "Press Start and move the phone slowly through the room. The picture shows the light that was found.";
const NO_DEPTH = "This phone measures no depth here. The server estimates it from each picture.";
const PHOTOS =
  "Without WebXR the page sends photos. Each photo gives light of its own: distances and what the camera does not see are estimated.";

const element = <K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className: string,
  text = "",
): HTMLElementTagNameMap[K] => Object.assign(document.createElement(tag), { className, textContent: text });

const NO_CAMERA = "The browser finds no camera on this device.";
/** What to do about the errors of browsers' `getUserMedia`, by name. */
const CAMERA_PROBLEMS: Readonly<Record<string, string>> = {
  NotAllowedError: "The browser may not use the camera: allow it in the settings of this site and press Start again.",
  NotFoundError: NO_CAMERA,
  OverconstrainedError: NO_CAMERA, // Safari's
  NotReadableError: "The camera cannot be read: close other apps that use it and press Start again.",
};

const api = new Api();
/** The id of a new session. */
const newId = () => `phone-${Array.from(crypto.getRandomValues(new Uint8Array(3)), (byte) => byte.toString(16).padStart(2, "0")).join("")}`;
const photosId = newId();

const page = element("main", "phone");
const video = Object.assign(element("video", "camera"), { muted: true, playsInline: true, hidden: true });
const state = element("p", "state");
const note = element("p", "note");
const problem = element("p", "problem");
const panorama = Object.assign(element("canvas", "panorama"), { role: "img", ariaLabel: "Light found: panorama", hidden: true });
const panoramaView = new PictureView(panorama);
const figures = element("dl", "figures");
const button = element("button", "start", "Start");
const tokenForm = Object.assign(element("form", "token"), { hidden: true });
const tokenField = Object.assign(element("input", "field"), { type: "password", autocomplete: "off", id: "token" });
const values = { sent: element("dd", ""), processed: element("dd", ""), seen: element("dd", "") };

function build(): void {
  state.setAttribute("role", "status");
  problem.setAttribute("role", "alert");
  video.setAttribute("aria-label", "Camera picture");
  for (const [label, value] of [
    ["Frames sent", values.sent],
    ["In the light", values.processed],
    ["Sphere seen", values.seen],
  ] as const) {
    const pair = element("div", "");
    pair.append(element("dt", "", label), value);
    figures.append(pair);
  }
  const label = Object.assign(element("label", "", "Token of the server"), { htmlFor: "token" });
  tokenForm.append(label, tokenField, element("button", "button primary", "Use"));
  const link = Object.assign(element("a", "live", "Live page"), { href: "/" });
  page.append(element("h1", "", "RoomLight camera"), state, video, panorama, figures, note, problem, tokenForm, button, link);
  document.body.append(page);
  note.textContent = HOW;
  show(EMPTY);
}

function show(view: LinkView): void {
  state.textContent = view.state;
  state.dataset["kind"] = view.kind;
  values.sent.textContent = String(view.sent);
  values.processed.textContent = String(view.processed);
  values.seen.textContent = view.coverage === null ? "–" : `${Math.round(100 * view.coverage)} %`;
  problem.textContent = view.problem;
  if (view.panorama) {
    panoramaView.show(view.panorama, String(view.processed)).then(() => (panorama.hidden = false), failed);
  }
}

let stop: (() => void) | null = null;

function running(end: (() => void) | null): void {
  stop = end;
  button.textContent = end ? "Stop" : "Start";
  button.dataset["running"] = String(end !== null);
}

/** Ask the phone first: a click counts for a permission only for a moment. */
async function start(): Promise<void> {
  await paired;
  problem.textContent = note.textContent = "";
  if (await augmented) {
    const session = await requestCameraSession(page).catch((error: unknown) => error as Error);
    if (!(session instanceof Error)) {
      return runAugmented(session);
    }
    note.textContent = `WebXR: ${session.message.replace(/\.$/, "")}. `;
  }
  await runPhotos();
}

/** Each AR session has its own origin, and so a session of the server for itself. */
async function runAugmented(session: XRSession): Promise<void> {
  const link = new StreamLink(show);
  running(() => void session.end());
  const noDepth = () => void (note.textContent = NO_DEPTH);
  try {
    await Promise.all([link.open(api.client(), newId()), sendViews(session, link, noDepth)]);
  } finally {
    await session.end().catch(() => undefined); // it has ended already, if Stop was pressed
    link.close();
    running(null);
  }
}

async function runPhotos(): Promise<void> {
  if (!navigator.mediaDevices) {
    throw new Error(NEEDS_TLS);
  }
  note.textContent += PHOTOS;
  const ended = new AbortController();
  const camera = await openCamera();
  try {
    video.srcObject = camera;
    await video.play();
    video.hidden = false;
    running(() => ended.abort());
    await sendPhotos(video, new PhotoLink(show, api, photosId), ended.signal);
  } finally {
    camera.getTracks().forEach((track) => track.stop());
    video.srcObject = null;
    video.hidden = true;
    running(null);
  }
}

function failed(error: unknown): void {
  const isUnauthorized = error instanceof RoomLightError && error.status === 401;
  tokenForm.hidden = !isUnauthorized;
  state.textContent = "Not connected";
  state.dataset["kind"] = "bad";
  const text = error instanceof Error ? (CAMERA_PROBLEMS[error.name] ?? error.message) : String(error);
  problem.textContent = isUnauthorized ? "The server does not know this phone. Scan a new code, each works once, or type a token." : text;
}

addEventListener("hashchange", () => {
  const given = new URLSearchParams(location.hash.slice(1));
  if (given.has("pair") || given.has("token")) {
    location.reload(); // another link was opened in this tab
  }
});
const augmented = hasAugmentedReality();
build();
const paired = api.pair().then((isNew) => isNew && (state.textContent = "Paired, ready"), failed);
button.addEventListener("click", () => {
  if (stop) {
    return stop();
  }
  stop = () => undefined; // until the phone has permitted the camera
  void start()
    .catch(failed)
    .finally(() => (stop = null));
});
tokenForm.addEventListener("submit", (event) => {
  event.preventDefault();
  api.token = tokenField.value;
  tokenField.value = problem.textContent = "";
  tokenForm.hidden = true;
});
