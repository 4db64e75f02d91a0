// The camera's picture with the virtual objects: a click or Enter places another one.

import { byId, element, replaceKeepingFocus } from "../lib/dom";
import { sessionPath, type Api } from "../lib/api";
import { PictureView } from "../lib/picture";
import { latestOnly } from "../lib/signal";
import { USUAL, type ObjectFile, type PlacedObject, type PlacedObjects, type Quality, type Shape, type Surface } from "../objects";
import type { State } from "../state";
import { objectHandles } from "./handles";
import { showNotes } from "./notes";
import { notify, reportError } from "./notices";

/** The GLB file for new objects. */
let chosenFile: ObjectFile | null = null;

const PLACES = "Click a surface to place an object there, drag one to move it. Keyboard: arrows move the cross, Enter places.";
/** Why nothing is placed while the timeline shows an earlier frame. */
export const EARLIER = "This is an earlier frame: press Live to place objects.";
const TURN_DEG = 15;
const SLOW = "Rendering: the first picture of a server takes up to a minute";
const SLOW_MS = 6000;
const CROSS_STEP = 0.02; // of the picture, for an arrow key; with Shift five times as much

export function cameraPanel(api: Api, state: State, objects: PlacedObjects): void {
  const image = byId<HTMLCanvasElement>("picture-image");
  const view = new PictureView(image);
  const button = byId<HTMLButtonElement>("picture-button");
  const crossMark = byId("picture-cross");
  const cross = { x: 0.5, y: 0.6 };
  let loadedPast = "";

  const show = () => {
    const past = state.shownEntry.value !== null ? state.entry : null;
    const picture = objects.composite.value ?? state.picture.value;
    button.disabled = picture === null || past !== null;
    if (past) {
      return loadPast();
    }
    loadedPast = "";
    if (picture) {
      void showPicture(picture.blob, String(picture.frame), `Frame ${picture.frame}`);
    } else {
      view.clear();
      showText("");
    }
  };
  const showText = (text: string) => {
    byId("camera-frame").textContent = text;
    byId("picture-waiting").hidden = text !== "";
  };
  const showPicture = async (picture: Blob, frame: string, text: string) => {
    try {
      if (await view.show(picture, frame)) {
        showText(text);
      }
    } catch {
      notify(`The browser cannot decode the picture of frame ${frame}.`);
    }
  };

  const loadPast = latestOnly(async () => {
    const [id, entry] = [state.selected.value, state.shownEntry.value !== null ? state.entry : null];
    const wanted = `${id}/${entry?.index}`;
    if (id && entry && wanted !== loadedPast) {
      try {
        const file = await api.file(`${sessionPath(id)}/history/${entry.index}/colour`);
        if (state.shownEntry.value !== null && state.selected.value === id) {
          loadedPast = wanted;
          await showPicture(file!.blob, String(entry.index), `Frame ${entry.index}, thumbnail`);
        }
      } catch (error) {
        reportError(error);
      }
    }
  });

  const place = (x: number, y: number) => {
    const intrinsics = state.camera.value?.intrinsics;
    if (intrinsics) {
      putChosen(objects, { pixel: [x * intrinsics.width, y * intrinsics.height] });
    }
  };

  const handles = objectHandles(state, objects);
  button.addEventListener("click", (event) => {
    if (event.detail === 0) {
      return place(cross.x, cross.y); // Enter or the space bar
    }
    if (!handles.isClick()) {
      return;
    }
    const { left, top, width, height } = image.getBoundingClientRect();
    place((event.clientX - left) / width, (event.clientY - top) / height);
  });
  button.addEventListener("keydown", (event) => {
    const step = CROSS_STEP * (event.shiftKey ? 5 : 1);
    const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
    if (move) {
      event.preventDefault();
      cross.x = clamp(cross.x + move[0]!);
      cross.y = clamp(cross.y + move[1]!);
      showCross();
    }
  });
  const showCross = () => {
    crossMark.style.left = `${100 * cross.x}%`;
    crossMark.style.top = `${100 * cross.y}%`;
  };
  showCross();

  state.picture.watch(() => {
    show();
    if (objects.list.value.length > 0 && state.shownEntry.value === null) {
      objects.update();
    }
  });
  state.shownEntry.watch(show);
  objects.composite.watch(show);
  let slow = 0;
  objects.busy.watch((busy) => {
    const badge = byId("picture-busy");
    badge.hidden = !busy;
    badge.textContent = "Rendering";
    clearTimeout(slow);
    slow = busy ? window.setTimeout(() => (badge.textContent = SLOW), SLOW_MS) : 0;
  });
  objectTools(state, objects);
  byId<HTMLSelectElement>("object-quality").addEventListener("change", ({ target }) => {
    objects.quality = (target as HTMLSelectElement).value as Quality;
    objects.update();
  });
  byId("object-form").addEventListener("submit", (event) => event.preventDefault());
  listenToFile(api, state);
}

/** The placed objects, and what can be done with the selected one. */
function objectTools(state: State, objects: PlacedObjects): void {
  const [shape, material] = [byId<HTMLSelectElement>("object-shape"), byId<HTMLSelectElement>("object-material")];
  const size = byId<HTMLInputElement>("object-size");
  let filled = ""; // what the form shows of the selected object
  const fill = () => {
    const selected = objects.list.value.find(({ name }) => name === objects.selected.value);
    const values = selected ? JSON.stringify([selected.name, selected.material, selected.size_m]) : "";
    if (selected && values !== filled) {
      material.value = selected.material;
      size.value = centimetres(selected.size_m ?? usualSize_m(selected.shape, selected.file));
    }
    filled = values;
  };
  const show = () => {
    const selected = objects.selected.value;
    fill();
    replaceKeepingFocus(byId("objects"), objects.list.value.map((object) => chip(object, objects)));
    byId("object-tools").hidden = !objects.canUndo && !objects.canRedo && objects.list.value.length === 0;
    for (const id of ["object-left", "object-right"]) {
      byId<HTMLButtonElement>(id).disabled = selected === null;
    }
    byId<HTMLButtonElement>("object-undo").disabled = !objects.canUndo;
    byId<HTMLButtonElement>("object-redo").disabled = !objects.canRedo;
    showHelp();
  };
  const showHelp = () => {
    const { value: selected } = objects.selected;
    const help = selected === null ? PLACES : `Click a surface to move ${selected} there. Click its name again to place other objects.`;
    byId("picture-help").textContent = state.shownEntry.value === null ? help : EARLIER;
  };
  state.shownEntry.watch(showHelp);
  objects.list.watch(show);
  objects.selected.watch(show);
  const turn = (degrees: number) => objects.selected.value && objects.turn(objects.selected.value, degrees);
  byId("object-left").addEventListener("click", () => turn(TURN_DEG));
  byId("object-right").addEventListener("click", () => turn(-TURN_DEG));
  byId("object-undo").addEventListener("click", () => objects.undo());
  byId("object-redo").addEventListener("click", () => objects.redo());
  addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const key = event.ctrlKey || event.metaKey ? event.key.toLowerCase() : "";
    if (target.matches("input:is([type=text], [type=number], [type=password])")) {
      return; // they have their own undo
    }
    if (key === "z" || key === "y") {
      event.preventDefault();
      (event.shiftKey || key === "y" ? () => objects.redo() : () => objects.undo())();
    } else if (["Delete", "Backspace"].includes(event.key) && objects.selected.value && (target === document.body || target.closest("#camera, #room"))) {
      objects.remove(objects.selected.value); // a Mac's Delete key is Backspace
    }
  });
  shape.addEventListener("change", () => showUsual(shape.value as Shape));
  size.addEventListener("change", () => {
    const size_m = typedSize_m() ?? usualSize_m(shape.value as Shape);
    size.value = centimetres(size_m); // within its limits
    if (objects.selected.value && size_m !== null) {
      objects.resize(objects.selected.value, size_m);
    }
  });
  material.addEventListener("change", () => objects.selected.value && objects.setMaterial(objects.selected.value, material.value as Surface));
}

/** Ask for a GLB file when that is chosen, and upload it; when the question is cancelled, a sphere is chosen. */
function listenToFile(api: Api, state: State): void {
  const shape = byId<HTMLSelectElement>("object-shape");
  const input = byId<HTMLInputElement>("object-file");
  const choose = byId<HTMLButtonElement>("object-choose"); // Safari opens no file dialog when a list changes
  const option = shape.querySelector<HTMLOptionElement>('option[value="file"]')!;
  const without = () => {
    shape.value = chosenFile ? "file" : "sphere";
    showUsual(shape.value as Shape);
    showChoose();
  };
  const showChoose = () => (choose.hidden = shape.value !== "file");
  shape.addEventListener("change", () => {
    showChoose();
    if (shape.value === "file") {
      input.click();
    }
  });
  choose.addEventListener("click", () => input.click());
  input.addEventListener("cancel", without);
  input.addEventListener("change", async () => {
    const file = input.files?.[0];
    input.value = "";
    try {
      if (file) {
        const { id, notes = [], ...box } = await api.of(state.selected.value).uploadGlb(file);
        chosenFile = { id, name: file.name, data: file, box };
        option.textContent = file.name;
        shape.value = "file";
        showUsual("file");
        showChoose();
        showNotes(byId<HTMLDetailsElement>("object-notes"), file.name, notes);
      }
    } catch (error) {
      reportError(file && error instanceof Error ? new Error(`${file.name}: ${file.size === 0 ? "is empty" : error.message}`) : error);
      without();
    }
  });
}

/** Place the object that the form describes, or move the selected one. Without a chosen file there is none to place. */
export function putChosen(objects: PlacedObjects, place: PlacedObject["place"]): void {
  const isMissing = chosenFile === null && byId<HTMLSelectElement>("object-shape").value === "file";
  if (isMissing && objects.selected.value === null) {
    return notify("Nothing is placed: choose a GLB file first.", true);
  }
  objects.put({ ...chosen(), place });
}

/** The object that the form describes. */
function chosen(): Pick<PlacedObject, "shape" | "file" | "material" | "size_m"> {
  const value = (id: string) => byId<HTMLSelectElement | HTMLInputElement>(id).value;
  const shape = value("object-shape") as Shape;
  const isOwnSize = shape === "file" && value("object-size") === centimetres(usualSize_m(shape));
  return {
    shape,
    file: shape === "file" ? chosenFile : null,
    material: value("object-material") as Surface,
    size_m: isOwnSize ? null : (typedSize_m() ?? usualSize_m(shape)),
  };
}

/** Show the size and the material that a shape, or the chosen file, usually has. */
function showUsual(shape: Shape): void {
  byId<HTMLSelectElement>("object-material").value = shape === "file" ? "own" : USUAL[shape].material;
  byId<HTMLInputElement>("object-size").value = centimetres(usualSize_m(shape));
}

/** A shape's usual size, or a file's own; null where it is unknown. */
function usualSize_m(shape: Shape, file = chosenFile): number | null {
  return shape === "file" ? (file?.box ? Math.max(...file.box.size_m) : null) : USUAL[shape].size_cm / 100;
}

/** The size that the visitor has typed, within the server's limits; null without a number. */
function typedSize_m(): number | null {
  const { valueAsNumber: size_cm } = byId<HTMLInputElement>("object-size");
  return size_cm > 0 ? Math.min(100, Math.max(1e-4, size_cm / 100)) : null;
}

function centimetres(size_m: number | null): string {
  return size_m === null ? "" : String(Number((100 * size_m).toPrecision(4)));
}

function chip({ name, material }: PlacedObject, objects: PlacedObjects): HTMLLIElement {
  const label = material === "own" ? name : `${name}, ${material}`;
  const isSelected = objects.selected.value === name;
  const select = {
    class: "chip-name",
    type: "button",
    "aria-pressed": String(isSelected),
    title: "Select it to move or turn it",
    "data-name": name,
    click: () => (objects.selected.value = isSelected ? null : name),
  };
  const remove = { type: "button", "aria-label": `Remove ${label}`, click: () => objects.remove(name) };
  return element("li", { class: "chip" }, element("button", select, label), element("button", remove, "×"));
}

function clamp(value: number): number {
  return Math.min(1, Math.max(0, value));
}
