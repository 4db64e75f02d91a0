// The camera's picture with the virtual objects: a click or Enter places another one.

import { byId, element } from "../lib/dom";
import { sessionPath, type Api } from "../lib/api";
import { latestOnly } from "../lib/signal";
import type { PlacedObject, PlacedObjects, Quality, Shape, Surface } from "../objects";
import type { State } from "../state";
import { reportError } from "./notices";

const CROSS_STEP = 0.02; // of the picture, for an arrow key; with Shift five times as much

export function cameraPanel(api: Api, state: State, objects: PlacedObjects): void {
  const image = byId<HTMLImageElement>("picture-image");
  const button = byId<HTMLButtonElement>("picture-button");
  const crossMark = byId("picture-cross");
  const cross = { x: 0.5, y: 0.6 };
  let pastUrl = "";

  const show = () => {
    const past = state.shownEntry.value !== null ? state.entry : null;
    const picture = objects.composite.value ?? state.picture.value;
    if (past) {
      byId("camera-frame").textContent = `Frame ${past.index}, thumbnail`;
      loadPast();
    } else if (picture) {
      image.src = picture.url;
      byId("camera-frame").textContent = `Frame ${picture.frame}`;
    } else {
      image.removeAttribute("src");
      byId("camera-frame").textContent = "";
    }
    byId("picture-waiting").hidden = picture !== null || past !== null;
    button.disabled = picture === null || past !== null;
  };

  const loadPast = latestOnly(async () => {
    const [id, entry] = [state.selected.value, state.shownEntry.value !== null ? state.entry : null];
    if (id && entry) {
      try {
        const file = await api.file(`${sessionPath(id)}/history/${entry.index}/colour`);
        URL.revokeObjectURL(pastUrl);
        pastUrl = URL.createObjectURL(file!.blob);
        if (state.shownEntry.value !== null) {
          image.src = pastUrl;
        }
      } catch (error) {
        reportError(error);
      }
    }
  });

  const place = (x: number, y: number) => {
    const intrinsics = state.camera.value?.intrinsics;
    if (intrinsics) {
      objects.add({ ...chosen(), place: { pixel: [x * intrinsics.width, y * intrinsics.height] } });
    }
  };

  button.addEventListener("click", (event) => {
    if (event.detail === 0) {
      return place(cross.x, cross.y); // Enter or the space bar
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
  objects.busy.watch((busy) => (byId("picture-busy").hidden = !busy));
  objects.list.watch((list) => byId("objects").replaceChildren(...list.map((object) => chip(object, objects))));
  byId<HTMLSelectElement>("object-quality").addEventListener("change", ({ target }) => {
    objects.quality = (target as HTMLSelectElement).value as Quality;
    objects.update();
  });
  byId("object-form").addEventListener("submit", (event) => event.preventDefault());
}

/** The object that the form describes. */
export function chosen(): Pick<PlacedObject, "shape" | "material" | "size_m"> {
  const value = (id: string) => byId<HTMLSelectElement | HTMLInputElement>(id).value;
  const size_cm = Number(value("object-size"));
  return {
    shape: value("object-shape") as Shape,
    material: value("object-material") as Surface,
    size_m: size_cm >= 1 && size_cm <= 300 ? size_cm / 100 : 0.2,
  };
}

function chip({ name, material }: PlacedObject, objects: PlacedObjects): HTMLLIElement {
  const label = `${name}, ${material}`;
  const remove = { type: "button", "aria-label": `Remove ${label}`, click: () => objects.remove(name) };
  return element("li", { class: "chip" }, label, element("button", remove, "×"));
}

function clamp(value: number): number {
  return Math.min(1, Math.max(0, value));
}
