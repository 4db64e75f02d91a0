"""The comparison of composites with the truth in another renderer, Mitsuba 3: in a small room, and in the Cornell box.

Nothing of the generator is used: neither its rooms nor its light transport nor its sensor. The room is described here:
4 x 2.6 x 4 m, with a chequered floor, coloured walls, a lamp under the ceiling, a bright panel on a wall and a box. The
Cornell box is the one that Mitsuba ships, 2 m wide, with its two boxes, its lamp and its open front. Each has three
views with one object. Pictures are 8-bit, clipped and without noise; depth is exact. World metres, y up; light in units
of white. Mitsuba is a development dependency.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.placement.scene import AtPosition, Scene, SceneObject
from roomlight.conventions import LUMINANCE, Position, linear_to_srgb8, panorama_rays, srgb8_to_linear
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight_evaluation.composites.regions import SHADOW, regions, smoothed_truth
from roomlight_evaluation.composites.scenes import NAME, CompositeScene, virtual_object

SIZE: Final = (200, 150)
FIELD_DEG: Final = 62.0
SAMPLES: Final = 64
_CONTEXT_SAMPLES: Final = 16
_FACE_PIXELS: Final = 64
_ROWS: Final = 120
_WHITE_PERCENTILE: Final = 80
_WHITE_LEVEL: Final = 0.43
"""As a phone exposes: the 80th percentile of luminance at 0.43 of white."""

_INSIDE_DEG: Final = (-70.0, -35.0, 60.0, 30.0, 0.0)
_OUTSIDE_DEG: Final = (-24.0, -12.0, 20.0, 10.0, 0.0)
"""Of views from inside a room, and through the open front of the Cornell box."""


@dataclass(frozen=True)
class MitsubaView:
    """A view of a scene with an object.

    Attributes:
        name: of the scene.
        parts: describes the scene to Mitsuba, given its module.
        shape: one of `SHAPES`.
        material: one of `MATERIALS`.
        place: world metres of the object's base.
        eye: world metres of the camera.
        pans_deg: directions of the frames about the vertical, relative to the object; the last is composited.
    """

    name: str
    parts: Callable[[Any], dict[str, Any]]
    shape: str
    material: str
    place: Position
    eye: Position
    pans_deg: tuple[float, ...]


def mitsuba_scene(view: MitsubaView, *, samples: int = SAMPLES) -> CompositeScene:
    """Render a view with and without its object, and the frames that a session sees.

    Raises:
        ImportError: Mitsuba is not installed.
    """
    geometry, place = virtual_object(view.shape, view.material), view.place
    scene_object = SceneObject(NAME, geometry, AtPosition(place))
    centre = np.add(place, [0, (scene_object.box.high[1] - scene_object.box.low[1]) / 2, 0])
    object_to_world = np.eye(4)
    object_to_world[:3, 3] = np.array(place) - scene_object.box.anchor("base")
    renderer = _Renderer(view.parts)
    empty, full = renderer.scene(), renderer.scene(geometry.transformed(object_to_world))
    poses = [_aimed(np.array(view.eye), centre, pan) for pan in view.pans_deg]
    camera = _camera(SIZE, FIELD_DEG)
    seen = [renderer.image(empty, camera, pose, _CONTEXT_SAMPLES, seed=k) for k, pose in enumerate(poses[:-1])]
    seen.append(renderer.image(empty, camera, poses[-1], samples, seed=99))
    radiance, depth_m = renderer.image(full, camera, poses[-1], samples, seed=99)
    scale = _WHITE_LEVEL / float(np.percentile(seen[-1][0] @ LUMINANCE, _WHITE_PERCENTILE))
    rendered = enumerate(zip(seen, poses, strict=True))
    frames = tuple(_frame(k, *images, scale, camera, pose) for k, (images, pose) in rendered)
    rays = camera.rays() * depth_m[..., None]
    points = rays @ poses[-1][:3, :3].T + poses[-1][:3, 3]
    low, high = geometry.bounds()
    covered = depth_m < seen[-1][1] - 0.01
    clean = radiance * np.float32(scale), seen[-1][0] * np.float32(scale)
    distance_m = np.linalg.norm(points - centre, axis=-1).astype(np.float32)
    masks = regions(*clean, covered, distance_m, radius_m=float(np.linalg.norm(high - low) / 2))
    x, y, z = centre.tolist()
    return CompositeScene(
        name=view.name,
        shape=view.shape,
        material=view.material,
        frame=frames[-1],
        objects=Scene((scene_object,)),
        position=(x, y, z),
        truth=smoothed_truth(frames[-1].image, _quantised(clean[0])[0], clean, covered, masks[SHADOW]),
        clean=clean,
        covered=covered,
        masks=masks,
        true_light=renderer.panorama(empty, centre, samples) * np.float32(scale),
        frames=frames,
        shift_m=0.0,
    )


class _Renderer:
    def __init__(self, parts: Callable[[Any], dict[str, Any]]) -> None:
        import mitsuba as mi

        self._parts = parts
        self._mi: Any = mi
        mi.set_variant("scalar_rgb")
        self._integrator = mi.load_dict(
            {"type": "aov", "aovs": "d:depth", "image": {"type": "path", "max_depth": 9, "hide_emitters": False}}
        )

    def scene(self, geometry: VirtualObject | None = None) -> Any:
        """Load the scene, with an object whose mesh is in the world."""
        parts = self._parts(self._mi)
        if geometry is not None:
            (mesh, look), *_ = geometry.parts
            shape = self._mi.Mesh("object", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True,
                                  props=self._properties(look))  # fmt: skip
            values = self._mi.traverse(shape)
            values["vertex_positions"] = mesh.vertices.ravel()
            values["vertex_normals"] = mesh.normals.ravel()
            values["faces"] = mesh.faces.ravel().astype(np.uint32)
            values.update()
            parts["object"] = shape
        return self._mi.load_dict({"type": "scene", **parts})

    def image(
        self,
        scene: Any,
        camera: Intrinsics,
        camera_to_world: Float[np.ndarray, "4 4"],
        samples: int,
        *,
        seed: int,
    ) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
        """Render radiance and z-depth."""
        film = {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        }
        flipped = camera_to_world @ np.diag([-1.0, 1, -1, 1])  # Mitsuba's cameras look along +z, x to the left
        sensor = self._mi.load_dict({
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            "near_clip": 0.01,
            "to_world": self._mi.ScalarTransform4f(flipped.tolist()),
            "film": film,
            "sampler": {"type": "multijitter", "sample_count": samples},
        })  # fmt: skip
        out = np.array(self._mi.render(scene, sensor=sensor, integrator=self._integrator, spp=samples, seed=seed))
        lengths = np.linalg.norm(camera.rays(), axis=-1)
        return out[..., :3].astype(np.float32), (out[..., 3] / lengths).astype(np.float32)

    def panorama(self, scene: Any, position: Float[np.ndarray, "3"], samples: int) -> Float32[np.ndarray, "h w 3"]:
        """Render the light at a point, by six views of 90 degrees."""
        camera = _camera((_FACE_PIXELS, _FACE_PIXELS), 90.0)
        rays = panorama_rays(_ROWS).astype(np.float64)
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        out, nearest = np.zeros((len(rays), 3), np.float32), (rays @ axes.T).argmax(axis=1)
        for k, axis in enumerate(axes):
            pose = np.eye(4)
            up = np.array([0.0, 0, 1]) if abs(axis[1]) > 0.5 else np.array([0.0, 1, 0])
            pose[:3, :3] = np.stack([np.cross(axis, up), up, -axis], axis=1)
            pose[:3, 3] = position
            image, _ = self.image(scene, camera, pose, samples, seed=1000 + k)
            mine = nearest == k
            xy, _ = camera.project(rays[mine] @ pose[:3, :3])
            column, row = np.clip(xy.astype(np.int64), 0, _FACE_PIXELS - 1).T
            out[mine] = image[row, column]
        return out.reshape(_ROWS, 2 * _ROWS, 3)

    def _properties(self, look: Material) -> Any:
        properties = self._mi.Properties()
        if look.metallic:
            bsdf: dict[str, Any] = {"type": "conductor", "material": "none"}
        elif look.specular == 0:
            bsdf = {"type": "diffuse", "reflectance": _rgb(*look.base_colour)}
        else:
            bsdf = {
                "type": "roughplastic",
                "distribution": "ggx",
                "alpha": look.roughness**2,
                "int_ior": look.ior,
                "diffuse_reflectance": _rgb(*look.base_colour),
                "nonlinear": False,
            }
        properties["bsdf"] = self._mi.load_dict({"type": "twosided", "inner": bsdf})
        return properties


def _room(mi: Any) -> dict[str, Any]:
    transform = mi.ScalarTransform4f

    def wall(at: list[float], toward: list[float], half: tuple[float, float], bsdf: dict[str, Any]) -> dict[str, Any]:
        up = [0.0, 0.0, 1.0] if abs(toward[1]) > 0.5 else [0.0, 1.0, 0.0]
        target = [a + b for a, b in zip(at, toward, strict=True)]
        to_world = transform().look_at(at, target, up) @ transform().scale([half[0], half[1], 1.0])
        return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}

    def matte(*colour: float) -> dict[str, Any]:
        return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": _rgb(*colour)}}

    chequered = {
        "type": "checkerboard",
        "color0": _rgb(0.55, 0.42, 0.3),
        "color1": _rgb(0.35, 0.25, 0.17),
        "to_uv": transform().scale([10.0, 10.0, 1.0]),
    }
    floor = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": chequered}}
    black = matte(0.0, 0.0, 0.0)
    return {
        "floor": wall([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], (2.0, 2.0), floor),
        "ceiling": wall([0.0, 2.6, 0.0], [0.0, -1.0, 0.0], (2.0, 2.0), matte(0.8, 0.8, 0.8)),
        "left": wall([-2.0, 1.3, 0.0], [1.0, 0.0, 0.0], (2.0, 1.3), matte(0.6, 0.25, 0.2)),
        "right": wall([2.0, 1.3, 0.0], [-1.0, 0.0, 0.0], (2.0, 1.3), matte(0.25, 0.35, 0.6)),
        "back": wall([0.0, 1.3, -2.0], [0.0, 0.0, 1.0], (2.0, 1.3), matte(0.7, 0.68, 0.6)),
        "front": wall([0.0, 1.3, 2.0], [0.0, 0.0, -1.0], (2.0, 1.3), matte(0.5, 0.55, 0.45)),
        "lamp": wall([0.7, 2.55, -0.6], [0.0, -1.0, 0.0], (0.25, 0.25), black)
        | {"emitter": {"type": "area", "radiance": _rgb(30.0, 26.0, 20.0)}},
        "panel": wall([-1.98, 1.4, 0.2], [1.0, 0.0, 0.0], (0.5, 0.6), black)
        | {"emitter": {"type": "area", "radiance": _rgb(1.5, 1.8, 2.4)}},
        "box": {
            "type": "cube",
            "to_world": transform().translate([1.2, 0.35, -1.3]) @ transform().scale([0.35, 0.35, 0.35]),
            "bsdf": matte(0.3, 0.5, 0.3),
        },
    }


def _cornell_box(mi: Any) -> dict[str, Any]:
    """Return Mitsuba's Cornell box without its camera, standing on y = 0."""
    raised = mi.ScalarTransform4f().translate([0.0, 1.0, 0.0])
    parts = {name: part for name, part in mi.cornell_box().items() if name not in ("type", "integrator", "sensor")}
    return {
        name: part | {"to_world": raised @ part["to_world"]} if "to_world" in part else part
        for name, part in parts.items()
    }


VIEWS: Final = (
    MitsubaView("small room", _room, "sphere", "mirror", (0.0, 0.0, 0.1), (0.3, 1.4, 1.5), _INSIDE_DEG),
    MitsubaView("small room", _room, "cube", "glossy", (0.5, 0.0, -0.4), (-0.9, 1.5, 0.8), _INSIDE_DEG),
    MitsubaView("small room", _room, "vase", "diffuse", (-0.6, 0.0, 0.3), (0.5, 1.3, 1.6), _INSIDE_DEG),
    MitsubaView("Cornell box", _cornell_box, "sphere", "mirror", (-0.35, 0.0, 0.6), (0.3, 1.3, 2.2), _OUTSIDE_DEG),
    MitsubaView("Cornell box", _cornell_box, "cube", "glossy", (0.335, 0.6, 0.38), (-0.2, 1.5, 2.2), _OUTSIDE_DEG),
    MitsubaView("Cornell box", _cornell_box, "vase", "diffuse", (-0.5, 0.0, 0.45), (0.1, 1.2, 2.1), _OUTSIDE_DEG),
)


def _rgb(red: float, green: float, blue: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(red), float(green), float(blue)]}


def _camera(size: tuple[int, int], field_deg: float) -> Intrinsics:
    focal = size[0] / 2 / np.tan(np.radians(field_deg) / 2)
    return Intrinsics(float(focal), float(focal), size[0] / 2, size[1] / 2, size[0], size[1])


def _aimed(eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], pan_deg: float) -> Float[np.ndarray, "4 4"]:
    """Return the pose that looks at a target, turned about the vertical."""
    away = (target - eye) / np.linalg.norm(target - eye)
    c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
    forward = np.array([c * away[0] - s * away[2], away[1], s * away[0] + c * away[2]])
    right = np.cross(forward, [0.0, 1, 0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(right, forward), -forward], axis=1)
    pose[:3, 3] = eye
    return pose


def _quantised(light: Float[np.ndarray, "h w 3"]) -> tuple[Float32[np.ndarray, "h w 3"], np.ndarray]:
    eight_bit = linear_to_srgb8(light)
    return srgb8_to_linear(eight_bit), eight_bit


def _frame(
    number: int,
    radiance: Float[np.ndarray, "h w 3"],
    depth_m: Float[np.ndarray, "h w"],
    scale: float,
    camera: Intrinsics,
    pose: Float[np.ndarray, "4 4"],
) -> Frame:
    linear, eight_bit = _quantised(radiance * scale)
    return Frame(
        index=number,
        image=linear,
        clipped=np.asarray((eight_bit >= CLIPPED_SRGB8).any(-1)),
        depth_m=depth_m,
        intrinsics=camera,
        camera_to_world=pose,
        timestamp_s=2.0 * number,
        source="mitsuba",
    )
