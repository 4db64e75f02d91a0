"""Frames and panoramas of a Blender scene by Cycles: physical light, scene-linear, nothing clamped.

World: y up, metres, the floor at y = 0. Cycles' light has no photometric unit; `kcd_m2` scales it.
"""

import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.dataset.recording import ORDINARY
from roomlight.errors import DatasetError
from roomlight.images import read_colour
from roomlight.spheres import resize_panorama
from roomlight_generator.blender.scene import BLENDER_TO_WORLD, BlenderRoom, blender, quiet
from roomlight_generator.transport import FrameView, z_depth
from roomlight_generator.transport.paths import unit_rows

SENSOR_MM: Final = 36.0
FORWARD_TO_CENTRE: Final = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
"""Camera axes (columns: right, up, backward) of a panorama whose middle column looks along +x."""
_LEAST_BOUNCES: Final = 12
_LIMITS: Final = ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "transparent_max_bounces")
_KEPT: Final = (
    *("feature_set", "shading_system", "dicing_rate", "max_subdivisions", "volume_bounces"),
    *("caustics_refractive", "caustics_reflective"),
)
"""Settings of the file's own that its materials and shapes rest on: glass that lets shadow rays through has none of the
caustics that would bring the same light again."""
_LAMP_RADIUS_M: Final = 0.03
_SUN_RAD: Final = 0.0093
"""Least size of a lamp that is a point, and the sun's."""

FINER: Final = 2
"""Panoramas are rendered at this many times their height and averaged by solid angle: Cycles spreads its paths evenly
over a pixel's azimuth and elevation, and too many of them lie near a pole."""
_DARK: Final = 1e-5
"""Radiance, in Cycles' units, below which is what the denoiser makes of nothing."""
_BRIGHT: Final = 30.0
"""Medians of a probe's radiance above which reflected light is not denoised."""


class CyclesViews:
    """A renderer of an open scene (`sequences.render.Views`)."""

    def __init__(self, room: BlenderRoom, floor_y: float, *, samples: int) -> None:
        """Set the scene up, with `samples` paths a pixel of frames. It must be the one that is open in this process."""
        self._room, self._samples, self._origin = room, samples, np.array([0, floor_y, 0])
        self.kcd_m2 = 1.0
        bpy, scene = blender(), room.scene
        self._data = bpy.data.cameras.new("roomlight")
        self._camera = bpy.data.objects.new("roomlight", self._data)
        scene.collection.objects.link(self._camera)
        scene.camera = self._camera
        self._data.clip_start, self._data.clip_end = 0.01 / room.unit_m, 1000 / room.unit_m
        self._data.sensor_fit, self._data.sensor_width = "HORIZONTAL", SENSOR_MM
        _set_up(scene)
        self._bright = _denoise_what_surfaces_reflect(scene)
        _show_lamps(room, self._camera)

    def frame(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], *, seed: int) -> FrameView:
        """Render what a pinhole camera sees. Depth and kinds are those of the rays through the pixels' centres."""
        k, data = intrinsics, self._data
        self._room.scene.cycles.use_denoising = True
        self._room.scene.render.use_compositing = False
        data.type, data.lens = "PERSP", k.fx * SENSOR_MM / k.width
        longer = max(k.width, k.height)
        data.shift_x, data.shift_y = (k.width / 2 - k.cx) / longer, (k.cy - k.height / 2) / longer
        self._place(camera_to_world[:3, :3], camera_to_world[:3, 3])
        radiance = self._render(k.width, k.height, self._samples, seed)
        hits = self._first_hits(k, camera_to_world)
        kinds = np.where(hits.face >= 0, self._room.kinds[hits.face], ORDINARY).astype(np.uint8)
        return FrameView(radiance, z_depth(k, hits.distance_m), kinds.reshape(k.height, k.width))

    def depth(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> Float32[np.ndarray, "h w"]:
        """Compute the depth of `frame` alone."""
        return z_depth(intrinsics, self._first_hits(intrinsics, camera_to_world).distance_m)

    def panorama(
        self, position: Float[np.ndarray, "3"], height: int = 120, *, seed: int
    ) -> Float32[np.ndarray, "{height} 2*{height} 3"]:
        """Render the radiance that arrives at a point from all sides, the mean over each pixel.

        Reflected light is denoised. Lamps and sky are not: that would change the light of a lamp of a few pixels by a
        tenth. Nor is light above `_BRIGHT` medians, once they are known (`set_median`): a denoiser takes a third of the
        light of a lamp behind a shade or glass away. In rooms of a thousand materials the error of log radiance is a
        tenth of that of as many raw samples.
        """
        return self._panorama(position, height, self._samples, seed)

    def set_median(self, position: Float[np.ndarray, "3"], kcd_m2: float) -> None:
        """Scale all light so that the median of what arrives at a point is `kcd_m2`.

        Raises:
            DatasetError: no light arrives there.
        """
        self.kcd_m2 = 1.0
        panorama = self._panorama(position, 24, 32, 0)
        if panorama.max() < _DARK:
            place = ", ".join(f"{value:.1f}" for value in position)
            raise DatasetError(f"{self._room.path}: no light arrives at ({place}) m; give the scene a lamp or a world")
        brightness = np.median(panorama.mean(axis=-1))
        self.kcd_m2 = kcd_m2 / max(float(brightness), 1e-9)
        self._bright.default_value = _BRIGHT * float(brightness)

    def _panorama(
        self, position: Float[np.ndarray, "3"], height: int, samples: int, seed: int
    ) -> Float32[np.ndarray, "h w 3"]:
        self._data.type, self._data.panorama_type = "PANO", "EQUIRECTANGULAR"
        self._data.shift_x = self._data.shift_y = 0.0
        self._place(FORWARD_TO_CENTRE, np.asarray(position))
        self._room.scene.cycles.use_denoising = False
        self._room.scene.render.use_compositing = True
        return resize_panorama(self._render(2 * FINER * height, FINER * height, samples, seed), height)

    def _place(self, axes: Float[np.ndarray, "3 3"], position: Float[np.ndarray, "3"]) -> None:
        matrix = np.eye(4)
        matrix[:3, :3] = BLENDER_TO_WORLD.T @ axes
        matrix[:3, 3] = BLENDER_TO_WORLD.T @ (position + self._origin) / self._room.unit_m
        self._camera.matrix_world = matrix.T.tolist()  # Blender takes columns

    def _render(self, width: int, height: int, samples: int, seed: int) -> Float32[np.ndarray, "h w 3"]:
        bpy, scene = blender(), self._room.scene
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.cycles.samples, scene.cycles.seed = samples, seed % 2**31
        with tempfile.TemporaryDirectory() as folder, quiet():
            scene.render.filepath = str(Path(folder) / "picture.exr")
            bpy.ops.render.render(write_still=True)
            picture, _ = read_colour(Path(scene.render.filepath))
        return np.asarray(picture[..., :3] * self.kcd_m2, np.float32)

    def _first_hits(self, k: Intrinsics, pose: Float[np.ndarray, "4 4"]) -> Any:
        directions = unit_rows(k.rays().reshape(-1, 3) @ pose[:3, :3].T)
        origins = np.broadcast_to(pose[:3, 3] + self._origin, directions.shape)
        return self._room.tree.trace_here(origins.astype(np.float32), directions)


def _show_lamps(room: BlenderRoom, camera: Any) -> None:
    """Let the camera see light objects, which Cycles hides from a camera's rays but not from refracted ones.

    The camera looks through a small box of refractive index 1 that nothing else sees: what it sees or what lights
    surfaces is visible to refracted rays. Lamps without size get one, and all cast shadows.
    """
    bpy, half = blender(), 0.02 / room.unit_m
    for thing in bpy.data.objects:
        thing.visible_transmission = thing.visible_camera or thing.visible_diffuse
        thing.is_holdout = thing.is_shadow_catcher = False
    for world in bpy.data.worlds:
        seen = world.cycles_visibility
        seen.transmission = seen.camera or seen.diffuse
    for light in bpy.data.lights:
        light.use_shadow = True
        if light.type in ("POINT", "SPOT"):
            light.shadow_soft_size = max(light.shadow_soft_size, _LAMP_RADIUS_M / room.unit_m)
        elif light.type == "SUN":
            light.angle = max(light.angle, _SUN_RAD)
    through = bpy.data.materials.new("roomlight")
    through.use_nodes = True
    tree = through.node_tree
    tree.nodes.clear()
    refraction, out = tree.nodes.new("ShaderNodeBsdfRefraction"), tree.nodes.new("ShaderNodeOutputMaterial")
    for socket, value in (("Color", (1, 1, 1, 1)), ("IOR", 1.0), ("Roughness", 0.0)):
        refraction.inputs[socket].default_value = value
    tree.links.new(refraction.outputs[0], out.inputs["Surface"])
    mesh = bpy.data.meshes.new("roomlight")
    corners = [(x * half, y * half, z * half) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    mesh.materials.append(through)
    box = bpy.data.objects.new("roomlight box", mesh)
    room.scene.collection.objects.link(box)
    box.parent = camera
    for kind in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(box, f"visible_{kind}", False)


def _denoise_what_surfaces_reflect(scene: Any) -> Any:
    """Make the compositor's graph: emission, sky and very bright light as they are, and all other light denoised.

    Cycles' albedo for denoisers has the emission of the first surface in it, or the sky: albedo alone is at most 1.

    Returns:
        The socket with the radiance, in Cycles' units, above which light is very bright; at first none is.
    """
    blender().context.view_layer.cycles.denoising_store_passes = True
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()

    def node(kind: str, *inputs: Any, **settings: Any) -> Any:
        made = tree.nodes.new(f"CompositorNode{kind}")
        for name, value in settings.items():
            setattr(made, name, value)
        for socket, value in zip(made.inputs, inputs, strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return made

    def mixed(how: str, first: Any, second: Any) -> Any:
        return node("MixRGB", 1.0, first, second, blend_type=how).outputs[0]

    layer = node("RLayers").outputs
    albedo = layer["Denoising Albedo"]

    def part(picture: Any, measure: Any, limit: float) -> tuple[Any, Any]:
        """Return the pixels of `picture` where a channel of `measure` is above a limit, and the limit's socket."""
        channels = node("SeparateColor", measure).outputs
        most = node("Math", channels[0], channels[1], operation="MAXIMUM").outputs[0]
        most = node("Math", most, channels[2], operation="MAXIMUM").outputs[0]
        above = node("Math", most, limit, operation="GREATER_THAN")
        return mixed("MULTIPLY", picture, above.outputs[0]), above.inputs[1]

    lamps, _ = part(albedo, albedo, 1.001)
    reflected = mixed("SUBTRACT", layer["Image"], lamps)
    bright, limit = part(reflected, reflected, 1e9)
    dim = mixed("SUBTRACT", reflected, bright)
    smooth = node("Denoise", dim, layer["Denoising Normal"], albedo, use_hdr=True).outputs[0]
    node("Composite", mixed("ADD", smooth, mixed("ADD", bright, lamps)))
    return limit


def _set_up(scene: Any) -> None:
    """Choose physical light, whatever the file's own settings are: no clamping, enough bounces; and one thread."""
    render, cycles = scene.render, scene.cycles
    scene.timeline_markers.clear()  # they choose cameras
    kept = {name: getattr(cycles, name) for name in (*_KEPT, *_LIMITS)}
    for setting in cycles.bl_rna.properties:
        cycles.property_unset(setting.identifier)
    for name, value in kept.items():
        setattr(cycles, name, max(value, _LEAST_BOUNCES) if name in _LIMITS else value)
    render.engine, cycles.device = "CYCLES", "CPU"
    render.use_sequencer = render.use_border = render.use_motion_blur = False
    render.use_stamp = render.use_multiview = render.use_freestyle = False
    render.resolution_percentage, render.pixel_aspect_x, render.pixel_aspect_y = 100, 1, 1
    render.threads_mode, render.threads = "FIXED", 1
    render.use_persistent_data = True  # a walk's frames share the scene
    render.film_transparent = False
    settings = render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    settings.exr_codec, settings.color_management = "ZIP", "FOLLOW_SCENE"
    for layer in scene.view_layers:
        layer.samples, layer.cycles.use_denoising = 0, True
    cycles.pixel_filter_type = "BOX"  # a wider filter would bring light of the poles of panoramas into larger pixels
    cycles.sample_clamp_indirect = 0.0
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.use_adaptive_sampling = False
