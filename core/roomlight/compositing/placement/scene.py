"""Scenes: virtual objects with their sizes, places and motions; `scene.json` and its schema.

    {"objects": [
      {"name": "pot", "file": "teapot.glb", "size_m": 0.25, "pixel": [320, 260], "yaw_degrees": 30},
      {"name": "sphere", "shape": "sphere", "size_m": 0.2, "material": {"kind": "mirror"}, "position": [0.4, 0, -1.2],
       "motion": {"unit": "seconds", "keys": [{"at": 0}, {"at": 2, "offset_m": [0.5, 0, 0], "scale": 1.2}]}}
    ]}

Lengths are metres, world axes (y up); colours are linear RGB; quaternions are x, y, z, w.
"""

import json
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from roomlight.camera import pose_from_quaternion
from roomlight.compositing.objects import materials, primitives
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.teapot import teapot
from roomlight.compositing.objects.virtual_object import SIZE_ADVICE, VirtualObject
from roomlight.compositing.placement.places import Anchor, Box
from roomlight.errors import CaptureError, FrameError, ObjectError, SceneError
from roomlight.files import FolderSource
from roomlight.rules import check_type

Z_UP: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns an object whose z axis points up: z becomes y, x stays."""
SHAPE_SIZE_M: Final = {"sphere": 0.2, "cube": 0.2, "plane": 0.5, "vase": 0.3, "chair": 0.85, "teapot": 0.3}
"""The shapes, and the longest side of each where no size is given."""
MAX_OBJECTS: Final = 64
MAX_KEYS: Final = 10_000
MAX_SIZE_M: Final = 100.0
MAX_SCENE_BYTES: Final = 4_000_000

Coordinate = Annotated[float, Field(ge=-10_000, le=10_000, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[Coordinate, Coordinate, Coordinate]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class MaterialSpec(_Model):
    """A material.

    Attributes:
        kind: diffuse, glossy, metal, mirror or glass.
        base_colour: linear RGB, 0 to 1; default: 0.8 grey, white for metal and glass; a mirror has none.
        roughness: 0 to 1, of glossy (default 0.2) and metal (default 0.5) alone.
    """

    kind: Literal["diffuse", "glossy", "metal", "mirror", "glass"]
    base_colour: tuple[Share, Share, Share] | None = None
    roughness: Share | None = None

    def build(self) -> Material:
        """Make the material."""
        if self.kind == "glass":
            return materials.glass(tint=self.base_colour or (1.0, 1.0, 1.0))
        makers = {
            "diffuse": materials.diffuse,
            "glossy": materials.glossy,
            "metal": materials.rough_metal,
            "mirror": materials.mirror,
        }
        return makers[self.kind](**self.model_dump(exclude={"kind"}, exclude_none=True))

    @model_validator(mode="after")
    def _refuse_unused(self) -> "MaterialSpec":
        unused = {"diffuse": ("roughness",), "mirror": ("base_colour", "roughness"), "glass": ("roughness",)}
        for name in unused.get(self.kind, ()):
            if getattr(self, name) is not None:
                raise ValueError(f"{name} has no effect on a material of kind {self.kind}; leave it out")
        return self


class MotionKey(_Model):
    """The state of a motion at one time, relative to the object's place.

    Attributes:
        at: time, later than that of the key before; in the motion's `unit`.
        offset_m: metres added to the place, x, y, z in world axes. Default: 0, 0, 0.
        rotation_xyzw: quaternion x, y, z, w that turns the object about its anchor, world axes. Default: no turn.
        scale: of the object about its anchor, up to 1000. Default: 1.
    """

    at: Coordinate
    offset_m: Vector = (0.0, 0.0, 0.0)
    rotation_xyzw: tuple[Coordinate, Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0, 1.0)
    scale: Annotated[float, Field(gt=0, le=1000)] = 1.0

    @model_validator(mode="after")
    def _has_direction(self) -> "MotionKey":
        if np.linalg.norm(self.rotation_xyzw) < 1e-6:
            raise ValueError("rotation_xyzw is zero; 0, 0, 0, 1 is no rotation")
        return self


class Motion(_Model):
    """Keyframed motion: offsets and scales are interpolated linearly, rotations by slerp; held before and after.

    Attributes:
        unit: of `at`: seconds since the first frame (default), or frames: their indices.
        easing: linear (default), or smooth: the speed is 0 at every key.
        loop: true: begin again after the last key.
        keys: 1 to 10,000 states, in order of time.
    """

    unit: Literal["seconds", "frames"] = "seconds"
    easing: Literal["linear", "smooth"] = "linear"
    loop: bool = False
    keys: Annotated[list[MotionKey], Field(min_length=1, max_length=MAX_KEYS)]

    @model_validator(mode="after")
    def _in_order(self) -> "Motion":
        times = [key.at for key in self.keys]
        for number, (before, after) in enumerate(pairwise(times)):
            if not before < after:
                raise ValueError(f"keys[{number + 1}].at must be later than {before:g}, the key before; got {after:g}")
        return self

    def transform_at(self, time: float, pivot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
        """Return the world transform at a time in `unit`; `pivot` is the anchor in the world."""
        times = [key.at for key in self.keys]
        if self.loop and times[-1] > times[0]:
            time = times[0] + (time - times[0]) % (times[-1] - times[0])
        after = int(np.clip(np.searchsorted(times, time), 1, len(times) - 1)) if len(times) > 1 else 0
        first, second = self.keys[max(after - 1, 0)], self.keys[after]
        span = second.at - first.at
        share = float(np.clip((time - first.at) / span, 0, 1)) if span > 0 else 0.0
        if self.easing == "smooth":
            share = share * share * (3 - 2 * share)
        offset = (1 - share) * np.array(first.offset_m) + share * np.array(second.offset_m)
        rotation = slerp(np.array(first.rotation_xyzw), np.array(second.rotation_xyzw), share)
        matrix = pose_from_quaternion(rotation, np.zeros(3))
        matrix[:3, :3] *= (1 - share) * first.scale + share * second.scale
        matrix[:3, 3] = pivot + offset - matrix[:3, :3] @ pivot
        return matrix


class ObjectSpec(_Model):
    """One object of a scene: a file or a shape, its size, its place and its motion.

    Attributes:
        name: unique in the scene.
        file: glTF, GLB, OBJ or PLY, relative to the scene's file.
        shape: sphere, cube, plane, vase, chair or teapot, instead of a file.
        up: axis of the file that points up; z is turned to y, x stays.
        size_m: longest side of the bounding box, up to 100 m; default: the file's own metres, 0.2 for sphere and cube,
            0.3 for vase and teapot, 0.5 for plane, 0.85 for chair.
        material: replaces the file's materials.
        position: world metres of the anchor; or
        pose: 4 x 4 rigid matrix, object axes to world; or
        pixel: column and row in a frame: the object stands on the surface there.
        frame: index of the frame of `pixel`; default: the first frame that is composited.
        yaw_degrees: about the surface's normal, with `position` or `pixel`.
        anchor: point of the object that is placed, with `position` or `pose`: base (default), back, top, centre or
            origin.
        motion: movement relative to the place; default: none.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    file: str | None = None
    shape: Literal["sphere", "cube", "plane", "vase", "chair", "teapot"] | None = None
    up: Literal["y", "z"] = "y"
    size_m: Annotated[float, Field(gt=0, le=MAX_SIZE_M)] | None = None
    material: MaterialSpec | None = None
    position: Vector | None = None
    pose: tuple[tuple[Coordinate, Coordinate, Coordinate, Coordinate], ...] | None = Field(
        None, min_length=4, max_length=4
    )
    pixel: tuple[Coordinate, Coordinate] | None = None
    frame: Annotated[int, Field(ge=0)] | None = None
    yaw_degrees: Coordinate = 0.0
    anchor: Anchor | None = None
    motion: Motion | None = None

    @model_validator(mode="after")
    def _one_of_each(self) -> "ObjectSpec":
        if (self.file is None) == (self.shape is None):
            raise ValueError("give either file or shape")
        if self.shape is not None and self.up != "y":
            raise ValueError("up belongs to a file; shapes have y up")
        if sum(value is not None for value in (self.position, self.pose, self.pixel)) != 1:
            raise ValueError("give exactly one of position, pose and pixel")
        if self.frame is not None and self.pixel is None:
            raise ValueError("frame belongs to pixel, which is missing")
        if self.anchor is not None and self.pixel is not None:
            raise ValueError("anchor is chosen by the surface that pixel shows; leave it out")
        if self.pose is not None and self.yaw_degrees:
            raise ValueError("yaw_degrees has no effect on a pose; leave it out")
        return self


class SceneSpec(_Model):
    """Content of a `scene.json`."""

    objects: Annotated[list[ObjectSpec], Field(min_length=1, max_length=MAX_OBJECTS)]


@dataclass(frozen=True)
class AtPosition:
    """Place: world metres, upright."""

    position: tuple[float, float, float]
    yaw_degrees: float = 0.0
    anchor: Anchor = "base"


@dataclass(frozen=True, eq=False)
class AtPose:
    """Place: rigid transform [4, 4] from object axes to the world, at the anchor."""

    pose: Float[np.ndarray, "4 4"]
    anchor: Anchor = "base"


@dataclass(frozen=True)
class AtPixel:
    """Place: the surface that a pixel shows, in the frame of this index (None: the first that is composited)."""

    u: float
    v: float
    frame: int | None = None
    yaw_degrees: float = 0.0


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A virtual object of the wanted size in its own frame, its place and its motion."""

    name: str
    geometry: VirtualObject
    place: AtPosition | AtPose | AtPixel
    motion: Motion | None = None

    @property
    def box(self) -> Box:
        """The bounding box in the object's frame."""
        low, high = self.geometry.bounds()
        return Box(low, high)


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects to be composited.

    Raises:
        SceneError: there is no object, there are more than `MAX_OBJECTS`, or two of one name; or an item is no object.
    """

    objects: tuple[SceneObject, ...] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        if not 1 <= len(self.objects) <= MAX_OBJECTS:
            raise SceneError(f"objects: a scene has 1 to {MAX_OBJECTS} objects, got {len(self.objects)}")
        seen: set[str] = set()
        for number, scene_object in enumerate(self.objects):
            check_type(scene_object, SceneObject, f"objects[{number}]", SceneError)
            if scene_object.name in seen:
                raise SceneError(f"objects[{number}].name: {scene_object.name!r} is used twice; names must differ")
            seen.add(scene_object.name)


LoadObject = Callable[[str], VirtualObject]
"""Returns the object of the name in `file`; raises ObjectError."""


def load_scene(path: str | Path) -> Scene:
    """Read a `scene.json` and the objects that it names, relative to its folder.

    Raises:
        SceneError: the file cannot be read, or a field is refused; the message names it.
        ObjectError: an object's file is refused.

    Examples:
        >>> import roomlight as rl, pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "scene.json"
        >>> sphere = '{"name": "sphere", "shape": "sphere", "size_m": 0.2, "pixel": [160, 200]}'
        >>> _ = path.write_text(f'{{"objects": [{sphere}]}}')
        >>> len(rl.load_scene(path).objects)
        1
    """
    from roomlight.compositing.loading import load_object  # the loader's libraries are slow to import

    path = Path(path)
    try:
        if path.stat().st_size > MAX_SCENE_BYTES:
            raise SceneError(f"{path}: a scene has at most {MAX_SCENE_BYTES} bytes, got {path.stat().st_size}")
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from error
    folder = FolderSource(path.parent)

    def load(name: str) -> VirtualObject:
        try:
            return load_object(path.parent / folder.actual(name))
        except FrameError as error:
            raise ObjectError(str(error)) from error

    try:
        return parse_scene(text, load=load)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def parse_scene(document: str | bytes | dict[str, Any], *, load: LoadObject) -> Scene:
    """Make a scene from JSON text, also with comments, or its decoded object; `load` opens what `file` names.

    Raises:
        SceneError: the JSON is damaged, or a field is refused; the message names it.
        ObjectError: an object is refused.
    """
    if not isinstance(document, dict):
        from roomlight.captures.fields import parse_json  # the readers' libraries are slow to import

        try:
            data = document.encode("utf-8", "surrogatepass") if isinstance(document, str) else document
            document = parse_json(data, "the scene")
        except CaptureError as error:
            raise SceneError(str(error)) from error
    try:
        spec = SceneSpec.model_validate(document)
    except ValidationError as error:
        raise SceneError(_explained(error)) from error
    return Scene(tuple(_built(object_spec, number, load) for number, object_spec in enumerate(spec.objects)))


def slerp(first: Float[np.ndarray, "4"], second: Float[np.ndarray, "4"], share: float) -> Float[np.ndarray, "4"]:
    """Interpolate between two rotations (quaternions x, y, z, w) along the shorter arc at constant speed."""
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    cosine = float(first @ second)
    if cosine < 0:
        second, cosine = -second, -cosine
    if cosine > 1 - 1e-9:
        return first
    angle = np.arccos(cosine)
    return (np.sin((1 - share) * angle) * first + np.sin(share * angle) * second) / np.sin(angle)


@contextmanager
def naming_object(number: int, name: str) -> Generator[None]:
    """Put the object in front of an ObjectError or SceneError that is raised inside the block."""
    try:
        yield
    except (ObjectError, SceneError) as error:
        raise type(error)(f"objects[{number}] ({name}): {error}") from error


def _built(spec: ObjectSpec, number: int, load: LoadObject) -> SceneObject:
    with naming_object(number, spec.name):
        geometry = load(spec.file) if spec.file is not None else _shape(spec.shape or "")
        if spec.up == "z":
            geometry = geometry.transformed(Z_UP)
        if spec.material is not None:
            geometry = geometry.with_material(spec.material.build())
        size_m = spec.size_m or SHAPE_SIZE_M.get(spec.shape or "")
        if size_m is not None:
            geometry = geometry.scaled_to(size_m)
        elif (own_m := float(np.ptp(geometry.bounds(), axis=0).max())) > MAX_SIZE_M:
            limit = f"its size of {own_m:.3g} m is beyond {MAX_SIZE_M:g} m"
            raise ObjectError(f"{limit}; {SIZE_ADVICE} of its longest side in metres")
    return SceneObject(spec.name, geometry, _place(spec), spec.motion)


def _shape(name: str) -> VirtualObject:
    if name == "sphere":
        return primitives.sphere(0.5)
    if name == "plane":
        return primitives.plane(1.0, 1.0)
    made = {"cube": primitives.cube, "vase": primitives.vase, "chair": primitives.chair, "teapot": teapot}
    return made[name](1.0)


def _place(spec: ObjectSpec) -> AtPosition | AtPose | AtPixel:
    if spec.pixel is not None:
        return AtPixel(spec.pixel[0], spec.pixel[1], spec.frame, spec.yaw_degrees)
    if spec.pose is not None:
        return AtPose(np.array(spec.pose, np.float64), spec.anchor or "base")
    assert spec.position is not None
    return AtPosition(spec.position, spec.yaw_degrees, spec.anchor or "base")


def _explained(error: ValidationError) -> str:
    """Return the first mistakes, each with its field, rule and value."""
    lines: list[str] = []
    mistakes: Sequence[Any] = error.errors(include_url=False)
    for mistake in mistakes[:5]:
        where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in mistake["loc"]).lstrip(".")
        rule = mistake["msg"].removeprefix("Value error, ")
        value = json.dumps(mistake["input"], default=str)
        value_text = "" if isinstance(mistake["input"], dict | list) else f"; got {value[:80]}"
        lines.append(f"{where or 'the scene'}: {rule}{value_text}")
    if len(mistakes) > len(lines):
        lines.append(f"and {len(mistakes) - len(lines)} more")
    return "; ".join(lines)
