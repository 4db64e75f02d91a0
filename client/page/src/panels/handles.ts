// The placed objects in the camera's picture: outlines of the selected one and of hidden ones; a drag moves one on surfaces.

import { byId } from "../lib/dom";
import { cornersOf, type PlacedObject, type PlacedObjects } from "../objects";
import type { State } from "../state";

type Point = readonly [x: number, y: number];

const HIDDEN = 0.3; // an object of which less is visible gets an outline
const CLICK_PX = 5; // a shorter movement is a click

const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7];

interface Outline {
  readonly name: string;
  /** Corners of the box, as fractions of the picture; the first four are the base. */
  readonly corners: readonly Point[];
}

/** Show outlines and move objects; `isClick` tells whether the last press in the picture did neither. */
export function objectHandles(state: State, objects: PlacedObjects): { isClick: () => boolean } {
  const [button, image, svg] = [byId("picture-button"), byId("picture-image"), byId("picture-outlines") as unknown as SVGSVGElement];
  let drag: { name: string; from: Point; start: Point; by: Point; pointerId: number } | null = null;
  let taken = false;
  svg.setAttribute("viewBox", "0 0 1 1");
  svg.setAttribute("preserveAspectRatio", "none");

  const outlines = (): Outline[] => {
    const past = state.shownEntry.value !== null;
    return past ? [] : objects.list.value.flatMap((object) => (objects.isLost(object) ? [] : outlineOf(object, state)));
  };
  const show = () => {
    const wanted = outlines().filter(({ name }) => {
      return name === objects.selected.value || name === drag?.name || (objects.visible.value[name] ?? 1) < HIDDEN;
    });
    svg.replaceChildren(
      ...wanted.map(({ name, corners }) => {
        const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
        const [dx, dy] = name === drag?.name ? drag.by : [0, 0];
        const at = (corner: number) => `${corners[corner]![0] + dx} ${corners[corner]![1] + dy}`;
        const lines = Array.from({ length: EDGES.length / 2 }, (_, edge) => `M${at(EDGES[2 * edge]!)}L${at(EDGES[2 * edge + 1]!)}`);
        path.setAttribute("d", lines.join(""));
        path.dataset["name"] = name;
        return path;
      }),
    );
  };
  const pointOf = ({ clientX, clientY }: PointerEvent | Touch): Point => {
    const { left, top, width, height } = image.getBoundingClientRect();
    return [(clientX - left) / width, (clientY - top) / height];
  };

  const outlineAt = (point: Point) => outlines().filter(({ corners }) => isInside(point, corners)).at(-1);

  // a finger on an object drags it; elsewhere it scrolls the page
  const keepFinger = (event: TouchEvent) => event.touches.length === 1 && outlineAt(pointOf(event.touches[0]!)) && event.preventDefault();
  button.addEventListener("touchstart", keepFinger, { passive: false });
  button.addEventListener("pointerdown", (event) => {
    if (drag && event.pointerId !== drag.pointerId) {
      return; // a second finger
    }
    taken = false;
    const from = pointOf(event);
    const under = outlineAt(from);
    if (event.button === 0 && under) {
      const base = under.corners.slice(0, 4);
      const start = [0, 1].map((axis) => base.reduce((sum, corner) => sum + corner[axis]! / 4, 0)) as unknown as Point;
      drag = { name: under.name, from, start, by: [0, 0], pointerId: event.pointerId };
      button.setPointerCapture(event.pointerId);
    }
  });
  button.addEventListener("pointermove", (event) => {
    if (drag && event.pointerId !== drag.pointerId) {
      return;
    }
    if (drag) {
      const [x, y] = pointOf(event);
      drag.by = [x - drag.from[0], y - drag.from[1]];
      show();
    } else {
      button.classList.toggle("over", outlineAt(pointOf(event)) !== undefined);
    }
  });
  button.addEventListener("pointerup", (event) => {
    if (drag && event.pointerId !== drag.pointerId) {
      return;
    }
    const done = drag;
    drag = null;
    const { width, height } = image.getBoundingClientRect();
    const lens = state.camera.value?.intrinsics;
    if (done && lens && Math.hypot(done.by[0] * width, done.by[1] * height) >= CLICK_PX) {
      taken = true;
      const [x, y] = [0, 1].map((axis) => Math.min(0.999, Math.max(0, done.start[axis]! + done.by[axis]!)));
      objects.selected.value = done.name;
      objects.move(done.name, { pixel: [x! * lens.width, y! * lens.height] });
    } else if (done && done.name !== objects.selected.value) {
      taken = true;
      objects.selected.value = done.name;
    }
    show();
  });
  button.addEventListener("pointercancel", () => {
    drag = null;
    show();
  });
  for (const signal of [objects.list, objects.selected, objects.visible, state.camera, state.shownEntry]) {
    (signal as { watch: (listener: () => void) => void }).watch(show);
  }
  return { isClick: () => !taken };
}

/** The box around an object in the picture; nothing if a corner is behind the camera. */
function outlineOf(object: PlacedObject, { camera }: State): Outline[] {
  const corners = cornersOf(object, camera.value);
  return corners.length === 0 || corners.includes(null) ? [] : [{ name: object.name, corners: corners as Point[] }];
}

function isInside([x, y]: Point, corners: readonly Point[]): boolean {
  const [xs, ys] = [corners.map((corner) => corner[0]), corners.map((corner) => corner[1])];
  return x >= Math.min(...xs) && x <= Math.max(...xs) && y >= Math.min(...ys) && y <= Math.max(...ys);
}
