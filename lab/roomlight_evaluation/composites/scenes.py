"""Generated rooms with a real object: what a session gets of the room, and the picture with the object truly in it.

Each scene is a test room, every third frame of a camera's walk of 31 through it, and an object on a floor or a table in
the view of one of these frames, near its middle. The session gets all of them, without the object, as a phone takes
them: with its automatic exposure, noise and depth. The truth is the frame's view of the room whose light was solved
with the object in it, developed by the same sensor with the same noise. World metres, y up; light in units of that
frame's white.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from roomlight.camera import Intrinsics, transform_points
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.objects import materials, primitives
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject
from roomlight.conventions import srgb8_to_linear
from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.folder import GENERATOR
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import SceneError
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight_evaluation.composites.regions import SHADOW, regions, smoothed_truth
from roomlight_generator.furniture_digest import furniture_digest
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.rooms.scene import Material as RealMaterial
from roomlight_generator.rooms.shapes import bare_mesh, with_material
from roomlight_generator.sequences import with_object as real
from roomlight_generator.sequences.exposure import Exposure, expose
from roomlight_generator.sequences.render import CameraPath, LitRoom, catalogue_for, draw_camera_path, solve_lighting
from roomlight_generator.sequences.sensor import Sensor, develop
from roomlight_generator.sequences.walk import FRAME_INTERVAL_S
from roomlight_generator.transport import FrameView

WALK: Final = 31
EVERY: Final = 3
"""Every third frame of a walk is rendered: 15 degrees or 0.27 m apart in the mean, one a second."""
SHAPES: Final = {"sphere": 0.24, "cube": 0.2, "vase": 0.3}
"""Shapes and the length of their longest side in metres."""
MATERIALS: Final = ("mirror", "glossy", "diffuse")
NAME: Final = "object"
_ALPHA: Final = 0.1
"""GGX alpha of glossy objects; the compositor's roughness is its square root."""
_COLOUR: Final = (0.7, 0.35, 0.2)
_PURPOSE: Final = 101
"""Stream of random numbers, apart from those of the dataset's walks."""
_WALKS: Final = 12
_LARGEST_SHIFT_M: Final = 0.03
_PANORAMA_ROWS: Final = 120


@dataclass(frozen=True, eq=False)
class CompositeScene:
    """A view with and without an object, and what a session gets of the room.

    Attributes:
        name: of the room.
        shape: one of `SHAPES`.
        material: one of `MATERIALS`.
        frame: the one of the frames into which the object is put; its white is the unit of light.
        objects: the scene for the compositor.
        truth: [h, w, 3] the developed picture with the object, linear, of `composites.regions.smoothed_truth`.
        clean: radiance with the object and without, undeveloped, in units of white.
        covered: pixels that show the real object.
        masks: of `composites.regions.regions`.
        true_light: panorama at the object's centre in the room without it.
        frames: all that the session has seen.
        shift_m: by which the compositor's place is above (below if negative) the real surface.
    """

    name: str
    shape: str
    material: str
    frame: Frame
    objects: Scene
    truth: Float32[np.ndarray, "h w 3"]
    clean: tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w 3"]]
    covered: Bool[np.ndarray, "h w"]
    masks: Mapping[str, Bool[np.ndarray, "h w"]]
    true_light: Float32[np.ndarray, "ph pw 3"]
    frames: tuple[Frame, ...]
    shift_m: float

    def session(self, options: SessionOptions, graphs: LightingGraphs | None = None) -> Session:
        """Return a session that has seen the frames."""
        session = Session(options, graphs=graphs)
        for frame in self.frames:
            session.push(frame)
        return session


@dataclass(frozen=True, eq=False)
class _Phone:
    """A phone: its exposure of each frame; `noise_seed` with a frame's number seeds the frame's noise.

    Light is in units of the white of the frame `shown`.
    """

    exposure: Exposure
    sensor: Sensor
    noise_seed: int
    shown: int

    def developed(
        self, radiance: Float[np.ndarray, "h w 3"], number: int
    ) -> tuple[Float32[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
        """Return the picture, linear in the session's unit and as 8-bit sRGB."""
        rng = np.random.default_rng([self.noise_seed, number])
        multiplier, gains = float(self.exposure.multiplier[number]), self.exposure.gains
        eight_bit = develop(radiance, self.sensor, rng, multiplier=multiplier, gains=gains)
        unit = np.float32(self.exposure.multiplier[self.shown] / multiplier)
        return srgb8_to_linear(eight_bit) * unit, eight_bit

    def in_white(self, radiance: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
        return (radiance * (self.exposure.gains * self.exposure.multiplier[self.shown])).astype(np.float32)


def scenes_digest() -> str:
    """Return the SHA-256 of what makes scenes beside their numbers and seed: generator, furniture, constants above.

    Raises:
        DatasetError: The furniture cannot be read.
    """
    objects, walks = (SHAPES, MATERIALS, _ALPHA, _COLOUR), (WALK, EVERY, _PURPOSE, _WALKS)
    made = GENERATOR, furniture_digest(None), objects, walks, _LARGEST_SHIFT_M, _PANORAMA_ROWS
    return hashlib.sha256(repr(made).encode()).hexdigest()


def virtual_object(shape: str, material: str) -> VirtualObject:
    """Make one of the objects as the compositor takes it."""
    look: Material = {
        "mirror": materials.mirror(),
        "glossy": Material(base_colour=_COLOUR, roughness=float(np.sqrt(_ALPHA)), ior=1.5),
        "diffuse": materials.diffuse(_COLOUR),
    }[material]
    made = {"sphere": primitives.sphere(0.5), "cube": primitives.cube(1.0), "vase": primitives.vase(1.0)}[shape]
    return made.scaled_to(SHAPES[shape]).with_material(look)


def scene_for(number: int, *, seed: int) -> CompositeScene:
    """Make the scene of this number; the same arguments give the same scene.

    Raises:
        SceneError: No walk through the room shows a place for the object.
    """
    shape = tuple(SHAPES)[number // len(MATERIALS) % len(SHAPES)]
    material = MATERIALS[number % len(MATERIALS)]
    lit_room = solve_lighting(number, seed=seed, split="test", catalogue=catalogue_for(None))
    rng = room_generator(number, seed=seed, split="test", purpose=_PURPOSE)
    geometry = virtual_object(shape, material)
    for path, shown, place in _places(lit_room, rng, geometry):
        frames, phone = _recorded(lit_room, path, rng, shown=shown)
        session = Session(SessionOptions(model="classical"))
        for frame in frames:
            session.push(frame)
        objects = Scene((SceneObject(NAME, geometry, AtPixel(place.u, place.v)),))
        placed = _placed(session, frames[shown], objects, lit_room)
        if placed is None:
            continue
        object_to_world, shift_m = placed
        pose = path.poses[shown]
        view, covered, bare = _truth(lit_room, geometry, object_to_world, path.intrinsics, pose, number)
        low, high = geometry.bounds()
        centre = object_to_world[:3, :3] @ ((low + high) / 2) + object_to_world[:3, 3]
        clean = phone.in_white(view.radiance), phone.in_white(bare.radiance)
        radius_m = float(np.linalg.norm(high - low) / 2)
        distance_m = _distances(path.intrinsics, pose, view, centre)
        masks = regions(*clean, covered, distance_m, radius_m=radius_m)
        developed = phone.developed(view.radiance, shown)[0]
        light = lit_room.light.panorama(centre, _PANORAMA_ROWS, seed=number)
        return CompositeScene(
            name=lit_room.room.name,
            shape=shape,
            material=material,
            frame=frames[shown],
            objects=objects,
            truth=smoothed_truth(frames[shown].image, developed, clean, covered, masks[SHADOW]),
            clean=clean,
            covered=covered,
            masks=masks,
            true_light=phone.in_white(light),
            frames=frames,
            shift_m=shift_m,
        )
    raise SceneError(f"room {number}: {_WALKS} walks through it show no place for the object; take another room")


def _places(
    lit_room: LitRoom, rng: np.random.Generator, geometry: VirtualObject
) -> Iterator[tuple[CameraPath, int, real.RestingPlace]]:
    """Yield walks, the frame of each whose view shows a place for the object nearest to its middle, and the place."""
    low, high = geometry.bounds()
    radius, height = float(np.hypot(high[0] - low[0], high[2] - low[2]) / 2), float(high[1] - low[1])
    for _ in range(_WALKS):
        walk = draw_camera_path(lit_room.free, lit_room.light, rng, frames=WALK, probes=1)
        if walk is None:
            continue
        path = replace(walk, poses=walk.poses[::EVERY])
        places: list[tuple[float, int, real.RestingPlace]] = []
        for number, pose in enumerate(path.poses):
            place = real.find_resting_place(
                lit_room.light.tracer, path.intrinsics, pose, rng, radius_m=radius, height_m=height
            )
            if place is not None:
                off_centre = np.hypot(place.u / path.intrinsics.width - 0.5, place.v / path.intrinsics.height - 0.6)
                places.append((float(off_centre), number, place))
        if places:
            _, number, place = min(places, key=lambda candidate: candidate[0])
            yield path, number, place


def _recorded(
    lit_room: LitRoom, path: CameraPath, rng: np.random.Generator, *, shown: int
) -> tuple[tuple[Frame, ...], _Phone]:
    """Render the frames and develop them as a phone does, with its exposure and its depth."""
    seed = int(rng.integers(2**31))
    views = [lit_room.light.frame(path.intrinsics, pose, seed=seed + k) for k, pose in enumerate(path.poses)]
    exposure = expose(np.stack([view.radiance for view in views]), rng, interval_s=EVERY * FRAME_INTERVAL_S)
    phone = _Phone(exposure, Sensor.draw(rng), seed, shown)
    pictures = [phone.developed(view.radiance, k) for k, view in enumerate(views)]
    depth_mm = np.stack([np.rint(np.clip(view.depth_m * 1000, 0, 65535)).astype(np.uint16) for view in views])
    surface = np.stack([view.surface for view in views])
    measured_mm = arkit_like(depth_mm, surface, np.stack([eight_bit for _, eight_bit in pictures]), rng)
    frames = [
        Frame(
            index=k,
            image=linear,
            clipped=np.asarray((eight_bit >= CLIPPED_SRGB8).any(-1)),
            depth_m=measured_mm[k].astype(np.float32) / np.float32(1000),
            intrinsics=path.intrinsics,
            camera_to_world=path.poses[k],
            timestamp_s=k * EVERY * FRAME_INTERVAL_S,
            source=lit_room.room.name,
        )
        for k, (linear, eight_bit) in enumerate(pictures)
    ]
    return tuple(frames), phone


def _placed(
    session: Session, frame: Frame, objects: Scene, lit_room: LitRoom
) -> tuple[Float[np.ndarray, "4 4"], float] | None:
    """Return the object's pose on the real surface, where the compositor puts it, and by how far the two differ."""
    compositor = Compositor(session, objects, quality="preview", match_camera=False)
    try:
        compositor.composite(frame)
        placement = compositor.placement(NAME)
    except SceneError:
        return None
    finally:
        compositor.close()
    if placement.kind != "floor":
        return None
    pose = placement.object_to_world.copy()
    box = objects.objects[0].box
    base = pose[:3, :3] @ box.anchor("base") + pose[:3, 3]
    shift = real.height_above_surface(lit_room.light.tracer, base)
    if abs(shift) > _LARGEST_SHIFT_M:
        return None
    pose[1, 3] -= shift
    return pose, shift


def _truth(
    lit_room: LitRoom,
    geometry: VirtualObject,
    object_to_world: Float[np.ndarray, "4 4"],
    intrinsics: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    number: int,
) -> tuple[FrameView, Bool[np.ndarray, "h w"], FrameView]:
    (mesh, look), *_ = geometry.transformed(object_to_world).parts
    if look.metallic:
        same = RealMaterial(real.OBJECT, mirror=1.0)
    else:
        same = RealMaterial(real.OBJECT, albedo=_COLOUR, roughness=None if look.specular == 0 else _ALPHA)
    item = with_material(bare_mesh(mesh.vertices, mesh.normals, mesh.faces), same)
    return real.render_pair(lit_room.room.scene, item, intrinsics, camera_to_world, seed=number)


def _distances(
    intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], view: FrameView, centre: Float[np.ndarray, "3"]
) -> Float32[np.ndarray, "h w"]:
    points = transform_points(camera_to_world, intrinsics.rays() * view.depth_m[..., None])
    return np.linalg.norm(points - centre, axis=-1).astype(np.float32)
