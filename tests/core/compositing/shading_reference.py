"""A readable twin of the shading: BRDFs in NumPy, integrated densely over a panorama; and views of a plane.

World axes, y up; the plane lies in y = 0.
"""

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.compositing.light.lighting import ProbeSet
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.primitives import plane
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.rendering.renderer import RenderSettings, render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import panorama_directions, panorama_solid_angles


def look_at(position, target) -> np.ndarray:
    """Return the camera-to-world pose of a camera at `position` that looks at `target`, +y up where it can be."""
    back = np.asarray(position, float) - np.asarray(target, float)
    back /= np.linalg.norm(back)
    up = np.array([0.0, 1.0, 0.0]) if abs(back[1]) < 0.999 else np.array([0.0, 0.0, -1.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, position
    return pose


def moved(item: VirtualObject, x: float, y: float = 0.0, z: float = 0.0) -> VirtualObject:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return item.transformed(pose)


def wall(material: Material, z: float = 0.0) -> VirtualObject:
    """Return a square of 4 m at z that faces +z."""
    return plane(4.0, 4.0, material).transformed(np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, z], [0, 0, 0, 1.0]]))


def lit_room(seed: int = 7) -> np.ndarray:
    """Return uneven light with a small lamp, 32 rows."""
    panorama = np.kron(np.random.default_rng(seed).random((4, 8, 3)), np.ones((8, 8, 1)))
    panorama[6:9, 20:24] = 20.0
    return panorama.astype(np.float32)


def paths(samples: int, bounces: int = 4, **more) -> RenderSettings:
    return RenderSettings(samples, bounces, denoised=False, **more)


def mirrored_rays(camera: Intrinsics, pose: np.ndarray, centre, radius: float) -> tuple[np.ndarray, ...]:
    """Return where each pixel's ray meets a sphere, its direction after a mirror there, and how deep it would pass.

    The last is the square of half its way through the sphere; below 0 it misses.
    """
    rays = camera.rays().astype(float) @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    offset = np.asarray(centre, float) - pose[:3, 3]
    toward = rays @ offset
    square = toward**2 - (offset @ offset - radius**2)
    place = pose[:3, 3] + (toward - np.sqrt(np.maximum(square, 0)))[..., None] * rays
    normal = (place - centre) / radius
    return place, rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal, square


def plane_radiance(material: Material, panorama, degrees: float, *, samples: int = 1024, seed: int = 0) -> np.ndarray:
    """Render a plane from far away, `degrees` off its normal toward +x; returns each pixel's radiance [64, 3]."""
    angle = np.radians(degrees)
    pose = look_at(1000 * np.array([np.sin(angle), np.cos(angle), 0]), np.zeros(3))
    camera = Intrinsics(800.0, 800.0, 4.0, 4.0, 8, 8)
    scene = TracedObjects([plane(1000.0, 1000.0, material)])
    light = ProbeSet.single(panorama)
    picture = render_objects(scene, camera, pose, light, quality=paths(samples), seed=seed)
    assert picture.alpha.min() == 1
    return picture.radiance.reshape(-1, 3)


def exact_plane_radiance(material: Material, panorama, degrees: float, *, fine: int = 8) -> np.ndarray:
    """Integrate BRDF x radiance x cosine over the upper hemisphere, bilinear radiance at `fine` x its rows; [3]."""
    angle = np.radians(degrees)
    view = np.array([np.sin(angle), np.cos(angle), 0])
    rows = len(panorama) * fine
    light = panorama_directions(rows).reshape(-1, 3).astype(float)
    weight = np.repeat(panorama_solid_angles(rows)[:, 0].astype(float), 2 * rows)
    radiance = bilinear(panorama, rows).reshape(-1, 3)
    return (brdf(material, view, light) * radiance * (weight * np.maximum(light[:, 1], 0))[:, None]).sum(axis=0)


def bilinear(panorama, rows: int) -> np.ndarray:
    """Resample at the pixel centres of a finer panorama; wraps around, ends at the poles."""
    height, width = panorama.shape[:2]
    y = np.clip((np.arange(rows) + 0.5) / rows * height - 0.5, 0, height - 1)
    x = (np.arange(2 * rows) + 0.5) / (2 * rows) * width - 0.5
    top, left = np.minimum(y.astype(int), height - 2), np.floor(x).astype(int)
    v, u = (y - top)[:, None, None], (x - left)[None, :, None]
    upper = panorama[top][:, left % width] * (1 - u) + panorama[top][:, (left + 1) % width] * u
    lower = panorama[top + 1][:, left % width] * (1 - u) + panorama[top + 1][:, (left + 1) % width] * u
    return upper * (1 - v) + lower * v


def brdf(material: Material, view, light) -> np.ndarray:
    """Return f [n, 3] about the normal +y: the equations at the head of `roomlight.compositing.objects.materials`."""
    base, metal, alpha = np.array(material.base_colour), material.metallic, material.roughness**2
    normal_incidence = ((material.ior - 1) / (material.ior + 1)) ** 2 * material.specular
    lobe = _lobe(view, light, alpha)[:, None]
    half = light + view
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    edge = (1 - np.clip(half @ view, 0, 1))[:, None] ** 5
    kept = 1 - lobe_share(view, alpha, 1.0, 1.0)

    def bounces(f0, f90):
        return 1 / (1 - (f0 + (f90 - f0) / 21) * kept)  # Fdez-Aguera 2019

    scale = bounces(normal_incidence, material.specular)
    share = lobe_share(view, alpha, normal_incidence, material.specular) * scale
    dielectric = lobe * (normal_incidence + (material.specular - normal_incidence) * edge) * scale
    dielectric = dielectric + base * (1 - share) / np.pi
    return (1 - metal) * dielectric + metal * lobe * (base + (1 - base) * edge) * bounces(base, 1.0)


def lobe_share(view, alpha: float, f0, f90) -> np.ndarray:
    """Integrate the lobe over all directions: the share of light that it reflects toward `view`, [3]."""
    light = panorama_directions(512).reshape(-1, 3).astype(float)
    weight = np.repeat(panorama_solid_angles(512)[:, 0].astype(float), 1024) * np.maximum(light[:, 1], 0)
    half = light + view
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    edge = (1 - np.clip(half @ view, 0, 1)) ** 5
    lobe = _lobe(view, light, alpha) * weight
    return f0 * (lobe * (1 - edge)).sum() + f90 * (lobe * edge).sum()


def _lobe(view, light, alpha: float) -> np.ndarray:
    half = light + view
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    n_h, n_l, n_v = half[:, 1], np.maximum(light[:, 1], 1e-9), view[1]
    distribution = alpha**2 / (np.pi * (n_h**2 * (alpha**2 - 1) + 1) ** 2)
    masking = [2 * c / (c + np.sqrt(alpha**2 + (1 - alpha**2) * c**2)) for c in (n_l, n_v)]
    return np.where(light[:, 1] > 0, distribution * masking[0] * masking[1] / (4 * n_l * n_v), 0)
