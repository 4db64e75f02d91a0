"""Lamps that no frame has shown, by the shadows of real things on the level surface that an object stands on.

A surface of one colour shows albedo x irradiance / pi. The irradiance is that of the light that frames have shown, of
even light from where none looked, and of lamps at `_LAMP_M` from the object; where each arrives follows from the room's
geometry. Their strengths are non-negative least squares (Lawson and Hanson 1974) over cells of the surface. They count
if they also explain cells that they were not fitted to: a pattern of the surface is no shadow. World metres, y up.

Cost on one core: 0.2 to 0.7 s, once for a place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.conventions import LUMINANCE, Position, panorama_directions, panorama_solid_angles
from roomlight.engine.session import Session
from roomlight.engine.surface.mesh import FrameMesh

RADIUS_M: Final = 1.8
"""Shadows are looked for within this distance of the object."""
LEVEL: Final = 0.99
"""Least cosine of a level surface's normal to the vertical."""
_CELL_M: Final = 0.06
_BLOCK: Final = 7
"""Cells of a side of the squares that are fitted and checked in turn."""
_MOST_CELLS, _FEWEST_CELLS = 1500, 200
_LAMP_M: Final = 2.5
"""As light from unknown surfaces in `roomlight.compositing.rendering.shadows`."""
_LAMP_COSINE: Final = float(np.cos(np.radians(12.0)))
"""Lamps are as wide as their directions lie apart."""
_RINGS: Final = ((12, 30), (24, 28), (36, 24), (48, 20), (60, 14), (72, 8), (85, 3))
"""Elevation in degrees and number of the places of lamps."""
_LEAST_ALBEDO: Final = 0.25
"""A darker surface would need more lamps for the same radiance."""
_DAMPING: Final = 0.1
_LEAST_EXPLAINED: Final = 0.6
"""Of the variance of cells that were not fitted. A prototype with this, albedos of 0.1 to 0.4 and damping of 0.03 and
0.1 had 0.93 to 0.95 of the error of shadows without lamps in 39 rooms."""
_LEAST_SHADE: Final = 0.1
"""Root mean square of what light without lamps leaves unexplained, relative to the surface's mean."""
_SAME_COLOUR: Final = 0.06
_LIFT_M: Final = 0.03
_SAME_PLACE_M: Final = 0.3
_MOST_PLACES: Final = 64


@dataclass(frozen=True, eq=False)
class UnseenLamps:
    """Lamps around an object.

    Attributes:
        directions: [k, 3] unit, from the object.
        energy: [k] irradiance of each on a surface that faces it, grey, in the unit of radiance.
    """

    directions: Float32[np.ndarray, "k 3"]
    energy: Float[np.ndarray, " k"]

    def added_to(self, panorama: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Return a panorama at the object with the lamps in it."""
        out, rays = panorama.copy(), panorama_directions(len(panorama)).astype(np.float32)
        solid_angle = np.broadcast_to(panorama_solid_angles(len(panorama)), out.shape[:2])
        for direction, energy in zip(self.directions, self.energy, strict=True):
            inside = rays @ direction > _LAMP_COSINE
            out[inside] += np.float32(energy / solid_angle[inside].sum())
        return out


def unseen_lamps(
    surface: Plane,
    centre: Float[np.ndarray, "3"],
    room: RoomGeometry,
    meshes: Sequence[FrameMesh],
    panorama: Float32[np.ndarray, "h w 3"],
    observed: Float[np.ndarray, "h w"],
) -> UnseenLamps | None:
    """Find lamps by what they leave in shade; None where the surface shows none.

    Args:
        surface: That the object stands on.
        centre: Of the object.
        room: What casts the shadows.
        meshes: Frames that show the surface.
        panorama: The light that is known at the object.
        observed: Share of each of its directions that frames have shown.
    """
    if surface.normal[1] < LEVEL:
        return None
    cells = _cells(meshes, surface, centre)
    if len(cells.luminance) < _FEWEST_CELLS:
        return None
    reach, even = _reach(cells.points, centre.astype(np.float32), room)
    luminance = panorama @ LUMINANCE
    shown, hidden, whole = (_by_place(light) for light in (observed * luminance, 1 - observed, np.ones_like(observed)))
    clipped = _by_place(observed * (luminance >= 1))  # a lower bound: a lamp may be brighter
    places = (hidden > 0.5 * whole) | (clipped > 0.1 * whole)
    mean = float(cells.luminance.mean())
    parts = np.stack([even @ shown, even @ hidden], axis=1)
    least, values = _LEAST_ALBEDO / np.pi / mean, cells.luminance / mean
    left, left_plain = 0.0, 0.0
    for fold in (False, True):
        fitted, tested = cells.fold != fold, cells.fold == fold
        if min(fitted.sum(), tested.sum()) < _FEWEST_CELLS // 4:
            return None
        for lamps in (reach[:, places], reach[:, :0]):
            strengths = _strengths(parts[fitted], lamps[fitted], values[fitted], least)
            error = np.concatenate([parts[tested], lamps[tested]], axis=1) @ strengths - values[tested]
            total = float(np.minimum(error**2, 0.25).sum())
            left, left_plain = (left + total, left_plain) if lamps.size else (left, left_plain + total)
    if left_plain < _LEAST_SHADE**2 * len(values) or left > (1 - _LEAST_EXPLAINED) * left_plain:
        return None
    strengths = _strengths(parts, reach[:, places], values, least)
    energy = strengths[2:] / strengths[0]  # in the unit of the known light
    rest, own = float((parts @ strengths[:2]).mean() / strengths[0]), float((even @ _by_place(luminance)).mean())
    energy *= min(1.0, own / max(rest, 1e-9))  # shadows no deeper than those of the room
    return UnseenLamps(_places()[places][energy > 0], energy[energy > 0])


class ShadowLights:
    """The light that casts shadows at places: what frames have shown, and the lamps that they have not.

    Lamps are kept for a place and looked for again when the room's geometry has grown by half.
    """

    def __init__(self) -> None:
        self._lamps: list[tuple[Position, int, UnseenLamps | None]] = []
        self._made: dict[Position, tuple[LightSampler, LightSampler]] = {}

    def light(
        self,
        known: LightSampler,
        observed: Callable[[], Float[np.ndarray, "h w"]],
        surface: Plane,
        room: RoomGeometry,
        session: Session,
    ) -> LightSampler:
        """Return the known light of an object's place with the lamps that the surface below it shows.

        Args:
            known: at the object's position.
            observed: returns the share of each of its directions that frames have shown.
        """
        at = np.array(known.position)
        near = [item for item in self._lamps if np.linalg.norm(at - item[0]) < _SAME_PLACE_M]
        if near and room.version < 1.5 * near[0][1]:
            lamps = near[0][2]
        else:
            meshes = [mesh for _, mesh in session.meshes]
            lamps = unseen_lamps(surface, at, room, meshes, known.panorama, observed())
            self._lamps = [item for item in self._lamps if all(item is not old for old in near)][-_MOST_PLACES:]
            self._lamps.append((known.position, room.version, lamps))
            self._made.clear()
        if lamps is None:
            return known
        before = self._made.get(known.position)
        if before is None or before[0] is not known:
            if len(self._made) >= _MOST_PLACES:
                self._made.clear()
            before = self._made[known.position] = known, LightSampler(lamps.added_to(known.panorama), known.position)
        return before[1]


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of a surface that have its most common colour; `fold` is the half that each belongs to."""

    points: Float32[np.ndarray, "n 3"]
    luminance: Float[np.ndarray, " n"]
    fold: Bool[np.ndarray, " n"]


def _cells(meshes: Sequence[FrameMesh], surface: Plane, centre: Float[np.ndarray, "3"]) -> _Cells:
    side = int(2 * RADIUS_M / _CELL_M)
    corner, total = centre[[0, 2]] - RADIUS_M, np.zeros((side * side, 4))
    for mesh in meshes:
        cell, radiance = _on_surface(mesh, surface, corner, side)
        for channel in range(3):
            total[:, channel] += np.bincount(cell, radiance[:, channel], side * side)
        total[:, 3] += np.bincount(cell, minlength=side * side)
    number = np.flatnonzero(total[:, 3])
    colour = total[number, :3] / total[number, 3:]
    chroma = colour / np.maximum(colour.sum(axis=1, keepdims=True), 1e-6)
    common = np.abs(chroma - np.median(chroma, axis=0)).sum(axis=1) < _SAME_COLOUR if len(number) else number > 0
    number, colour = number[common], colour[common]
    if len(number) > _MOST_CELLS:
        chosen = np.random.default_rng(0).choice(len(number), _MOST_CELLS, replace=False)
        number, colour = number[chosen], colour[chosen]
    at = np.stack(np.divmod(number, side), axis=1)
    x, z = ((at + 0.5) * _CELL_M + corner).T
    nx, ny, nz = surface.normal
    y = surface.point[1] - (nx * (x - surface.point[0]) + nz * (z - surface.point[2])) / ny
    fold = (at // _BLOCK).sum(axis=1) % 2 == 1
    return _Cells(np.stack([x, y, z], axis=1).astype(np.float32), colour @ LUMINANCE, fold)


def _on_surface(
    mesh: FrameMesh, surface: Plane, corner: Float[np.ndarray, "2"], side: int
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Return the cells and the radiance of a frame's samples on the surface, without clipped ones and depth edges."""
    depth, size = mesh.grid_depth_m, mesh.grid_depth_m.shape[::-1]
    box = np.ones((3, 3), np.uint8)
    usable = mesh.measured & (cv2.dilate(depth, box) - cv2.erode(depth, box) < 0.08 * depth)
    texture = mesh.texture
    if texture.clipped is not None:
        near = cv2.dilate(texture.clipped.astype(np.float32), box)
        usable &= cv2.resize(near, size, interpolation=cv2.INTER_AREA) == 0
    points = mesh.vertices.reshape(*depth.shape, 3)
    usable &= np.abs(surface.height_of(points)) < 0.03 + 0.008 * depth
    at = np.floor((points[usable][:, [0, 2]] - corner) / _CELL_M).astype(np.int64)
    inside = ((at >= 0) & (at < side)).all(axis=1)
    image = cv2.resize(texture.image, size, interpolation=cv2.INTER_AREA)
    return at[inside] @ np.array([side, 1]), image[usable][inside]


def _reach(
    points: Float32[np.ndarray, "n 3"], centre: Float32[np.ndarray, "3"], room: RoomGeometry
) -> tuple[Float32[np.ndarray, "n k"], Float32[np.ndarray, "n k"]]:
    """Return the irradiance at points by a lamp at each place, of 1 at the object; 0 where the room hides it.

    The second is that of light from far away, which is even where nothing hides it.
    """
    lamps = np.empty((len(points), len(_places())), np.float32)
    even = np.empty_like(lamps)
    lifted = points + np.array([0, _LIFT_M, 0], np.float32)
    for number, place in enumerate(_places()):
        toward = centre + np.float32(_LAMP_M) * place - points
        distance_m = np.linalg.norm(toward, axis=1)
        toward /= distance_m[:, None]
        hidden = room.cast(lifted, toward).distance_m < distance_m - 0.05
        lamps[:, number] = np.where(hidden, 0, np.maximum(toward[:, 1], 0) * (_LAMP_M / distance_m) ** 2)
        even[:, number] = np.where(hidden, 0, place[1])
    return lamps, even


def _strengths(
    parts: Float[np.ndarray, "n 2"], lamps: Float[np.ndarray, "n k"], values: Float[np.ndarray, " n"], least: float
) -> Float[np.ndarray, " k2"]:
    """Return non-negative factors of both parts and the lamps; the first at least `least`. Outliers count less."""
    scale = np.concatenate([[1, 1], 1 / np.maximum(lamps.mean(axis=0), 0.05)])
    matrix = np.concatenate([parts, lamps], axis=1) * scale
    damping = _DAMPING * np.sqrt(len(values)) * np.eye(len(scale))[2:]
    wanted, none = values - least * parts[:, 0], np.zeros(len(scale) - 2)
    weight, factors = np.ones(len(values)), np.zeros(len(scale))
    for _ in range(3):
        rows = np.concatenate([matrix * weight[:, None], damping])
        factors = non_negative_factors(rows, np.concatenate([wanted * weight, none]))
        error = np.abs(matrix @ factors - wanted)
        weight = 1 / np.sqrt(np.maximum(error / (2 * np.median(error) + 1e-6), 1))
    factors = factors * scale
    factors[0] += least
    return factors


def non_negative_factors(matrix: Float[np.ndarray, "n k"], wanted: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
    """Return the non-negative least squares of `matrix @ factors - wanted` (Bro and de Jong 1997, on normal equations).

    SciPy's would add 100 MB to the installation.
    """
    gram, moment = matrix.T @ matrix, matrix.T @ wanted
    gram[np.diag_indices(len(gram))] += 1e-12 * np.trace(gram)
    factors, free = np.zeros(len(gram)), np.zeros(len(gram), bool)
    for _ in range(3 * len(gram)):
        slope = np.where(free, -np.inf, moment - gram @ factors)
        if slope.max() <= 1e-9 * np.abs(moment).max():
            break
        free[slope.argmax()] = True
        while free.any():
            solved = np.zeros(len(gram))
            solved[free] = np.linalg.solve(gram[np.ix_(free, free)], moment[free])
            below = free & (solved <= 0)
            if not below.any():
                factors = solved
                break
            steps = np.full(len(gram), np.inf)
            steps[below] = factors[below] / (factors[below] - solved[below])
            factors += steps.min() * (solved - factors)
            free[steps.argmin()] = False
            factors[~free] = 0
    return factors


@lru_cache(maxsize=1)
def _places() -> Float32[np.ndarray, "k 3"]:
    """Return the directions in which lamps are looked for."""
    rings: list[Float[np.ndarray, "n 3"]] = []
    for elevation, count in _RINGS:
        azimuth = 2 * np.pi * (np.arange(count) + 0.5 * (elevation // 12 % 2)) / count
        up = np.full(count, np.sin(np.radians(elevation)))
        level = np.cos(np.radians(elevation))
        rings.append(np.stack([level * np.sin(azimuth), up, level * np.cos(azimuth)], axis=1))
    return np.concatenate(rings).astype(np.float32)


def _by_place(light: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " k"]:
    """Return the integral of a panorama over the directions nearest to each place, from 5 degrees above the horizon."""
    directions = panorama_directions(len(light)).astype(np.float32)
    above = directions[..., 1] > np.sin(np.radians(5.0))
    nearest = (directions[above] @ _places().T).argmax(axis=1)
    weight = (light * panorama_solid_angles(len(light)))[above]
    return np.bincount(nearest, weight, len(_places()))
