"""The compositor: a frame in, the frame with virtual objects out, and its layers apart.

    compositor = Compositor(session, load_scene("scene.json"), quality="good")
    for frame in capture:
        session.push(frame)
        picture = compositor.composite(frame)
        picture.image                                          # 8-bit sRGB with the objects
        picture.objects, picture.alpha, picture.shadow         # for those who composite elsewhere

Everything is computed in the frame's own linear radiance: its exposure is the light's. World metres, y up.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal, cast, get_args

import numpy as np
from jaxtyping import Float, Float32, UInt8

from roomlight.camera import transform_points
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.light.probes import LightAt, SceneProbes
from roomlight.compositing.light.temporal import FRAME_S, SHADOW_S, DepthFilter, ShadowHistory, elapsed_s, share_of
from roomlight.compositing.picture.camera_match import CameraModel, add_noise, blur_layer, measure_camera
from roomlight.compositing.picture.crop import Crop, CropCamera, crop_of_sphere
from roomlight.compositing.picture.layers import BehindGlass, Composite, compose_srgb8, encode_srgb8, unchanged
from roomlight.compositing.picture.occlusion import RealDepth, on_carrier, real_depth, visibility
from roomlight.compositing.picture.stage_clock import StageClock
from roomlight.compositing.placed_object import (
    StandingObject,
    clusters,
    placed,
    probe_positions,
    stand,
    supports_of,
)
from roomlight.compositing.placement.places import Placement, Plane
from roomlight.compositing.placement.room_geometry import SceneGeometry
from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject
from roomlight.compositing.rendering import shadows
from roomlight.compositing.rendering.renderer import RenderedObjects, render_objects
from roomlight.compositing.rendering.tracer import ObjectScene, is_rigid
from roomlight.depth import complete_depth
from roomlight.engine.session import Session
from roomlight.errors import OptionError, SceneError
from roomlight.frame import Frame

Quality = Literal["preview", "good", "final"]

CAMERA_EVERY: Final = 30
"""Noise and blur of the camera are measured again after this many frames."""
LIGHT_EVERY_S: Final[dict[Quality, float]] = {"preview": 0.13, "good": 0.0, "final": 0.0}
"""Light is moved toward the session's at most this often; each move costs 12 ms a probe."""
DEPTH_COLUMNS: Final[dict[Quality, int]] = {"preview": 256, "good": 640, "final": 640}
SAME_MOVE: Final = 1e-6
"""Objects whose transforms differ by less have moved together: a micrometre."""
SHADOW_COLUMNS: Final = 640
"""Shadows of wider frames are computed as for frames of about this width, and interpolated."""


def shadow_step(quality: Quality, width: int) -> int:
    """Return every how many pixels of a frame of this width the shadow is computed."""
    return shadows.QUALITIES[quality].step * max(1, round(width / SHADOW_COLUMNS))


class Compositor:
    """Puts the objects of a scene into the frames of a session. Not thread-safe, as the session."""

    def __init__(
        self,
        session: Session,
        scene: Scene | Sequence[SceneObject],
        *,
        quality: str = "good",
        seed: int = 0,
        match_camera: bool = True,
        background_glass: bool = True,
        light: LightAt | None = None,
        max_paths: int | None = None,
    ) -> None:
        """Begin; objects are placed at the first frame, or at the frame that their pixel belongs to.

        Args:
            session: gives light and geometry; the caller pushes its frames.
            scene: the objects.
            quality: preview (30 ms for a sphere in 640 x 480 pixels on two cores), good or final.
            seed: of the sampling points; the same seed gives the same picture.
            match_camera: give objects the frame's noise and blur.
            background_glass: show the frame through glass; else the probes' light.
            light: panorama at a world position, from elsewhere (a light probe, another estimator); default the
                session's light.
            max_paths: limit on the light paths of a picture, see `render_objects`; `Composite.samples` says what a
                pixel got.

        Raises:
            OptionError: the quality is unknown.
            SceneError: the scene has no object, too many, or two of one name; a position or pose is refused.
        """
        if quality not in get_args(Quality):
            raise OptionError(f"quality must be one of {', '.join(get_args(Quality))}; got {quality!r}")
        self.scene = scene if isinstance(scene, Scene) else Scene(tuple(scene))
        self.quality: Quality = cast(Quality, quality)
        self.geometry = SceneGeometry()
        self._session, self._seed, self._match = session, seed, match_camera
        self._background_glass, self._max_paths = background_glass, max_paths
        self._standing: list[StandingObject] = []
        self._probes = SceneProbes(session, light)
        self._depth, self._shadow = DepthFilter(), ShadowHistory()
        self._objects: ObjectScene | None = None
        self._matrices: list[bytes] = []
        self._built_at: list[Float[np.ndarray, "4 4"]] = []
        self._camera, self._camera_age = CameraModel.perfect(), 0
        self._first: Frame | None = None
        self._before: Frame | None = None
        for held in self.scene.objects:  # refuse bad places now, not at the first frame
            if not isinstance(held.place, AtPixel):
                placed(held)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the objects that have no place yet."""
        done = {one.number for one in self._standing}
        return tuple(held.name for number, held in enumerate(self.scene.objects) if number not in done)

    def placement(self, name: str) -> Placement:
        """Return where an object was placed, before its motion.

        Raises:
            SceneError: the scene has no such object, or it has no place yet.
        """
        for one in self._standing:
            if one.held.name == name:
                return one.placement
        raise SceneError(f"{name!r} has no place yet; the scene has {', '.join(o.name for o in self.scene.objects)}")

    def composite(self, frame: Frame) -> Composite:
        """Return the frame with the objects in it.

        The frame need not be the session's last one, but its pose must be in the session's world.

        Raises:
            SceneError: the session has no frame yet, or a pixel of this frame shows no known surface; nothing changed.
        """
        if self._session.frames == 0:
            raise SceneError("the session has no light and no geometry yet: push a frame first")
        clock = StageClock()
        with clock.stage("place"):
            self._place_waiting(frame)
            self.geometry.update(self._session, latest=False)
            first = self._first or frame
            seconds = elapsed_since(first, frame)
            matrices = [one.matrix_at(seconds, frame.index) for one in self._standing]
            spheres = [one.sphere(matrix) for one, matrix in zip(self._standing, matrices, strict=True)]
            crop, object_crop = self._crops(frame, spheres)
        step_s = 0.0 if self._before is None else elapsed_s(self._before, frame)
        if self._standing:
            with clock.stage("light"):
                self._probes.advance(step_s, every_s=LIGHT_EVERY_S[self.quality])
        with clock.stage("depth"):
            depth_m = self._depth.push(frame, max_width=DEPTH_COLUMNS[self.quality])
        with clock.stage("combine"):
            image = encode_srgb8(frame.image)
        self._first, self._before = first, frame
        if crop.empty:
            return unchanged(frame, image, clock, self.waiting)
        with clock.stage("camera"):
            self._follow_camera(image)
        with clock.stage("scene"):
            objects = self._built(matrices)
        supports = [one.support_at(matrix) for one, matrix in zip(self._standing, matrices, strict=True)]
        with clock.stage("render"):
            rendered = self._render(frame, objects, supports_of(objects, spheres, supports))
        with clock.stage("depth"):
            depth_m = self._filled(depth_m, frame, crop)
            size = frame.intrinsics.width, frame.intrinsics.height
            real = real_depth(depth_m, *size, crop)
            # shadows fall on surfaces without depth too: black and shiny tables; they do not hide objects
            whole = complete_depth(depth_m)
            shaded_m = real.depth_m if whole is depth_m else real_depth(whole, *size, crop).depth_m
        with clock.stage("shadow"):
            shadow = self._shadows(frame, crop, shaded_m, spheres, supports, share_of(step_s, SHADOW_S))
        with clock.stage("occlusion"):
            layer = self._layer(frame, image, (crop, real), rendered, object_crop, supports)
        with clock.stage("combine"):
            return self._combined(frame, image, (crop, shadow), (object_crop, layer), rendered, clock)

    def close(self) -> None:
        """Stop tracking the objects' positions in the session."""
        self._probes.close()

    def _place_waiting(self, frame: Frame) -> None:
        done = {one.number for one in self._standing}
        found: list[StandingObject] = []
        for number, held in enumerate(self.scene.objects):
            place = held.place
            if number in done or (isinstance(place, AtPixel) and place.frame not in (None, frame.index)):
                continue
            self.geometry.update(self._session)
            try:
                found.append(stand(number, held, self.geometry, frame))
            except SceneError as error:
                raise SceneError(f"objects[{number}] ({held.name}): {error}") from error
        for one in found:
            self._probes.add(probe_positions(one))
        self._standing = sorted([*self._standing, *found], key=lambda one: one.number)

    def _crops(self, frame: Frame, spheres: list[Float[np.ndarray, "4"]]) -> tuple[Crop, Crop]:
        """Return the rectangles around objects and shadows, and around objects alone."""
        k, pose = frame.intrinsics, frame.camera_to_world
        crop, object_crop = Crop(0, 0, 0, 0), Crop(0, 0, 0, 0)
        reach = shadows.QUALITIES[self.quality].reach
        for sphere in spheres:
            own = crop_of_sphere(k, pose, sphere[:3], float(sphere[3]))
            object_crop = object_crop.union(own)
            crop = crop.union(crop_of_sphere(k, pose, sphere[:3], reach * float(sphere[3])))
        if not object_crop.empty:
            object_crop = object_crop.grown(8, k.width, k.height)
        if not crop.empty:  # a rim of the reach at the image's edge gets the neighbours that normals need
            crop = crop.grown(2 * shadow_step(self.quality, k.width), k.width, k.height)
        return crop.union(object_crop), object_crop

    def _follow_camera(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        if not self._match:
            return
        if self._camera_age % CAMERA_EVERY == 0:
            found = measure_camera(image.astype(np.float32) / np.float32(255))
            self._camera = found if self._camera_age == 0 else self._camera.eased(found, 0.3)
        self._camera_age += 1

    def _built(self, matrices: list[Float[np.ndarray, "4 4"]]) -> ObjectScene:
        keys = [matrix.tobytes() for matrix in matrices]
        if self._objects is None or keys != self._matrices:
            self._objects = self._moved(matrices)
            self._matrices = keys
        return self._objects

    def _moved(self, matrices: list[Float[np.ndarray, "4 4"]]) -> ObjectScene:
        """Return the objects in their new places: the scene before, moved, if all have moved together."""
        if self._objects is not None and len(matrices) == len(self._built_at):
            moves = [new @ np.linalg.inv(old) for new, old in zip(matrices, self._built_at, strict=True)]
            if is_rigid(moves[0]) and all(np.abs(move - moves[0]).max() < SAME_MOVE for move in moves):
                return self._objects.moved(moves[0])
        self._built_at = matrices
        pairs = zip(self._standing, matrices, strict=True)
        return ObjectScene([one.held.geometry.transformed(matrix) for one, matrix in pairs])

    def _render(self, frame: Frame, objects: ObjectScene, supports: Supports) -> RenderedObjects:
        glass = self._background_glass and bool((objects.materials.transmission > 0).any())
        return render_objects(
            objects,
            frame.intrinsics,
            frame.camera_to_world,
            self._probes.lights(),
            quality=self.quality,
            seed=self._seed,
            background=BehindGlass(frame) if glass else None,
            supports=supports,
            max_paths=self._max_paths,
        )

    def _filled(self, depth_m: Float32[np.ndarray, "dh dw"], frame: Frame, crop: Crop) -> Float32[np.ndarray, "dh dw"]:
        """Fill holes near the objects with what other frames saw there."""
        rows, columns = depth_m.shape
        scale_y, scale_x = rows / frame.intrinsics.height, columns / frame.intrinsics.width
        near = np.zeros(depth_m.shape, bool)
        near[
            int(crop.top * scale_y) : int(crop.bottom * scale_y) + 1,
            int(crop.left * scale_x) : int(crop.right * scale_x) + 1,
        ] = True
        holes = near & (depth_m <= 0)
        if not holes.any():
            return depth_m
        camera = frame.intrinsics.resized(columns, rows)
        return np.where(holes, self.geometry.depth_image(camera, frame.camera_to_world, holes), depth_m)

    def _shadows(
        self,
        frame: Frame,
        crop: Crop,
        depth_m: Float32[np.ndarray, "ch cw"],
        spheres: list[Float[np.ndarray, "4"]],
        supports: list[Plane | None],
        share: float,
    ) -> Float32[np.ndarray, "ch cw 3"]:
        assert self._objects is not None
        quality = shadows.QUALITIES[self.quality]
        casters: list[shadows.Caster] = []
        for members in clusters(spheres):
            x, y, z = spheres[members[0]][:3].tolist()
            position = (x, y, z)
            caster = shadows.Caster(
                self._objects,
                np.stack([spheres[member] for member in members]).astype(np.float32),
                np.array(members, np.int32),
                self._probes.at(position),
                self._probes.casting_at(position),
                next((supports[member] for member in members if supports[member] is not None), None),
                None if self.quality == "preview" else self.geometry,
            )
            casters.append(caster)
        pose, eased = frame.camera_to_world, share if share > 0 else 1.0
        return shadows.shadow_ratio(
            casters,
            depth_m,
            CropCamera.of(frame.intrinsics, crop),
            pose,
            replace(quality, step=shadow_step(self.quality, frame.intrinsics.width)),
            supports=[plane for plane in supports if plane is not None],
            smooth=lambda ratio, grid, coarse_m, camera: self._shadow.blend(
                ratio, grid, coarse_m, camera, pose, share=eased
            ),
        )

    def _layer(
        self,
        frame: Frame,
        image: UInt8[np.ndarray, "h w 3"],
        real_of: tuple[Crop, RealDepth],
        rendered: RenderedObjects,
        crop: Crop,
        supports: list[Plane | None],
    ) -> Float32[np.ndarray, "oh ow 4"]:
        """Return premultiplied radiance and alpha of the visible part of the objects, blurred as the frame is."""
        if crop.empty:  # only the shadows are in the picture
            return np.zeros((*crop.shape, 4), np.float32)
        real = real_of[1].part(crop.inside(real_of[0]))
        camera = CropCamera.of(frame.intrinsics, crop)
        planes = [plane for plane in supports if plane is not None]
        carrier = on_carrier(real, camera, frame.camera_to_world, planes)
        guide = image[crop.slices].astype(np.float32) / np.float32(255)
        seen = visibility(rendered.depth_m[crop.slices], real, guide, carrier)
        layer = np.empty((*crop.shape, 4), np.float32)
        layer[..., :3] = rendered.radiance[crop.slices] * seen[..., None]
        layer[..., 3] = rendered.alpha[crop.slices] * seen
        return blur_layer(layer, self._camera.blur_px) if self._match else layer

    def _combined(
        self,
        frame: Frame,
        image: UInt8[np.ndarray, "h w 3"],
        shadow: tuple[Crop, Float32[np.ndarray, "ch cw 3"]],
        layer: tuple[Crop, Float32[np.ndarray, "oh ow 4"]],
        rendered: RenderedObjects,
        clock: StageClock,
    ) -> Composite:
        (crop, ratio), (inner, pixels) = shadow, layer
        encoded, alpha = image[crop.slices], np.ascontiguousarray(pixels[..., 3])
        compose_srgb8(encoded, frame.image[crop.slices], ratio, pixels, (inner.top - crop.top, inner.left - crop.left))
        if self._match and self._camera.noise.any() and not inner.empty:
            part = image[inner.slices]
            values, corner = part.astype(np.float32) / np.float32(255), (inner.top, inner.left)
            noisy = add_noise(values, alpha, self._camera, frame_index=frame.index, at=corner)
            part[:] = np.rint(noisy * 255).astype(np.uint8)
        numbers = np.array([*(one.number for one in self._standing), -1], np.int32)
        return Composite(
            image,
            frame,
            crop,
            inner,
            clock.wall_ms,
            self.waiting,
            pixels[..., :3],
            alpha,
            ratio,
            rendered.depth_m[inner.slices],
            numbers[rendered.object_id[inner.slices]],  # -1 reads the last entry
            clock.cpu_ms,
            rendered.samples,
        )


def composite(
    session: Session, frame: Frame, scene: Scene | Sequence[SceneObject], *, quality: str = "good", seed: int = 0
) -> Composite:
    """Return one frame with objects in it; for a stream of frames, keep a `Compositor`.

    Raises:
        OptionError: the quality is unknown.
        SceneError: the session has no frame, the scene or a place is refused, or an object is not in view.
    """
    compositor = Compositor(session, scene, quality=quality, seed=seed)
    try:
        result = compositor.composite(frame)
        if result.waiting:
            raise SceneError(
                f"{', '.join(result.waiting)}: the pixel belongs to another frame than {frame.index}; give that frame"
            )
        check_in_view(compositor, frame)
        return result
    finally:
        compositor.close()


def elapsed_since(first: Frame, frame: Frame) -> float:
    """Return the seconds between two frames: by timestamps, else 1/30 s an index."""
    if first.timestamp_s is not None and frame.timestamp_s is not None:
        return frame.timestamp_s - first.timestamp_s
    return (frame.index - first.index) * FRAME_S


def check_in_view(compositor: Compositor, frame: Frame) -> None:
    """Raise SceneError for an object that a single picture cannot show."""
    for held in compositor.scene.objects:
        placement, box = compositor.placement(held.name), held.box
        centre = transform_points(placement.object_to_world, (box.low + box.high) / 2)
        radius = float(np.linalg.norm(box.high - box.low)) / 2
        crop = crop_of_sphere(frame.intrinsics, frame.camera_to_world, centre, radius)
        offset = (centre - frame.camera_to_world[:3, 3]) @ frame.camera_to_world[:3, :3]
        if -offset[2] < -radius:
            raise SceneError(f"{held.name}: lies behind the camera, {offset[2]:.2f} m; place it in front")
        if crop.empty:
            raise SceneError(f"{held.name}: lies outside the picture; move it or the camera")
