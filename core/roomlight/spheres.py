"""Spheres lit by a panorama: for pictures of results, and for the rendering loss and sphere metrics.

A sphere is seen orthographically along `view` (a world direction, from the camera toward the sphere), world +Y
up in the picture; image row 0 is the top. Radiance is linear. Materials:

| name    | model                                                                                            |
|---------|--------------------------------------------------------------------------------------------------|
| mirror  | perfect reflection                                                                               |
| glossy  | the paper's rendering layer: diffuse albedo 0.8 + GGX lobe (Karis 2013), roughness 0.2, F0 0.05  |
| matte   | matte silver: a white GGX conductor of roughness 0.5, energy-conserving                          |
| diffuse | white Lambertian: irradiance / pi                                                                |

A mirror, matte or diffuse sphere in a constant panorama has exactly that constant radiance (white furnace).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Shaped

from roomlight.conventions import Position, direction_to_uv, panorama_directions, panorama_solid_angles
from roomlight.errors import OptionError

Material = Literal["mirror", "glossy", "matte", "diffuse"]

DIFFUSE_ALBEDO: Final = 0.5
"""Of the diffuse sphere where pictures under two lights are compared; `SphereRenderer.pixels` has 1."""
GLOSSY_ALBEDO: Final = 0.8
GLOSSY_ROUGHNESS: Final = 0.2
GLOSSY_F0: Final = 0.05
"""Reflectance at normal incidence: not in the paper; its authors' public renderers use 0.05."""
MATTE_ROUGHNESS: Final = 0.5

_GLOSSY_SAMPLES: Final = 64  # rms 0.5 % of the mean against dense integration, in a real room
_MIRROR_STRATA: Final = 4  # 4 x 4 rays a pixel: a pixel of a 64-px sphere spans 3.6 degrees of a 1.5-degree panorama
_MATTE_ROWS: Final = 32  # 5.6 degrees a pixel under a lobe 28 degrees wide: rms 1.2 %, same room
_DIFFUSE_ROWS: Final = 16  # 11 degrees a pixel under a cosine: rms 0.4 %, same room
_SMOOTH_SIZE: Final = 96
"""Pixels across of pictures of glossy and matte spheres at most; larger ones are enlarged."""
_LOOKUP_COLUMNS: Final = 4096  # cv2.remap takes maps of fewer than 32768 rows and columns


def view_toward(camera_to_world: Float[np.ndarray, "4 4"], position: Position) -> tuple[float, float, float]:
    """Return the world direction in which a camera sees a sphere at `position`; at the camera itself, its axis."""
    line = np.asarray(position, np.float64) - camera_to_world[:3, 3]
    if np.linalg.norm(line) < 0.01:
        line = -camera_to_world[:3, 2]
    x, y, z = line.tolist()
    return x, y, z


class SphereRenderer:
    """Renders spheres of one size for one view; tables for a panorama's height are kept after first use."""

    def __init__(self, view: tuple[float, float, float], *, size: int = 64) -> None:
        """`view`: world direction of the camera's axis (any length but 0); `size`: pixels across.

        Raises:
            OptionError: `view` is zero or not finite, or `size` is below 4.
        """
        direction = np.asarray(view, np.float64)
        length = np.linalg.norm(direction)
        if not np.isfinite(length) or length < 1e-9:
            raise OptionError(f"view must be a finite direction that is not zero, got {view}")
        if size < 4:
            raise OptionError(f"size of a sphere must be 4 pixels or more, got {size}")
        self.size = size
        self._to_viewer = -direction / length
        up = np.array([0.0, 1.0, 0.0])
        if abs(self._to_viewer[1]) > 0.9999:  # looking straight up or down: +X is up in the picture instead
            up = np.array([1.0, 0.0, 0.0])
        right = np.cross(up, self._to_viewer)
        self._right = right / np.linalg.norm(right)
        self._up = np.cross(self._to_viewer, self._right)
        self._mirror: dict[int, _Lookup] = {}
        self._glossy: dict[int, list[_Lookup]] = {}
        self._dense: dict[tuple[Material, int], Float[np.ndarray, "n d"]] = {}

    @cached_property
    def mask(self) -> Bool[np.ndarray, "{self.size} {self.size}"]:
        """Pixels whose centre lies on the sphere."""
        x, y = self._grid(1)
        return x * x + y * y < 1

    @cached_property
    def coverage(self) -> Float[np.ndarray, "{self.size} {self.size}"]:
        """Share of each pixel that the sphere covers, for antialiased pasting onto a picture."""
        x, y = self._grid(8)
        inside = (x * x + y * y < 1).astype(np.float32)
        return inside.reshape(self.size, 8, self.size, 8).mean(axis=(1, 3))

    @cached_property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        """World normals at the centres of the mask's pixels, in row order."""
        x, y = self._grid(1)
        return self._normals(x[self.mask], y[self.mask])

    def render(
        self, panorama: Float[np.ndarray, "h w 3"], material: Material
    ) -> Float[np.ndarray, "{self.size} {self.size} 3"]:
        """Return the sphere's picture, linear; the rim's colours continue outside the mask (blend by `coverage`)."""
        if material != "mirror" and self.size > _SMOOTH_SIZE:
            return cv2.resize(self._small.render(panorama, material), (self.size, self.size))
        image = np.zeros((self.size, self.size, 3), np.float32)
        image[self.mask] = self.pixels(panorama, material)
        known = self.mask.astype(np.uint8)
        for _ in range(2):
            image = np.where(known[..., None], image, cv2.dilate(image, np.ones((3, 3), np.uint8)))
            known = cv2.dilate(known, np.ones((3, 3), np.uint8))
        return image

    @cached_property
    def _small(self) -> "SphereRenderer":
        x, y, z = (-self._to_viewer).tolist()
        return SphereRenderer((x, y, z), size=_SMOOTH_SIZE)

    def pixels(self, panorama: Float[np.ndarray, "h w 3"], material: Material) -> Float[np.ndarray, "n 3"]:
        """Return the linear radiance [n, 3] of the mask's pixels, in row order; metrics compare these.

        Raises:
            ValueError: the panorama is not twice as wide as high.
        """
        height, width = panorama.shape[:2]
        if width != 2 * height:
            raise ValueError(f"a panorama is twice as wide as high, this is {width} x {height}")
        panorama = np.ascontiguousarray(panorama, np.float32)
        if material == "mirror":
            if height not in self._mirror:
                self._mirror[height] = _Lookup.of(self._mirror_directions(), height)
            rays = self._mirror[height](panorama)
            return rays.reshape(-1, _MIRROR_STRATA**2, 3).mean(axis=1)
        if material == "glossy":
            return GLOSSY_ALBEDO * self.pixels(panorama, "diffuse") + self._glossy_lobe(panorama)
        rows = min(height, _MATTE_ROWS if material == "matte" else _DIFFUSE_ROWS)
        key = (material, rows)
        if key not in self._dense:
            self._dense[key] = self._dense_weights(material, rows)
        return self._dense[key] @ resize_panorama(panorama, rows).reshape(-1, 3)

    def _grid(self, strata: int) -> tuple[Float[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
        ticks = (np.arange(self.size * strata, dtype=np.float64) + 0.5) / (self.size * strata) * 2 - 1
        x, y = np.meshgrid(ticks, -ticks)
        return x, y

    def _normals(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        radius = np.hypot(x, y)
        shrink = np.minimum(1.0, 0.999 / np.maximum(radius, 1e-9))  # rays beyond the rim are moved to the rim
        x, y = x * shrink, y * shrink
        z = np.sqrt(1 - x * x - y * y)
        normals = x[:, None] * self._right + y[:, None] * self._up + z[:, None] * self._to_viewer
        return normals.astype(np.float32)

    def _reflect(self, normal: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        viewer = self._to_viewer.astype(np.float32)
        return 2 * (normal @ viewer)[..., None] * normal - viewer

    def _mirror_directions(self) -> Float[np.ndarray, "n 3"]:
        strata = _MIRROR_STRATA
        x, y = (
            grid.reshape(self.size, strata, self.size, strata).swapaxes(1, 2)[self.mask].reshape(-1)
            for grid in self._grid(strata)
        )
        return self._reflect(self._normals(x, y))

    def _dense_weights(self, material: Material, rows: int) -> Float[np.ndarray, "n d"]:
        """Return the weight of each pixel of a panorama of `rows` rows in each sphere pixel; each row sums to 1."""
        light = panorama_directions(rows).reshape(-1, 3)
        solid_angle = np.broadcast_to(panorama_solid_angles(rows), (rows, 2 * rows)).reshape(-1)
        n_l = np.maximum(self.normals @ light.T, 0)  # [n, d]
        weights = n_l * solid_angle
        if material == "matte":
            half = light + self._to_viewer.astype(np.float32)
            half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-6)
            n_h = np.clip(self.normals @ half.T, 0, 1)
            # F = 1 and n.v, constant in a row, cancel in the normalisation, which also restores the energy that a
            # single bounce off rough metal loses
            alpha = MATTE_ROUGHNESS**2
            weights *= _ggx(n_h, alpha) * _geometry(n_l, MATTE_ROUGHNESS)
        return weights / weights.sum(axis=1, keepdims=True)

    def _glossy_lobe(self, panorama: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n 3"]:
        height = panorama.shape[0]
        if height not in self._glossy:
            self._glossy[height] = self._glossy_lookups(height)
        lobe = np.zeros((len(self.normals), 3), np.float32)
        level = panorama
        for lookup in self._glossy[height]:
            if lookup.rows < level.shape[0]:
                level = resize_panorama(level, lookup.rows)
            lookup.add_to(lobe, level)
        return lobe

    def _glossy_lookups(self, height: int) -> list["_Lookup"]:
        """Sample the lobe by filtered importance sampling (Krivanek and Colbert 2008), finest panorama level first.

        Half vectors follow GGX over a fixed Hammersley set. Each sample reads the level whose pixels are as wide as the
        sample's solid angle, so that a lamp of one pixel is neither missed nor counted twice.
        """
        count, normals = _GLOSSY_SAMPLES, self.normals
        viewer = self._to_viewer.astype(np.float32)
        half_local = _ggx_half_vectors(count, GLOSSY_ROUGHNESS**2)  # [k, 3]
        tangent = np.cross(self._up.astype(np.float32), normals)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-6)
        frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=1)  # [n, 3 axes, 3]
        half = np.einsum("ka,nai->nki", half_local, frame)
        v_h = half @ viewer
        light = 2 * v_h[..., None] * half - viewer
        n_l = np.einsum("nki,ni->nk", light, normals)
        n_v = (normals @ viewer)[:, None]
        n_h = half_local[:, 2]
        lit = (n_l > 0) & (v_h > 0)
        fresnel = GLOSSY_F0 + (1 - GLOSSY_F0) * 2 ** ((-5.55473 * v_h - 6.98316) * v_h)
        # BRDF x n.l / density of the half vectors = F G (v.h) / ((n.h) (n.v)); n.l and n.v cancel with G's
        visibility = _geometry(n_l, GLOSSY_ROUGHNESS) * _geometry(n_v, GLOSSY_ROUGHNESS)
        weight = np.where(lit, fresnel * visibility * n_l * v_h / n_h / count, 0)
        density = _ggx(n_h, GLOSSY_ROUGHNESS**2) * n_h / (4 * np.maximum(v_h, 1e-3))
        pixels_wide = np.sqrt(1 / (count * density)) * height / np.pi
        deepest = max(0, int(np.log2(max(1, height / 8))))  # no coarser than about 8 rows
        level = np.clip(np.rint(np.log2(np.maximum(pixels_wide, 1))), 0, deepest).astype(int)
        pixel = np.broadcast_to(np.arange(len(normals))[:, None], level.shape)
        lookups: list[_Lookup] = []
        for depth in range(deepest + 1):
            chosen = lit & (level == depth)
            rows = max(1, round(height / 2**depth))
            lookups.append(_Lookup.of(light[chosen], rows, weight=weight[chosen], pixel=pixel[chosen]))
        return lookups


@dataclass(frozen=True)
class _Lookup:
    """Bilinear reads of a panorama of `rows` rows at fixed directions, wrapping at the seam."""

    rows: int
    count: int
    column: Float[np.ndarray, "r c"]
    row: Float[np.ndarray, "r c"]
    weight: Float[np.ndarray, " n"] | None = None
    pixel: Shaped[np.ndarray, " n"] | None = None

    @classmethod
    def of(
        cls,
        directions: Float[np.ndarray, "n 3"],
        rows: int,
        *,
        weight: Float[np.ndarray, " n"] | None = None,
        pixel: Shaped[np.ndarray, " n"] | None = None,
    ) -> "_Lookup":
        uv = direction_to_uv(directions)
        count = len(uv)
        lines = max(1, -(-count // _LOOKUP_COLUMNS))
        maps = np.zeros((2, lines * _LOOKUP_COLUMNS), np.float32)
        maps[0, :count] = uv[:, 0] * (2 * rows) + 0.5  # one column and one row of padding come before the first
        maps[1, :count] = uv[:, 1] * rows + 0.5
        column, row = maps.reshape(2, lines, _LOOKUP_COLUMNS)
        return cls(rows, count, column, row, None if weight is None else weight.astype(np.float32), pixel)

    def __call__(self, panorama: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the radiance at each direction."""
        padded = cv2.copyMakeBorder(panorama, 1, 1, 0, 0, cv2.BORDER_REPLICATE)
        padded = cv2.copyMakeBorder(padded, 0, 0, 1, 1, cv2.BORDER_WRAP)
        read = cv2.remap(padded, self.column, self.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return read.reshape(-1, 3)[: self.count]

    def add_to(self, image: Float[np.ndarray, "p 3"], panorama: Float[np.ndarray, "h w 3"]) -> None:
        """Add weight x radiance to the pixels that the directions belong to."""
        if self.count == 0 or self.weight is None or self.pixel is None:
            return
        read = self(panorama)
        for channel in range(3):
            image[:, channel] += np.bincount(self.pixel, self.weight * read[:, channel], len(image))


def radiance_along(
    panorama: Float[np.ndarray, "h w 3"], directions: Float[np.ndarray, "*n 3"]
) -> Float32[np.ndarray, "*n 3"]:
    """Read a panorama bilinearly along unit directions in its own axes."""
    read = _Lookup.of(directions.reshape(-1, 3), len(panorama))(np.asarray(panorama, np.float32))
    return read.reshape(directions.shape)


def resize_panorama(panorama: Float[np.ndarray, "h w 3"], rows: int) -> Float[np.ndarray, "{rows} 2*{rows} 3"]:
    """Resample a panorama to another number of rows; with the same number it is returned itself, not a copy.

    Smaller: the area mean weighted by solid angle, so that the light is conserved. Larger: bilinear, wrapping.
    """
    height = panorama.shape[0]
    if rows == height:
        return panorama
    if rows > height:
        return radiance_along(panorama, panorama_directions(rows))
    solid_angle, mean = _solid_angles(height, rows)
    return cv2.resize(panorama * solid_angle, (2 * rows, rows), interpolation=cv2.INTER_AREA) / mean


@lru_cache(maxsize=16)
def _solid_angles(
    height: int, rows: int
) -> tuple[Float[np.ndarray, "{height} 1 1"], Float[np.ndarray, "{rows} 2*{rows} 1"]]:
    """Return the solid angle of a panorama's pixels by row, and its mean over the pixels of a smaller panorama."""
    solid_angle = panorama_solid_angles(height)
    whole = np.broadcast_to(solid_angle, (height, 2 * height))
    mean = cv2.resize(whole, (2 * rows, rows), interpolation=cv2.INTER_AREA)
    return solid_angle[..., None], mean[..., None]


def _ggx(n_h: Float[np.ndarray, "*shape"], alpha: float) -> Float[np.ndarray, "*shape"]:
    """GGX (Trowbridge-Reitz) distribution of half vectors; alpha is roughness squared, as in Karis 2013."""
    return alpha**2 / (np.pi * (n_h * n_h * (alpha**2 - 1) + 1) ** 2)


def _geometry(cosine: Float[np.ndarray, "*shape"], roughness: float) -> Float[np.ndarray, "*shape"]:
    """Schlick's shadowing divided by the cosine, G1 / (n.x), with Karis's k = (roughness + 1)^2 / 8."""
    k = (roughness + 1) ** 2 / 8
    return 1 / (np.maximum(cosine, 0) * (1 - k) + k)


def _ggx_half_vectors(count: int, alpha: float) -> Float[np.ndarray, "{count} 3"]:
    """Half vectors about +Z with density D(h) (n.h), from a Hammersley set of `count` points."""
    index = np.arange(count)
    radical = np.array([int(f"{i:032b}"[::-1], 2) / 2**32 for i in index])
    azimuth = 2 * np.pi * (index + 0.5) / count
    uniform = radical + 0.5 / count
    cosine = np.sqrt((1 - uniform) / (1 + (alpha**2 - 1) * uniform))
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1).astype(np.float32)
