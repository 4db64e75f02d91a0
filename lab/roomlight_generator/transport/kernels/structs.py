"""Arguments of the kernels, grouped by meaning: named tuples of arrays, which Numba takes apart at no cost.

Frames: world, y up, metres; radiance in kcd/m2. Scene, lights, points and shadow rays have their structures beside the
code that makes them: `SceneArrays` (tracer), `LightSources` (emitters), `Points`, `ShadowRays`, `Received` (direct).
Axes: n points or rays, p patches, k points of a patch, r records, h x w pixels.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast, get_type_hints

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8

_Columns = TypeVar("_Columns", bound=tuple[Any, ...])


def allocated(kind: type[_Columns], count: int) -> _Columns:
    """Allocate `count` rows of a structure, as its fields are annotated, for a kernel to fill."""
    columns = get_type_hints(kind).values()
    return cast(Callable[..., _Columns], kind)(
        *(np.empty((count, *map(int, column.dim_str.split()[1:])), column.dtypes[0]) for column in columns)
    )


class HashTable(NamedTuple):
    """An open-addressed table of a power of two places; key -1 marks an empty place."""

    keys: Int64[np.ndarray, " t"]
    values: Int32[np.ndarray, " t"]


class RayEnds(NamedTuple):
    """Hits of rays: face (-1: no hit), barycentric u and v, and the unit direction in which the ray arrived."""

    face: Int32[np.ndarray, " n"]
    u: Float32[np.ndarray, " n"]
    v: Float32[np.ndarray, " n"]
    direction: Float32[np.ndarray, "n 3"]


class SurfacePoints(NamedTuple):
    """Surface points off the surface on the side that the ray came from: both unit normals, reflectance, emission."""

    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    geometric_normal: Float32[np.ndarray, "n 3"]
    albedo: Float32[np.ndarray, "n 3"]
    emission: Float32[np.ndarray, "n 3"]


class LightSurfaces(NamedTuple):
    """Inputs for a sample on a light: arrays of `Lights` and `Outdoors`.

    They are separate because each further array costs time at every call of `point_on`.
    """

    piece: Float32[np.ndarray, "p 21"]
    kind: Int32[np.ndarray, " p"]
    hole: Float32[np.ndarray, "o 15"]
    parts: Int32[np.ndarray, "o 3"]
    panorama: Float32[np.ndarray, "h w 3"]
    coat_share: Float32[np.ndarray, "a c"]
    sun: Float32[np.ndarray, "3"]


class ShadowSampling(NamedTuple):
    """Shadow rays of a point: candidates on the lights, how many of them are traced, and rays to the sun's disc."""

    candidates: int
    picks: int
    sun_picks: int
    seed: int


class LightScratch(NamedTuple):
    """Work space of the kernels that sample lights: clusters' estimates and their running sum, candidates drawn.

    Allocated by the caller: a kernel that allocates counts references to its arrays at each call of another.
    """

    estimated: Float32[np.ndarray, " l"]
    running: Float64[np.ndarray, " l"]
    drawn: Float64[np.ndarray, "c 9"]
    cluster: Int32[np.ndarray, " c"]

    @classmethod
    def empty(cls, clusters: int, candidates: int) -> "LightScratch":
        """Allocate space for this many clusters, and candidates of a point."""
        return cls(
            np.empty(max(clusters, 1), np.float32),
            np.empty(max(clusters, 1)),
            np.empty((candidates, 9)),
            np.empty(candidates, np.int32),
        )


class ConeScratch(NamedTuple):
    """Work space of `gather_rays`: clusters' estimates; cones' directions, cosines and densities; their shares."""

    estimated: Float32[np.ndarray, " l"]
    cones: Float32[np.ndarray, "5 l"]
    chance: Float64[np.ndarray, " l"]

    @classmethod
    def empty(cls, clusters: int) -> "ConeScratch":
        """Allocate space for this many clusters."""
        count = max(clusters, 1)
        return cls(np.empty(count, np.float32), np.empty((5, count), np.float32), np.empty(count))


class GatherSampling(NamedTuple):
    """Gather rays of a point: by cosine, and into cones about the lights."""

    cosine_rays: int
    cone_rays: int
    seed: int


class GatherRays(NamedTuple):
    """Gather rays, with the same number in a row for each point.

    Attributes:
        weight: Turns radiance into irradiance when summed over a point's rays.
        passed: Share that the point's coat lets through.
    """

    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    weight: Float32[np.ndarray, " n"]
    passed: Float32[np.ndarray, " n"]


class LobeSampling(NamedTuple):
    """Samples of a lobe for each point: reflected rays, candidates on the lights, and how many of those are traced."""

    rays: int
    candidates: int
    picks: int
    seed: int


class LobeRays(NamedTuple):
    """Reflected rays: direction, lobe over density, density in solid angle."""

    direction: Float32[np.ndarray, "n 3"]
    weight: Float32[np.ndarray, " n"]
    density: Float32[np.ndarray, " n"]


class PaneRays(NamedTuple):
    """Rays that met a thin pane: where the reflected ray starts and goes, where the straight ray goes on, and the
    reflected share."""

    reflected: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    through: Float32[np.ndarray, "n 3"]
    share: Float32[np.ndarray, " n"]


class CachePoints(NamedTuple):
    """Surface points whose irradiance is cached; foot is the width of a pixel there."""

    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    alpha: Float32[np.ndarray, " n"]
    foot: Float32[np.ndarray, " n"]


class RecordColumns(NamedTuple):
    """Records of indirect light.

    Attributes:
        coat: Bucket of the coat's roughness.
        clear: Reach by clearance: a share of the harmonic mean distance to the surfaces that the record sees.
    """

    position: Float32[np.ndarray, "r 3"]
    normal: Float32[np.ndarray, "r 3"]
    coat: Int32[np.ndarray, " r"]
    clear: Float32[np.ndarray, " r"]
    reach: Float32[np.ndarray, " r"]
    irradiance: Float32[np.ndarray, "r 3"]


class RecordLists(NamedTuple):
    """Lists of the records that reach into a grid cell: a table of list heads, the entries, and the levels in use."""

    keys: Int64[np.ndarray, " t"]
    heads: Int32[np.ndarray, " t"]
    entry_record: Int32[np.ndarray, " e"]
    entry_next: Int32[np.ndarray, " e"]
    levels: Int32[np.ndarray, "64"]


class CacheHits(NamedTuple):
    """Hits of gather rays on cached surfaces: row of the room's cache (-1: none), cosine of the leaving ray, the coat's
    roughness, the ray's length, whether it met a mirror, and the share that mirrors left."""

    row: Int32[np.ndarray, " n"]
    cosine: Float32[np.ndarray, " n"]
    alpha: Float32[np.ndarray, " n"]
    distance: Float32[np.ndarray, " n"]
    mirrored: Bool[np.ndarray, " n"]
    factor: Float32[np.ndarray, " n"]


class CachedRadiance(NamedTuple):
    """Rows of the room's cache: radiance of base and lobe, and the part of both that is the sun's direct light."""

    base: Float32[np.ndarray, "rows 3"]
    lobe: Float32[np.ndarray, "rows 3"]
    sun_base: Float32[np.ndarray, "rows 3"]
    sun_lobe: Float32[np.ndarray, "rows 3"]


class Fineness(NamedTuple):
    """Number of halvings of patches: level[i, j, k] in cells of cell_m from the corner `low` on, 0 outside.

    A lampshade is bright inside and dark outside, a window frame in the sun likewise, and both have faces of one
    direction and material a few centimetres apart: patches of the usual size would leak.
    """

    level: UInt8[np.ndarray, "x y z"]
    low: Float32[np.ndarray, "3"]
    cell_m: float


class PatchColumns(NamedTuple):
    """Patches during their search: up to k points of each patch, how many are used, and the number of hits."""

    position: Float32[np.ndarray, "p k 3"]
    normal: Float32[np.ndarray, "p k 3"]
    geometric_normal: Float32[np.ndarray, "p k 3"]
    albedo: Float32[np.ndarray, "p k 3"]
    used: Int32[np.ndarray, " p"]
    visits: Int32[np.ndarray, " p"]
    material: Int32[np.ndarray, " p"]


class PatchPoints(NamedTuple):
    """Patches that cast gather rays; stream is the number that seeds a patch's random numbers."""

    position: Float32[np.ndarray, "p k 3"]
    normal: Float32[np.ndarray, "p k 3"]
    geometric_normal: Float32[np.ndarray, "p k 3"]
    used: Int32[np.ndarray, " p"]
    alpha: Float32[np.ndarray, " p"]
    stream: Int64[np.ndarray, " p"]


class PatchRays(NamedTuple):
    """Cosine-weighted rays of patches, and the share of each ray that a coat would let through."""

    origin: Float32[np.ndarray, "n 3"]
    direction: Float32[np.ndarray, "n 3"]
    passed: Float32[np.ndarray, " n"]


class PatchLinks(NamedTuple):
    """Rays between patches: the patch that each met (-1: none), the shares of its base and lobe that the ray sees, what
    the receiving coat lets through, length, whether it met a mirror, and the share that mirrors left."""

    target: Int32[np.ndarray, " n"]
    base: Float32[np.ndarray, " n"]
    lobe: Float32[np.ndarray, " n"]
    passed: Float32[np.ndarray, " n"]
    distance: Float32[np.ndarray, " n"]
    mirrored: Bool[np.ndarray, " n"]
    factor: Float32[np.ndarray, " n"]


class SentLight(NamedTuple):
    """Radiance that patches send out: of the base before its coat lets it out, and the lobe's mean."""

    base: Float32[np.ndarray, "p 3"]
    lobe: Float32[np.ndarray, "p 3"]


class ReceivedLight(NamedTuple):
    """Irradiance of patches, plain and as let through by their coats."""

    irradiance: Float32[np.ndarray, "p 3"]
    coated: Float32[np.ndarray, "p 3"]


class PatchTable(NamedTuple):
    """Finds a place's row in the room's cache: its patch, else its wider surroundings (rows from first_coarse), else
    its material (rows from first_material)."""

    fineness: Fineness
    keys: Int64[np.ndarray, " t"]
    values: Int32[np.ndarray, " t"]
    coarse_keys: Int64[np.ndarray, " s"]
    coarse_values: Int32[np.ndarray, " s"]
    first_coarse: int
    first_material: int


class PixelSurfaces(NamedTuple):
    """The surface that each pixel shows: kind (-1: none; equal for one surface), place, normal, a pixel's width."""

    kind: Int32[np.ndarray, "h w"]
    position: Float32[np.ndarray, "h w 3"]
    normal: Float32[np.ndarray, "h w 3"]
    foot: Float32[np.ndarray, "h w"]


class ExtraRays(NamedTuple):
    """Surfaces that extra rays met, and the pixels to which the rays belong."""

    row: Int64[np.ndarray, " n"]
    column: Int64[np.ndarray, " n"]
    kind: Int32[np.ndarray, " n"]
    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]


class Borrowed(NamedTuple):
    """Light of extra rays' surfaces taken from neighbouring pixels, and whether there was such a pixel."""

    received: Float32[np.ndarray, "n 3"]
    lobe: Float32[np.ndarray, "n 3"]
    was_borrowed: Bool[np.ndarray, " n"]
