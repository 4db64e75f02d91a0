"""The compositor: a frame in, the frame with virtual objects out, and its layers apart.

    compositor = Compositor(session, "scene.json", quality="good")
    for frame in capture:
        session.push(frame)
        picture = compositor.composite(frame)
        picture.image                                          # 8-bit sRGB with the objects
        picture.objects, picture.alpha, picture.shadow         # for those who composite elsewhere

Objects are lit in the unit of the session's light and put into the frame as it was recorded, which differs from it by
`Frame.exposure` and by the gain of a frame whose exposure drifts. Light of the caller is in the unit of `Frame.image`.
World metres, y up.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, Literal, cast, get_args

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from roomlight.camera import transform_points
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.kernels.shadows import fill_clipped_share, fill_unclipped, restore_clipped
from roomlight.compositing.light.probes import GivenLight, ObjectProbes, given_light
from roomlight.compositing.light.temporal import (
    SHADOW_S,
    DepthFilter,
    Moment,
    ShadowHistory,
    elapsed_s,
    elapsed_since,
    reduced,
    share_of,
)
from roomlight.compositing.picture.camera_match import CameraModel, add_noise, blur_layer, measure_camera
from roomlight.compositing.picture.crop import NO_CROP, Crop, CropCamera, crop_of_sphere
from roomlight.compositing.picture.estimated_depth import fitted_to_supports
from roomlight.compositing.picture.layers import BehindGlass, Composite, compose_srgb8, encode_srgb8
from roomlight.compositing.picture.occlusion import (
    RealDepth,
    extended,
    on_carrier,
    real_depth,
    visibility,
    visible_shares,
    without_islands,
)
from roomlight.compositing.picture.stage_clock import StageClock
from roomlight.compositing.placed_object import (
    PlacedObject,
    PosedObjects,
    clusters,
    place_object,
    placement_of,
    probe_positions,
    supports_of,
)
from roomlight.compositing.placement.places import Placement
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject, load_scene, naming_object
from roomlight.compositing.rendering import shadows
from roomlight.compositing.rendering.renderer import RenderedObjects, render_objects
from roomlight.compositing.rendering.tracer import TracedObjects, is_rigid
from roomlight.compositing.rendering.unseen_lamps import ShadowLights
from roomlight.conventions import srgb8_to_linear
from roomlight.depth import complete_depth
from roomlight.engine.networks.clipping import white_of
from roomlight.engine.session import Session
from roomlight.engine.surface.drift import NO_GAIN, Gain, with_gain
from roomlight.errors import FrameError, OptionError, SceneError
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight.rules import check_type

Quality = Literal["preview", "good", "final"]

CAMERA_EVERY: Final = 30
"""Noise and blur of the camera are measured again after this many frames, and at another size of frames."""
LIGHT_EVERY_S: Final[dict[Quality, float]] = {"preview": 0.13, "good": 0.0, "final": 0.0}
"""Light is moved toward the session's at most this often; each move costs 12 ms a probe."""
DEPTH_COLUMNS: Final[dict[Quality, int]] = {"preview": 256, "good": 640, "final": 640}
SAME_MOVE: Final = 1e-6
"""Objects whose transforms differ by less have moved together: a micrometre."""
NEAR_WHITE, SATURATED = (float(value) for value in srgb8_to_linear(np.array([235, CLIPPED_SRGB8], np.uint8)))
"""Shares of white between which a pixel is clipped ever more: a window's keep their light, others may be brighter."""
BRIGHTER: Final = np.float32(0.25)
"""Mean excess over white of a pixel with all channels clipped, as a share of white, where clipped pixels are around."""
CLIPPED_AROUND: Final = (31, np.float32(8.0))
"""Side of the square, in pixels, and inverse of the share of it from which on clipped pixels are around: one alone, a
highlight or noise, changes nothing."""
COLOUR_AROUND: Final = 61
"""Side of the square, in pixels, whose unclipped pixels give the colour of a clipped one."""
SHADOW_COLUMNS: Final = 640
"""Shadows of wider frames are computed as for frames of about this width, and interpolated."""


def clipping_range(frame: Frame, crop: Crop) -> tuple[np.float32, np.float32] | None:
    """Return the radiances between which pixels are clipped ever more; None where no pixel of the crop saturates."""
    if not frame.clipped[crop.slices].any():
        return None
    sampled = frame.image[::4, ::4][frame.clipped[::4, ::4]]  # enough to know the white
    white = np.float32(np.median(sampled.max(axis=1)) if len(sampled) else white_of(frame))
    return np.float32(NEAR_WHITE) * white, np.float32(SATURATED) * white


def shadow_step(quality: Quality, width: int) -> int:
    """Return every how many pixels of a frame of this width the shadow is computed."""
    return shadows.QUALITIES[quality].step * max(1, round(width / SHADOW_COLUMNS))


class Compositor:
    """Puts the objects of a scene into the frames of a session. Not thread-safe, as the session.

    Examples:
        >>> import roomlight as rl
        >>> frame, session = next(iter(rl.open_capture(rl.sample_capture()))), rl.Session()
        >>> report = session.push(frame)
        >>> scene = rl.scene_of_object("sphere", (160.0, 200.0))
        >>> composite = rl.Compositor(session, scene, quality="preview").composite(frame)
    """

    def __init__(
        self,
        session: Session,
        scene: Scene | Sequence[SceneObject] | str | Path,
        *,
        quality: str = "good",
        seed: int = 0,
        match_camera: bool = True,
        light: GivenLight | None = None,
        max_paths: int | None = None,
    ) -> None:
        """Begin; objects are placed at the first frame, or at the frame that their pixel belongs to.

        Args:
            session: gives light and geometry; the caller pushes its frames.
            scene: the objects, or the path of a scene.json.
            quality: preview (30 ms for a sphere in 640 x 480 pixels on two cores), good or final.
            seed: of the sampling points; the same seed gives the same picture.
            match_camera: give objects the frame's noise and blur.
            light: from elsewhere (a light probe, another estimator): a `Light`, a panorama, or a function that returns
                either at a world position, in the unit of the frames; default the session's light.
            max_paths: limit on the light paths of a picture, see `render_objects`; `Composite.samples` says what a
                pixel got.

        Raises:
            OptionError: the session or the light is none, or the quality is unknown.
            SceneError: the scene or its file is refused, or a position or pose.
            ObjectError: an object's file is refused.
        """
        check_type(session, Session, "session")
        if quality not in get_args(Quality):
            raise OptionError(f"quality must be one of {', '.join(get_args(Quality))}; got {quality!r}")
        if isinstance(scene, str | Path):
            scene = load_scene(scene)
        self.scene = scene if isinstance(scene, Scene) else Scene(tuple(scene))
        self.quality: Quality = cast(Quality, quality)
        self.geometry = RoomGeometry()
        self._session, self._seed, self._match, self._max_paths = session, seed, match_camera, max_paths
        self._placed: list[PlacedObject] = []
        self._probes = ObjectProbes(session, given_light(light))
        self._shadow_lights = ShadowLights()
        self._depth, self._shadow = DepthFilter(), ShadowHistory()
        self._objects: TracedObjects | None = None
        self._matrices: list[bytes] = []
        self._built_at: list[Float[np.ndarray, "4 4"]] = []
        self._camera, self._camera_age = CameraModel.perfect(), 0
        self._camera_shape: tuple[int, ...] = ()
        self._first: Moment | None = None
        self._before: Moment | None = None
        self._closed = False
        for scene_object in self.scene.objects:  # refuse bad places now, not at the first frame
            if not isinstance(scene_object.place, AtPixel):
                placement_of(scene_object)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Names of the objects that have no place yet."""
        done = {placed.number for placed in self._placed}
        return tuple(item.name for number, item in enumerate(self.scene.objects) if number not in done)

    def placement(self, name: str) -> Placement:
        """Return where an object was placed, before its motion.

        Raises:
            SceneError: the scene has no such object, or it has no place yet.
        """
        for placed in self._placed:
            if placed.object.name == name:
                return placed.placement
        names = ", ".join(item.name for item in self.scene.objects)
        raise SceneError(f"{name!r} has no place yet; the scene has {names}")

    def composite(self, frame: Frame) -> Composite:
        """Return the frame with the objects in it.

        The frame need not be the session's last one, but its pose must be in the session's world.

        Raises:
            SceneError: the session has no frame yet, or a pixel of this frame shows no known surface; nothing changed.
                Or the compositor is closed.
            FrameError: `frame` is none.
        """
        return self._step(frame, is_drawn=True)

    def follow(self, frame: Frame) -> None:
        """Do what later pictures need of a frame, without its picture: places, eased light, depth and shadows.

        Raises:
            SceneError, FrameError: as `composite`.
        """
        self._step(frame, is_drawn=False)

    def _step(self, given: Frame, *, is_drawn: bool) -> Composite:
        check_type(given, Frame, "frame", FrameError)
        if self._closed:
            raise SceneError("the compositor is closed: make a new one, or close it after its last frame")
        if self._session.frames == 0:
            raise SceneError("the session has no light and no geometry yet: push a frame first")
        clock = StageClock()
        frame = given if given.exposure == 1.0 else replace(given, image=given.recorded)
        with clock.stage("place"):
            self._place_waiting(frame)
            self.geometry.update(self._session, latest=False)
            posed = PosedObjects.at(self._placed, elapsed_since(self._first or frame, frame), frame.index)
            crop, object_crop = self._crops(frame, posed)
        step_s = 0.0 if self._before is None else elapsed_s(self._before, frame)
        if self._placed:
            with clock.stage("light"):
                self._probes.advance(step_s, every_s=LIGHT_EVERY_S[self.quality])
        with clock.stage("depth"):
            if frame.depth_estimated:  # averaged once it is fitted
                depth_m = reduced(frame.depth_m, DEPTH_COLUMNS[self.quality])
            else:
                depth_m = self._depth.push(frame, max_width=DEPTH_COLUMNS[self.quality])
        with clock.stage("combine"):
            image = encode_srgb8(frame.image)
        self._before = Moment(given.timestamp_s, given.index)
        self._first = self._first or self._before
        bare = Composite(
            image=image,
            frame=given,
            gain=self._gain(given),
            stage_ms=clock.wall_ms,
            stage_cpu_ms=clock.cpu_ms,
            waiting=self.waiting,
            placements={placed.number: placed.placement for placed in self._placed},
        )
        if crop.empty:
            return bare
        with clock.stage("camera"):
            self._follow_camera(image)
        with clock.stage("scene"):
            matrices = self._matrices
            objects = self._built(posed.matrices)
        with clock.stage("depth"):
            real, shaded_m = self._room_depth(depth_m, frame, crop, posed)
        with clock.stage("shadow"):
            at_once = self.quality != "preview" and self._matrices != matrices  # a moving object's would lag
            share = 1.0 if at_once else share_of(step_s, SHADOW_S)
            shadow = self._shadow_ratio(frame, crop, shaded_m, posed, share)
        if not is_drawn:
            return bare
        with clock.stage("render"):
            supports = supports_of(objects, posed.spheres, posed.supports)
            rendered = self._render(frame, objects, supports, crop, shadow)
        with clock.stage("occlusion"):
            layer = self._layer(frame, image, real.part(object_crop.inside(crop)), rendered, object_crop, posed)
        with clock.stage("combine"):
            self._combine(frame, image, (crop, object_crop), shadow, layer)
        numbers = np.array([*(placed.number for placed in self._placed), -1], np.int32)
        inner = object_crop.slices
        depth_m, object_id = rendered.depth_m[inner], numbers[rendered.object_id[inner]]  # -1 reads the last entry
        covered, nearest = object_id >= 0, object_id
        if (rim := (layer[..., 3] > 0) & ~covered).any() and covered.any():  # blurred as the frame is
            at = extended(np.arange(covered.size).reshape(covered.shape), covered)
            nearest = object_id.ravel()[at]
            depth_m, object_id = np.where(rim, depth_m.ravel()[at], depth_m), np.where(rim, nearest, object_id)
        return replace(
            bare,
            crop=crop,
            object_crop=object_crop,
            crop_objects=layer[..., :3],
            crop_alpha=np.ascontiguousarray(layer[..., 3]),
            crop_shadow=shadow,
            crop_depth_m=depth_m,
            crop_object_id=object_id,
            visible=visible_shares(nearest, layer[..., 3], rendered.alpha[inner]),
            samples=rendered.samples,
        )

    def close(self) -> None:
        """Stop tracking the objects' positions in the session; no frame can be composited afterwards."""
        self._closed = True
        self._probes.close()

    def _place_waiting(self, frame: Frame) -> None:
        done = {placed.number for placed in self._placed}
        new: list[PlacedObject] = []
        positions: list[Float[np.ndarray, "n 3"]] = []
        for number, scene_object in enumerate(self.scene.objects):
            place = scene_object.place
            if number in done or (isinstance(place, AtPixel) and place.frame not in (None, frame.index)):
                continue
            self.geometry.update(self._session)
            with naming_object(number, scene_object.name):
                new.append(place_object(number, scene_object, self.geometry, frame))
                positions.append(probe_positions(new[-1]))
        for placed, own in zip(new, positions, strict=True):
            self._probes.add(own, blend=placed.object.motion is None)
        self._placed = sorted([*self._placed, *new], key=lambda placed: placed.number)

    def _crops(self, frame: Frame, posed: PosedObjects) -> tuple[Crop, Crop]:
        """Return the rectangles around objects and shadows, and around the objects alone, inside the first."""
        k, pose = frame.intrinsics, frame.camera_to_world
        crop = object_crop = NO_CROP
        reach = shadows.QUALITIES[self.quality].reach
        for sphere in posed.spheres:
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
        if image.shape != self._camera_shape:
            self._camera_age, self._camera_shape = 0, image.shape
        if self._camera_age % CAMERA_EVERY == 0:
            measured = measure_camera(image.astype(np.float32) / np.float32(255))
            if not measured.known:  # the next frame may tell
                return
            self._camera = measured if self._camera_age == 0 else self._camera.eased(measured, 0.3)
        self._camera_age += 1

    def _built(self, matrices: list[Float[np.ndarray, "4 4"]]) -> TracedObjects:
        keys = [matrix.tobytes() for matrix in matrices]
        if self._objects is None or keys != self._matrices:
            self._objects = self._moved(matrices)
            self._matrices = keys
        return self._objects

    def _moved(self, matrices: list[Float[np.ndarray, "4 4"]]) -> TracedObjects:
        """Return the objects in their new places: the scene before, moved, if all have moved together."""
        if self._objects is not None and len(matrices) == len(self._built_at):
            moves = [new @ np.linalg.inv(old) for new, old in zip(matrices, self._built_at, strict=True)]
            if is_rigid(moves[0]) and all(np.abs(move - moves[0]).max() < SAME_MOVE for move in moves):
                return self._objects.moved(moves[0])
        self._built_at = matrices
        pairs = zip(self._placed, matrices, strict=True)
        built = [placed.object.geometry.transformed(matrix) for placed, matrix in pairs]
        return TracedObjects(built, like=self._objects)

    def _gain(self, frame: Frame) -> Gain:
        """Return the factors by which the recorded frame's radiance becomes that of the light."""
        red, green, blue = NO_GAIN if self._probes.given else self._session.gain_of(frame.index)
        return red / frame.exposure, green / frame.exposure, blue / frame.exposure

    def _render(
        self,
        frame: Frame,
        objects: TracedObjects,
        supports: Supports,
        crop: Crop,
        shadow: Float32[np.ndarray, "ch cw 3"],
    ) -> RenderedObjects:
        """Return the objects in the recorded frame's unit; glass shows the shadow of the crop."""
        gain, behind = self._gain(frame), None
        if (objects.materials.transmission > 0).any():
            seen = with_gain(frame.image, gain)  # a copy
            seen[crop.slices] *= shadow
            behind = BehindGlass(replace(frame, image=seen))
        rendered = render_objects(
            objects,
            frame.intrinsics,
            frame.camera_to_world,
            self._probes.lights(),
            quality=self.quality,
            seed=self._seed,
            background=behind,
            supports=supports,
            max_paths=self._max_paths,
        )
        if gain == NO_GAIN:
            return rendered
        return replace(rendered, radiance=rendered.radiance / np.array(gain, np.float32))

    def _room_depth(
        self, depth_m: Float32[np.ndarray, "dh dw"], frame: Frame, crop: Crop, posed: PosedObjects
    ) -> tuple[RealDepth, Float32[np.ndarray, "ch cw"]]:
        """Return depth at the pixels of a crop, with holes filled from other frames: as measured, which hides objects,
        and completed where nothing was measured: shadows fall on black and shiny tables too.
        """
        depth_m = self._filled(depth_m, frame, crop)
        if frame.depth_estimated:
            depth_m = fitted_to_supports(depth_m, frame, posed.supports, posed.spheres, self.geometry)
            depth_m = self._depth.push(replace(frame, depth_m=depth_m), max_width=DEPTH_COLUMNS[self.quality])
        size = frame.intrinsics.width, frame.intrinsics.height
        real = real_depth(depth_m, *size, crop)
        whole = complete_depth(depth_m)
        return real, real.depth_m if whole is depth_m else real_depth(whole, *size, crop).depth_m

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

    def _shadow_ratio(
        self, frame: Frame, crop: Crop, depth_m: Float32[np.ndarray, "ch cw"], posed: PosedObjects, share: float
    ) -> Float32[np.ndarray, "ch cw 3"]:
        """Return light with objects / without them on the real surfaces of a crop, eased over time by a share."""
        pose, limits, share_clipped = frame.camera_to_world, clipping_range(frame, crop), None
        image = frame.image[crop.slices]
        if limits is not None:
            image, share_clipped = np.ascontiguousarray(image), np.zeros(crop.shape, np.float32)
            fill_clipped_share(image, *limits, share_clipped)
        ratio = shadows.shadow_ratio(
            [self._caster(members, posed) for members in clusters(posed.spheres)],
            depth_m,
            CropCamera.of(frame.intrinsics, crop),
            pose,
            replace(shadows.QUALITIES[self.quality], step=shadow_step(self.quality, frame.intrinsics.width)),
            supports=posed.planes,
            smooth=partial(self._shadow.blend, camera_to_world=pose, share=share if share > 0 else 1.0),
            white=share_clipped,
        )
        if limits is not None:
            side, inverse = CLIPPED_AROUND
            around = cv2.blur(frame.clipped[crop.slices].astype(np.float32), (side, side))
            unclipped = np.empty((*crop.shape, 4), np.float32)
            fill_unclipped(image, limits[0], unclipped)
            unclipped = cv2.blur(unclipped, (COLOUR_AROUND, COLOUR_AROUND))
            restore_clipped(ratio, image, *limits, BRIGHTER * np.minimum(inverse * around, np.float32(1)), unclipped)
        return ratio

    def _caster(self, members: list[int], posed: PosedObjects) -> shadows.Caster:
        """Return objects that cast their shadows together, under the light of the first, which is the largest."""
        assert self._objects is not None
        x, y, z = posed.spheres[members[0]][:3].tolist()
        support = next((plane for member in members if (plane := posed.supports[member]) is not None), None)
        shadow_light = self._probes.reflection.at((x, y, z))
        if support is not None and self.quality != "preview" and not self._probes.given:
            observed = partial(self._probes.observed_at, (x, y, z))
            shadow_light = self._shadow_lights.light(shadow_light, observed, support, self.geometry, self._session)
        return shadows.Caster(
            scene=self._objects,
            spheres=np.stack([posed.spheres[member] for member in members]).astype(np.float32),
            object_ids=np.array(members, np.int32),
            light=self._probes.lighting.at((x, y, z)),
            reflection=shadow_light,
            support=support,
            room=self.geometry,
        )

    def _layer(
        self,
        frame: Frame,
        image: UInt8[np.ndarray, "h w 3"],
        real: RealDepth,
        rendered: RenderedObjects,
        crop: Crop,
        posed: PosedObjects,
    ) -> Float32[np.ndarray, "oh ow 4"]:
        """Return premultiplied radiance and alpha of the visible part of the objects, blurred as the frame is."""
        if crop.empty:  # only the shadows are in the picture
            return np.zeros((*crop.shape, 4), np.float32)
        camera = CropCamera.of(frame.intrinsics, crop)
        object_id = rendered.object_id[crop.slices]
        carrier = on_carrier(real, camera, frame.camera_to_world, posed.supports, object_id)
        guide = image[crop.slices].astype(np.float32) / np.float32(255)
        visible = visibility(rendered.depth_m[crop.slices], real, guide, carrier)
        if frame.depth_estimated:
            visible = without_islands(visible, object_id >= 0)
        layer = np.empty((*crop.shape, 4), np.float32)
        layer[..., :3] = rendered.radiance[crop.slices] * visible[..., None]
        layer[..., 3] = rendered.alpha[crop.slices] * visible
        return blur_layer(layer, self._camera.blur_px) if self._match else layer

    def _combine(
        self,
        frame: Frame,
        image: UInt8[np.ndarray, "h w 3"],
        crops: tuple[Crop, Crop],
        shadow: Float32[np.ndarray, "ch cw 3"],
        layer: Float32[np.ndarray, "oh ow 4"],
    ) -> None:
        """Put shadow and objects into the encoded frame, in place, with the camera's noise on the objects."""
        crop, inner = crops
        corner = inner.top - crop.top, inner.left - crop.left
        compose_srgb8(image[crop.slices], frame.image[crop.slices], shadow, layer, corner)
        if self._match and self._camera.noise.any() and not inner.empty:
            part = image[inner.slices]
            values, corner = part.astype(np.float32) / np.float32(255), (inner.top, inner.left)
            noisy = add_noise(values, layer[..., 3], self._camera, frame_index=frame.index, at=corner)
            part[:] = np.rint(noisy * 255).astype(np.uint8)


def composite(
    session: Session,
    frame: Frame,
    scene: Scene | Sequence[SceneObject] | str | Path,
    *,
    quality: str = "good",
    seed: int = 0,
    light: GivenLight | None = None,
) -> Composite:
    """Return one frame with objects in it; for a stream of frames, keep a `Compositor`, which has these options.

    Raises:
        OptionError: the session or the light is refused, or the quality is unknown.
        FrameError: `frame` is none.
        SceneError: the session has no frame, the scene or a place is refused, or an object is not in view.
        ObjectError: an object's file is refused.

    Examples:
        >>> import roomlight as rl
        >>> frame, session = next(iter(rl.open_capture(rl.sample_capture()))), rl.Session()
        >>> report = session.push(frame)
        >>> picture = rl.composite(session, frame, rl.scene_of_object("sphere", (160.0, 200.0)), quality="preview")
    """
    compositor = Compositor(session, scene, quality=quality, seed=seed, light=light)
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


def check_in_view(compositor: Compositor, frame: Frame) -> None:
    """Raise SceneError for an object that a single picture cannot show."""
    for item in compositor.scene.objects:
        placement, box = compositor.placement(item.name), item.box
        centre = transform_points(placement.object_to_world, (box.low + box.high) / 2)
        radius = float(np.linalg.norm(box.high - box.low)) / 2
        crop = crop_of_sphere(frame.intrinsics, frame.camera_to_world, centre, radius)
        offset = (centre - frame.camera_to_world[:3, 3]) @ frame.camera_to_world[:3, :3]
        if -offset[2] < -radius:
            raise SceneError(f"{item.name}: lies behind the camera, {offset[2]:.2f} m; place it in front")
        if crop.empty:
            raise SceneError(f"{item.name}: lies outside the picture; move it or the camera")
