"""A room handed to Mitsuba 3, an unbiased path tracer, to check the generator's light transport against.

Mitsuba is a development dependency; its variant `llvm_ad_rgb` needs LLVM 16 or newer as a shared library. Meshes go
over with their shading normals and textures, the coat as `roughplastic` (index 1.5, linear), mirrors as a perfect
`conductor`, the sky as an environment map without what no opening can see, the sun as a direction. Glass panes are
left out: a path tracer would find small lights behind them by chance alone. The sun's disc is a point.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from roomlight_model.rooms.scene import Item, Material, Mesh, Opening, Scene, Sky

_SHEET_M = 1e-4
"""How far the two sides of a shining surface are put apart: Mitsuba's emitters shine from one side only."""


class Reference:
    """The radiance that arrives along rays, by path tracing without a cache."""

    def __init__(self, scene: Scene) -> None:
        """Load the scene; ImportError without Mitsuba, RuntimeError where LLVM is missing."""
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        self._mi = mi
        with tempfile.TemporaryDirectory(prefix="roomlight-reference-") as folder:
            self._scene = mi.load_dict(_description(mi, scene, Path(folder)))
        self._integrator = mi.load_dict({"type": "path", "max_depth": 40, "rr_depth": 12})

    def radiance(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        *,
        samples: int,
        seed: int,
        spread: Float[np.ndarray, "n 2 3"] | None = None,
    ) -> Float[np.ndarray, "n 3"]:
        """Mean radiance (kcd/m2) of each ray over so many paths.

        spread, where given, holds the two vectors that span a pixel about its ray: directions are jittered over it.
        """
        import drjit as dr

        mi = self._mi
        count = len(origins)
        total = np.zeros((count, 3), np.float64)
        batch = max(1, min(samples, 2_000_000 // max(count, 1)))
        done = 0
        while done < samples:
            paths = min(batch, samples - done)
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(seed * 1_000_003 + done, count * paths)
            o = np.repeat(origins, paths, axis=0)
            d = np.repeat(directions, paths, axis=0)
            if spread is not None:
                rng = np.random.default_rng([seed, done])
                jitter = rng.uniform(-0.5, 0.5, (len(d), 2, 1))
                d = d + (np.repeat(spread, paths, axis=0) * jitter).sum(1)
            d = d / np.linalg.norm(d, axis=1, keepdims=True)
            ray = mi.RayDifferential3f(
                mi.Point3f(np.asarray(o.T, np.float32)), mi.Vector3f(np.asarray(d.T, np.float32))
            )
            value, _, _ = self._integrator.sample(self._scene, sampler, ray)
            dr.eval(value)
            total += np.asarray(value, np.float64).T.reshape(count, paths, 3).sum(1)
            done += paths
        return (total / samples).astype(np.float32)


def _description(mi: Any, scene: Scene, folder: Path) -> dict[str, Any]:
    textures: dict[int, Any] = {}
    parts: dict[str, Any] = {"type": "scene"}
    for number, item in enumerate(scene.items):
        for k, material in enumerate(item.mesh.materials):
            chosen = item.mesh.face_materials == k
            if material.glass or not chosen.any():
                continue
            path = folder / f"{number}-{k}.ply"
            shape: dict[str, Any] = {"type": "ply", "filename": str(path), "bsdf": _bsdf(mi, material, textures)}
            if material.emits:
                for side, sign in (("front", 1), ("back", -1)):
                    own = path.with_name(f"{number}-{k}-{side}.ply")
                    _write_ply(own, item, chosen, offset=sign * _SHEET_M)
                    emitter = {"type": "area", "radiance": _emission(mi, material)}
                    parts[f"i{number}m{k}{side}"] = {**shape, "filename": str(own), "emitter": emitter}
            else:
                _write_ply(path, item, chosen)
                parts[f"i{number}m{k}"] = shape
    parts |= _outdoors(mi, scene.sky, scene.openings)
    return parts


def _write_ply(path: Path, item: Item, chosen: Any, *, offset: float = 0.0) -> None:
    """Binary PLY of the chosen faces; an offset moves them along their wound normals and makes them face that way."""
    mesh: Mesh = item.mesh
    faces = mesh.faces[chosen]
    vertices, normals, uvs = mesh.vertices, mesh.normals, mesh.uvs
    if offset:
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        wound = np.cross(b - a, c - a)
        wound /= np.maximum(np.linalg.norm(wound, axis=1, keepdims=True), 1e-20)
        corners = faces.reshape(-1)
        vertices = vertices[corners] + np.repeat(wound, 3, axis=0) * np.float32(offset)
        normals = np.repeat(wound * np.sign(offset), 3, axis=0)
        uvs = uvs[corners]
        faces = np.arange(len(corners)).reshape(-1, 3)
        if offset < 0:
            faces = faces[:, ::-1]
    used, renumbered = np.unique(faces, return_inverse=True)
    points = np.concatenate([vertices[used], normals[used], uvs[used]], 1).astype("<f4")
    triangles = np.empty(len(faces), [("count", "u1"), ("corner", "<i4", 3)])
    triangles["count"], triangles["corner"] = 3, renumbered.reshape(-1, 3)
    fields = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{fields}"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(head.encode() + points.tobytes() + triangles.tobytes())


def _bsdf(mi: Any, material: Material, textures: dict[int, Any]) -> dict[str, Any]:
    if material.mirror > 0:
        perfect = {"type": "rgb", "value": [material.mirror] * 3}
        return {"type": "twosided", "b": {"type": "conductor", "material": "none", "specular_reflectance": perfect}}
    colour = _colour(mi, material, material.albedo, textures)
    if material.roughness is None:
        return {"type": "twosided", "b": {"type": "diffuse", "reflectance": colour}}
    coat = {"type": "roughplastic", "distribution": "ggx", "alpha": material.roughness, "int_ior": 1.5, "ext_ior": 1.0}
    return {"type": "twosided", "b": {**coat, "nonlinear": False, "diffuse_reflectance": colour}}


def _emission(mi: Any, material: Material) -> Any:
    if material.textured_emission and material.texture is not None:
        return _texture(mi, material, material.emission)
    return {"type": "rgb", "value": [float(value) for value in material.emission]}


def _colour(mi: Any, material: Material, scale: tuple[float, float, float], textures: dict[int, Any]) -> Any:
    if material.texture is None or material.textured_emission:
        return {"type": "rgb", "value": [float(value) for value in scale]}
    return textures.setdefault(id(material), _texture(mi, material, scale))


def _texture(mi: Any, material: Material, scale: tuple[float, float, float]) -> Any:
    """The image times the colour, linear: bitmaps know no factor of their own."""
    assert material.texture is not None
    encoded = material.texture.image.astype(np.float32) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    bitmap = mi.Bitmap((linear * np.array(scale, np.float32)).astype(np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "repeat"})


def _outdoors(mi: Any, sky: Sky, openings: tuple[Opening, ...]) -> dict[str, Any]:
    if not openings:
        return {}
    panorama = sky.panorama.astype(np.float32)
    width = panorama.shape[1]
    # Mitsuba's u grows from -z by way of +x: a quarter turn from ours.
    parts: dict[str, Any] = {
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(np.roll(panorama, -width // 4, axis=1)))}
    }
    if sky.sun is not None:
        parts["sun"] = {
            "type": "directional",
            "direction": [-float(value) for value in sky.sun.direction],
            "irradiance": {"type": "rgb", "value": [float(value) for value in sky.sun.irradiance]},
        }
    return parts
