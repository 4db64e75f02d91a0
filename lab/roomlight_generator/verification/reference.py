"""A room in Mitsuba 3, an unbiased path tracer: the reference for the generator's light transport.

Mitsuba is a development dependency. It runs as `llvm_ad_rgb` where LLVM 16 or newer is found as a shared library,
otherwise as `scalar_rgb`, a thousand times slower. Meshes keep their shading normals and textures; the coat becomes
`roughplastic` (index 1.5, linear), a mirror a perfect `conductor`, the sky an environment map that is black in
directions that no opening shows. Glass panes are left out: paths would find small lights behind them by chance alone.

The sun is a directional light, toward another point of its disc in each batch of paths: soft shadows are right, but no
ray sees the disc itself (`sun_seen` tells where it is in view), and no sunlight arrives by way of a mirror. This avoids
single paths brighter than all others together.

Frames: world, y up, metres; radiance in kcd/m2.
"""

import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.conventions import srgb8_to_linear, uv_to_direction
from roomlight_generator.rooms.scene import Item, Material, Opening, Rgb, Scene, Sky, Sun
from roomlight_generator.transport import Tracer

_SHEET_M: Final = 5e-5
"""Distance by which either side of an emitting surface is moved out: Mitsuba's emitters emit from one side only.

It is a hundred times float32's step at 5 m, and 1 % of the gaps that it opens between a bulb's facets.
"""

_LEAST_AREA_M2: Final = 1e-11
"""Triangles of less area are left out: their normals are not reliable."""

_FARTHEST_UV: Final = 1e4
"""Texture coordinates beyond it are set to 0."""

_COVER_M: Final = 8e-3
"""Covers nearer to a light than this may let its sampled light through, to 9 m away at the most."""

_COVER_RAYS: Final = 32

_CLOSED_SHARE: Final = 0.995
"""An item is closed if more than this share of its rays end on itself: bulbs and shades have small cracks."""

_PATHS: Final = 1_000_000
"""Paths traced together: some 200 bytes each."""

_SUN_DIRECTIONS: Final = 8
"""Points of the sun's disc, each with a batch of paths; they depend on the seed. One more batch costs 0.1 s."""

_ROULETTE_DEPTH: Final = 5
"""Bounces before Russian roulette: 12 take twice the time for a tenth less noise."""

_EVEN_SHARE: Final = 0.3
"""Share of the paths' light samples that is spread evenly over the lights; the rest goes by power."""

_SKY_ROWS: Final = 257
"""Rows of the resampled sky: Mitsuba's maps have rows on the poles. With this many they differ by less than 1e-3."""

_TRIAL: Final = """
from drjit.detail import llvm_version
from drjit.llvm import Float
assert (Float([1, 2]) * 2)[1] == 4
assert llvm_version() >= (16,)
"""
"""Exits with an error where LLVM is missing or too old."""


@cache
def usable_variant() -> str:
    """Return Mitsuba's fastest variant that runs here.

    LLVM is tried in a process of its own: Mitsuba 3.9 exits with a version older than 16, some at the first scene.

    Raises:
        ImportError: if Mitsuba is not installed.
    """
    import drjit

    has_llvm = drjit.has_backend(drjit.JitBackend.LLVM)
    trial = [sys.executable, "-c", _TRIAL]
    if has_llvm and subprocess.run(trial, capture_output=True, check=False, timeout=120).returncode == 0:
        return "llvm_ad_rgb"
    return "scalar_rgb"


class Reference:
    """Radiance along rays, by path tracing without a cache."""

    def __init__(self, scene: Scene, *, variant: str | None = None) -> None:
        """Load the scene; the variant is `usable_variant()` if not given.

        Raises:
            ImportError: if Mitsuba is not installed.
        """
        import mitsuba as mi

        self._vectorised = (variant or usable_variant()) != "scalar_rgb"
        mi.set_variant(variant or usable_variant())
        self._mi = mi
        self._sun = scene.sky.sun if scene.openings else None
        with tempfile.TemporaryDirectory(prefix="roomlight-reference-") as folder:
            self._scene = mi.load_dict(_description(mi, scene, Path(folder)))
        self._parameters = mi.traverse(self._scene)
        self._integrator = mi.load_dict({"type": "path", "max_depth": 40, "rr_depth": _ROULETTE_DEPTH})

    def radiance(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        *,
        samples: int,
        seed: int,
        spread: Float[np.ndarray, "n 2 3"] | None = None,
    ) -> Float[np.ndarray, "n 3"]:
        """Compute the mean radiance (kcd/m2) along each ray.

        Args:
            origins, directions: The rays.
            samples: Paths of a ray.
            seed: Seed of the paths.
            spread: The two vectors that span a pixel about each ray: directions are jittered over it. None: no jitter.
        """
        count = len(origins)
        total = np.zeros((count, 3), np.float64)
        batches = max(-(-samples * count // _PATHS), min(samples, _SUN_DIRECTIONS) if self._sun else 1)
        borders = np.linspace(0, samples, min(batches, samples) + 1).astype(int)
        rng = np.random.default_rng(seed)
        shift = float(rng.random())
        for number, paths in enumerate(np.diff(borders).tolist()):
            if self._sun is not None:
                self._aim_sun(_in_disc(self._sun, (number + 0.5) / (len(borders) - 1), shift + number * 0.6180339887))
            d = np.repeat(directions, paths, axis=0)
            if spread is not None:
                jitter = rng.uniform(-0.5, 0.5, (len(d), 2, 1))
                d = d + (np.repeat(spread, paths, axis=0) * jitter).sum(1)
            d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
            o = np.repeat(origins, paths, axis=0).astype(np.float32)
            radiance = self._paths(o, d, seed=int(rng.integers(2**31)))
            total += radiance.reshape(count, paths, 3).sum(1)
        return (total / samples).astype(np.float32)

    def first_surfaces(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        *,
        samples: int,
        spread: Float[np.ndarray, "n 2 3"],
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Compute albedo and normal of the first surfaces, means over `samples` rays of a pixel: a denoiser's guides.

        Raises:
            ImportError: The variant is `scalar_rgb`.
        """
        if not self._vectorised:
            raise ImportError("guides of a denoiser need Mitsuba's llvm_ad_rgb: install LLVM 17 or newer")
        mi = self._mi
        integrator = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
        rng, total = np.random.default_rng(0), np.zeros((len(origins), 6), np.float32)
        for number in range(samples):
            d = directions + (spread * rng.uniform(-0.5, 0.5, (len(directions), 2, 1))).sum(1)
            d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(number, len(d))
            ray = mi.RayDifferential3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(d.T))
            values = integrator.sample(self._scene, sampler, ray)[2]
            total += np.stack([np.asarray(value, np.float32) for value in values[-6:]], 1) / samples
        return np.clip(total[:, :3], 0, 1), total[:, 3:]

    def sun_seen(self, position: Float[np.ndarray, "3"], *, samples: int = 256) -> Float[np.ndarray, "n 3"]:
        """Return those of `samples` directions spread over the sun's disc that no surface blocks at a point."""
        if self._sun is None:
            return np.zeros((0, 3))
        mi = self._mi
        toward = np.stack([_in_disc(self._sun, (k + 0.5) / samples, k * 0.6180339887) for k in range(samples)])
        if self._vectorised:
            origin = np.tile(np.asarray(position, np.float32), (samples, 1))
            ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(toward.astype(np.float32).T))
            blocked = np.asarray(self._scene.ray_test(ray), bool)
        else:
            start = mi.Point3f([float(value) for value in position])
            blocked = np.array(
                [self._scene.ray_test(mi.Ray3f(start, mi.Vector3f(direction))) for direction in toward.tolist()]
            )
        return toward[~blocked]

    def _aim_sun(self, toward: Float[np.ndarray, "3"]) -> None:
        mi = self._mi
        up = [1.0, 0.0, 0.0] if abs(toward[1]) > 0.9 else [0.0, 1.0, 0.0]
        to_world = mi.ScalarTransform4f().look_at([0, 0, 0], [-float(value) for value in toward], up)
        self._parameters["sun.to_world"] = mi.Transform4f(to_world)
        self._parameters.update()

    def _paths(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], *, seed: int
    ) -> Float[np.ndarray, "n 3"]:
        """Trace one path along each ray."""
        mi = self._mi
        sampler = mi.load_dict({"type": "independent"})
        if self._vectorised:
            sampler.seed(seed, len(origins))
            ray = mi.RayDifferential3f(mi.Point3f(origins.T), mi.Vector3f(directions.T))
            return np.asarray(self._integrator.sample(self._scene, sampler, ray)[0], np.float64).T
        sampler.seed(seed)
        out = np.empty((len(origins), 3))
        for i, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
            ray = mi.RayDifferential3f(mi.Point3f(o), mi.Vector3f(d))
            out[i] = self._integrator.sample(self._scene, sampler, ray)[0]
        return out


def _in_disc(sun: Sun, radius_sq: float, revolutions: float) -> Float[np.ndarray, "3"]:
    """Return the unit direction to a point of the sun's disc: squared radius in [0, 1], angle in revolutions."""
    toward = np.asarray(sun.direction, np.float64)
    side = np.cross(toward, [1.0, 0.0, 0.0] if abs(toward[0]) < 0.7 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    radius = sun.angular_radius * np.sqrt(radius_sq)
    off = radius * (np.cos(2 * np.pi * revolutions) * side + np.sin(2 * np.pi * revolutions) * np.cross(toward, side))
    return (toward + off) / np.linalg.norm(toward + off)


def _description(mi: Any, scene: Scene, folder: Path) -> dict[str, Any]:
    textures: dict[int, Any] = {}
    parts: dict[str, Any] = {}
    power: dict[str, float] = {}
    tracer = Tracer(scene)
    for number, item in enumerate(scene.items):
        for k, material in enumerate(item.mesh.materials):
            faces = _real_faces(item, item.mesh.face_materials == k)
            if material.glass or not len(faces):
                continue
            name = f"i{number}m{k}"
            shape: dict[str, Any] = {"type": "ply", "bsdf": _bsdf(mi, material, textures)}
            if not material.emits:
                parts[name] = {**shape, "filename": str(_write_ply(folder / f"{name}.ply", item, faces))}
                continue
            emitter = {"type": "area", "radiance": _rgb(material.emission)}
            for side in (1, -1):
                hidden = _hidden(tracer, number, item, faces, side)
                for kind, some in (("seen", faces[~hidden]), ("hidden", faces[hidden])):
                    if len(some):
                        own = f"{name}{'front' if side > 0 else 'back'}{kind}"
                        path = _write_ply(folder / f"{own}.ply", item, some, offset=side * _SHEET_M)
                        parts[own] = {**shape, "filename": str(path), "emitter": {**emitter, "sampling_weight": 0.0}}
                        if kind == "seen":
                            power[own] = np.pi * _area_m2(item, some) * float(np.mean(material.emission))
    outdoors = _outdoors(mi, scene)
    parts |= outdoors
    area = sum(opening.area_m2() for opening in scene.openings)
    if "sky" in outdoors:
        power["sky"] = np.pi * area * float(scene.sky.panorama.mean())
    if "sun" in outdoors and scene.sky.sun is not None:
        power["sun"] = 0.5 * area * float(np.mean(scene.sky.sun.irradiance))
    mean = sum(power.values()) / max(len(power), 1)
    for name, own in power.items():
        weight = _EVEN_SHARE + (1 - _EVEN_SHARE) * own / max(mean, 1e-30)
        parts[name].get("emitter", parts[name])["sampling_weight"] = float(weight)
    return {"type": "scene", **parts}


def _real_faces(item: Item, chosen: Bool[np.ndarray, " f"]) -> Int[np.ndarray, "c 3"]:
    faces = item.mesh.faces[chosen]
    return faces[np.linalg.norm(_cross_products(item, faces), axis=1) > _LEAST_AREA_M2]


def _cross_products(item: Item, faces: Int[np.ndarray, "c 3"]) -> Float[np.ndarray, "c 3"]:
    """Return the cross product of two sides: along the geometric normal, twice the area long."""
    a, b, c = (item.mesh.vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def _area_m2(item: Item, faces: Int[np.ndarray, "c 3"]) -> float:
    return 0.5 * float(np.linalg.norm(_cross_products(item, faces), axis=1).sum())


def _hidden(
    tracer: Tracer, number: int, item: Item, faces: Int[np.ndarray, "c 3"], side: int
) -> Bool[np.ndarray, " c"]:
    """Return which emitting faces paths should meet by chance only, not sample, on one side.

    Shadow rays of Mitsuba end 0.9 mm before a light for each metre of their length (ShadowEpsilon), so sampled light
    passes through a cover that is near enough. Samples on the insides of closed bulbs and shades would be wasted.
    """
    corners = item.mesh.vertices[faces].astype(np.float64)
    face_normals = _cross_products(item, faces)
    face_normals *= side / np.linalg.norm(face_normals, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    shape = len(faces), _COVER_RAYS
    root, place = np.sqrt(rng.random((*shape, 1))), rng.random((*shape, 1))
    weights = np.concatenate([1 - root, root * (1 - place), root * place], -1)
    origins = np.einsum("frc,fcd->frd", weights, corners) + 2 * _SHEET_M * face_normals[:, None]
    sphere = rng.normal(size=(*shape, 3))
    directions = sphere / np.linalg.norm(sphere, axis=-1, keepdims=True) + 1.001 * face_normals[:, None]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    hits = tracer.trace(origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32))
    hit = hits.face >= 0
    covered = (hit & (hits.distance_m < _COVER_M)).reshape(shape).mean(1) > 0.5
    own = hit & (tracer.geometry.item[hits.face] == number)
    return covered | bool(own.mean() > _CLOSED_SHARE)


def _write_ply(path: Path, item: Item, faces: Int[np.ndarray, "c 3"], *, offset: float = 0.0) -> Path:
    """Write the faces as binary PLY; an offset moves them along their normals and makes them face that way."""
    mesh = item.mesh
    vertices, normals, uvs = mesh.vertices, mesh.normals, mesh.uvs
    if offset:
        face_normals = _cross_products(item, faces)
        face_normals /= np.linalg.norm(face_normals, axis=1, keepdims=True)
        corners = faces.reshape(-1)
        vertices = vertices[corners] + np.repeat(face_normals, 3, axis=0) * offset
        normals = np.repeat(face_normals * np.sign(offset), 3, axis=0)
        uvs = uvs[corners]
        faces = np.arange(len(corners)).reshape(-1, 3)
        if offset < 0:
            faces = faces[:, ::-1]
    used, renumbered = np.unique(faces, return_inverse=True)
    # A bitmap looked up at 1e9 gives weights outside of 0 to 1, and so negative or unbounded light.
    uvs = np.where(np.abs(uvs) < _FARTHEST_UV, uvs, 0)
    points = np.concatenate([vertices[used], normals[used], uvs[used]], 1).astype("<f4")
    triangles = np.empty(len(faces), [("count", "u1"), ("corner", "<i4", 3)])
    triangles["count"], triangles["corner"] = 3, renumbered.reshape(-1, 3)
    fields = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{fields}"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(head.encode() + points.tobytes() + triangles.tobytes())
    return path


def _bsdf(mi: Any, material: Material, textures: dict[int, Any]) -> dict[str, Any]:
    if material.mirror > 0:
        perfect = {"type": "rgb", "value": [material.mirror] * 3}
        return {"type": "twosided", "b": {"type": "conductor", "material": "none", "specular_reflectance": perfect}}
    colour = _rgb(material.albedo)
    if material.texture is not None:
        if id(material) not in textures:
            textures[id(material)] = _texture(mi, material, material.albedo)
        colour = textures[id(material)]
    if material.roughness is None:
        return {"type": "twosided", "b": {"type": "diffuse", "reflectance": colour}}
    coat = {"type": "roughplastic", "distribution": "ggx", "alpha": material.roughness, "int_ior": 1.5, "ext_ior": 1.0}
    return {"type": "twosided", "b": {**coat, "nonlinear": False, "diffuse_reflectance": colour}}


def _rgb(value: Rgb) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(part) for part in value]}


def _texture(mi: Any, material: Material, scale: Rgb) -> Any:
    """Return the image times the colour, linear: Mitsuba's bitmaps have no factor."""
    assert material.texture is not None
    linear = srgb8_to_linear(material.texture.image) * np.array(scale, np.float32)
    bitmap = mi.Bitmap(np.ascontiguousarray(linear, np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"})


def _outdoors(mi: Any, scene: Scene) -> dict[str, Any]:
    if not scene.openings:
        return {}
    panorama = _resampled(scene.sky)
    rows, columns = panorama.shape[:2]
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, np.linspace(0, 1, rows))
    panorama = np.where(_seen(uv_to_direction(np.stack([u, v], -1)), scene)[..., None], panorama, 0)
    # Mitsuba's u grows from -z by way of +x, a quarter revolution from ours.
    rotated = np.ascontiguousarray(np.roll(panorama, -columns // 4, axis=1), np.float32)
    parts: dict[str, Any] = {}
    if rotated.max() > 0:
        parts["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(rotated)}
    if scene.sky.sun is not None:
        direction = [-float(value) for value in scene.sky.sun.direction]
        parts["sun"] = {"type": "directional", "direction": direction, "irradiance": _rgb(scene.sky.sun.irradiance)}
    return parts


def _resampled(sky: Sky) -> Float[np.ndarray, "h w 3"]:
    """Interpolate the panorama bilinearly, on rows from pole to pole."""
    height, width = sky.panorama.shape[:2]
    columns = 4 * max(1, 128 // width) * width
    wrapped = np.concatenate([sky.panorama[:, -1:], sky.panorama, sky.panorama[:, :1]], 1).astype(np.float32)
    u = (np.arange(columns, dtype=np.float32) + 0.5) / columns * width + 0.5
    v = np.linspace(0, 1, _SKY_ROWS, dtype=np.float32) * height - 0.5
    across, down = np.meshgrid(u, v)
    return cv2.remap(wrapped, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _seen(directions: Float[np.ndarray, "h w 3"], scene: Scene) -> Bool[np.ndarray, "h w"]:
    """Return which directions lead out through an opening.

    An opening is passed in one direction if nearly all of the scene is on one side of it; otherwise in both.
    """
    points = np.concatenate([item.mesh.vertices[item.mesh.faces.reshape(-1)] for item in scene.items])
    seen = np.zeros(directions.shape[:2], bool)
    for opening in scene.openings:
        out = _outward(opening, points)
        # 0.1: six degrees past the opening's plane, for texels that are interpolated with visible ones.
        seen |= True if out is None else directions @ out > -0.1
    return seen


def _outward(opening: Opening, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"] | None:
    normal = np.cross(opening.edge_u, opening.edge_v).astype(np.float64)
    normal /= np.linalg.norm(normal)
    height = (points - opening.corner) @ normal
    # Reveals, sills and shutters may stand outside, up to half a metre.
    if (height > 0.5).mean() < 1e-3:
        return normal
    return -normal if (height < -0.5).mean() < 1e-3 else None
