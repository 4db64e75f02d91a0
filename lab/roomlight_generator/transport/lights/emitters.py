"""The lights of a room, in clusters small enough to be sampled from nearby: emitting triangles, openings to the sky.

Frames: world, y up, metres; radiance in kcd/m2. Emitting triangles are cut until no side is longer than `PIECE_M` and
gathered into clusters of that size; openings are cut likewise. A sample picks a cluster by its estimated contribution,
then a point in it in proportion to luminance times area. Spots where the sun strikes a surface count as lights too
(`transport.sun_spots`): they are the brightest surfaces that a gather ray may meet.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight_generator.rooms.scene import Opening
from roomlight_generator.transport.kernels.structs import LightSurfaces
from roomlight_generator.transport.lights.coat import coat_table
from roomlight_generator.transport.lights.outdoors import Outdoors, build_outdoors
from roomlight_generator.transport.lights.sun_spots import NEAR_SPOT_M2, Spots, sun_spots
from roomlight_generator.transport.tracer import Tracer

PIECE_M: Final = 0.3
"""Longest side of a piece. Half of it doubles the clusters; twice of it leaves spots on ceilings beside panels."""

MOST_CLUSTERS: Final = 128
"""With more, clusters are made larger: each shading point evaluates every cluster."""

MOST_SPOT_CLUSTERS: Final = 40

MOST_CUTS: Final = 24
"""Most parts that a triangle's side is cut into."""

TRIANGLE: Final = 0
OPENING: Final = 1
SPOT: Final = 2


class Lights(NamedTuple):
    """Pieces in the order of their clusters, then the clusters; clusters of sun spots come last, from `real` on.

    The piece at (u, v) of a face cut in n is piece_at[face_first + 2 (i n + j) + upper].

    Attributes:
        piece: Columns 0 to 8: a triangle's corners, an opening's corner and two sides, or a spot's position and its
            geometric and shading normals. 9 to 12: a spot's roughness (0: no coat) and the sun's irradiance that its
            lobe reflects. 15 to 17: radiance (of a spot, its base's mean). 18: the area for `left_to_gathering`. 19:
            the share of the cluster's samples for each square metre. 20: the cumulative share.
        kind: TRIANGLE, OPENING or SPOT.
        power_up, power_down: Area times luminance; of openings, toward the sky's upper and lower half.
        coherence: 1 where all pieces face along `axis`, 0 where they enclose a volume.
        thickness: Half of the cluster's extent along the axis.
        lobe_power, lobe_alpha: Area times the sun's irradiance on coats, and their roughness.
        sun: Direction toward the sun.
        coat_share: What a coat lets out at a cosine over its mean; rows and columns of the coat's table.
        near_area: Column 18 of a face's pieces, 0 where the face does not emit.
        real: Number of clusters that are not spots.
    """

    piece: Float32[np.ndarray, "p 21"]
    kind: Int32[np.ndarray, " p"]
    face: Int32[np.ndarray, " p"]
    cluster: Int32[np.ndarray, " p"]
    start: Int32[np.ndarray, " l"]
    pieces: Int32[np.ndarray, " l"]
    centre: Float32[np.ndarray, "3 l"]
    radius: Float32[np.ndarray, " l"]
    power_up: Float32[np.ndarray, " l"]
    power_down: Float32[np.ndarray, " l"]
    axis: Float32[np.ndarray, "3 l"]
    coherence: Float32[np.ndarray, " l"]
    thickness: Float32[np.ndarray, " l"]
    lobe_power: Float32[np.ndarray, " l"]
    lobe_alpha: Float32[np.ndarray, " l"]
    sun: Float32[np.ndarray, "3"]
    coat_share: Float32[np.ndarray, "a c"]
    near_area: Float32[np.ndarray, " f"]
    face_cuts: Int32[np.ndarray, " f"]
    face_first: Int32[np.ndarray, " f"]
    piece_at: Int32[np.ndarray, " s"]
    real: int


class LightSources(NamedTuple):
    """The lights of a scene as the kernels read them."""

    lights: Lights
    outdoors: Outdoors
    surfaces: LightSurfaces


class _Pieces(NamedTuple):
    """Pieces to be gathered into clusters.

    Attributes:
        halves: Factors on the power toward the sky's halves.
        slot: Index in `piece_at`.
    """

    shape: Float[np.ndarray, "p 9"]
    coat: Float[np.ndarray, "p 6"]
    glow: Float[np.ndarray, "p 3"]
    middle: Float[np.ndarray, "p 3"]
    reach: Float[np.ndarray, " p"]
    normal: Float[np.ndarray, "p 3"]
    area: Float[np.ndarray, " p"]
    luminance: Float[np.ndarray, " p"]
    halves: Float[np.ndarray, "p 2"]
    kind: Int[np.ndarray, " p"]
    face: Int[np.ndarray, " p"]
    slot: Int[np.ndarray, " p"]


def build_lights(tracer: Tracer) -> LightSources:
    """Collect the lights of the tracer's scene."""
    scene = tracer.scene
    glowing, face_cuts, face_first, slots = _glowing_pieces(tracer)
    openings, cuts = _opening_pieces(scene.openings, scene.sky.panorama, slots)
    outdoors = build_outdoors(tracer, cuts)
    spots = sun_spots(tracer, outdoors)
    pieces = _Pieces(*(np.concatenate(parts) for parts in zip(glowing, openings, _spot_pieces(spots), strict=True)))
    slots += int((cuts[:, 1] * cuts[:, 2]).sum())
    lights = _clustered(pieces, face_cuts, face_first, slots, outdoors.sun_direction)
    surfaces = LightSurfaces(
        lights.piece, lights.kind, outdoors.hole, outdoors.parts, outdoors.panorama, lights.coat_share, lights.sun
    )
    return LightSources(lights, outdoors, surfaces)


def _glowing_pieces(tracer: Tracer) -> tuple[_Pieces, Int32[np.ndarray, " f"], Int32[np.ndarray, " f"], int]:
    """Cut the emitting faces into pieces; also returns each face's cuts and first slot, and the number of slots."""
    geometry, materials = tracer.geometry, tracer.materials
    faces = np.flatnonzero(materials.emission[geometry.material].max(1) > 0)
    faces = faces[faces < tracer.opaque_faces]
    corners = geometry.corners[faces].astype(np.float64)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    cuts = np.clip(np.ceil(sides / PIECE_M), 1, MOST_CUTS).astype(np.int32)
    face_cuts, face_first = (np.zeros(len(geometry.material), np.int32) for _ in range(2))
    face_cuts[faces] = cuts
    face_first[faces] = np.cumsum(2 * cuts**2) - 2 * cuts**2
    parts: list[tuple[np.ndarray, ...]] = [(np.zeros((0, 3, 2)), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for cut in np.unique(cuts):
        some = faces[cuts == cut]
        grid, slot = _subdivision(int(cut))
        slots = (face_first[some][:, None] + slot[None]).ravel()
        parts.append((np.tile(grid, (len(some), 1, 1)), np.repeat(some, len(grid)), slots))
    grid, face, slot = (np.concatenate(column) for column in zip(*parts, strict=True))
    weights = np.concatenate([1 - grid.sum(2, keepdims=True), grid], 2)
    corner = np.einsum("pcw,pwd->pcd", weights, geometry.corners[face].astype(np.float64))
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(across, axis=1)
    material = geometry.material[face]
    middle = corner.mean(1)
    pieces = _Pieces(
        shape=corner.reshape(-1, 9),
        coat=np.zeros((len(face), 6)),
        glow=materials.emission[material].astype(np.float64),
        middle=middle,
        reach=np.linalg.norm(corner - middle[:, None], axis=2).max(1, initial=0),
        normal=across / np.maximum(length, 1e-30)[:, None],
        area=length / 2,
        luminance=materials.emission[material].mean(1).astype(np.float64),
        halves=np.ones((len(face), 2)),
        kind=np.full(len(face), TRIANGLE),
        face=face,
        slot=slot,
    )
    return pieces, face_cuts, face_first, int((2 * cuts.astype(np.int64) ** 2).sum())


def _subdivision(cuts: int) -> tuple[Float[np.ndarray, "p 3 2"], Int[np.ndarray, " p"]]:
    """Return barycentric (u, v) of the corners of cuts^2 equal parts, and each part's slot: 2 (i cuts + j) + upper."""
    grid: list[list[tuple[float, float]]] = []
    slot: list[int] = []
    for i in range(cuts):
        for j in range(cuts - i):
            grid.append([(i, j), (i + 1, j), (i, j + 1)])
            slot.append(2 * (i * cuts + j))
            if i + j < cuts - 1:
                grid.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
                slot.append(2 * (i * cuts + j) + 1)
    return np.array(grid, np.float64) / cuts, np.array(slot, np.int64)


def _opening_pieces(
    openings: tuple[Opening, ...], panorama: Float[np.ndarray, "h w 3"], first_slot: int
) -> tuple[_Pieces, Int32[np.ndarray, "o 3"]]:
    halves = _sky_halves(panorama)
    parts: list[tuple[int, int, int]] = []
    rows: list[np.ndarray] = []
    for opening in openings:
        u, v = np.asarray(opening.edge_u, np.float64), np.asarray(opening.edge_v, np.float64)
        nu, nv = (max(1, int(np.ceil(np.linalg.norm(side) / PIECE_M))) for side in (u, v))
        parts.append((first_slot + len(rows), nu, nv))
        rows += [
            np.concatenate([opening.corner + u * i / nu + v * j / nv, u / nu, v / nv])
            for i in range(nu)
            for j in range(nv)
        ]
    count = len(rows)
    shape = np.array(rows, np.float64).reshape(-1, 9)
    u, v = shape[:, 3:6], shape[:, 6:9]
    across = np.cross(u, v)
    area = np.linalg.norm(across, axis=1)
    mean = max(float(halves.mean()), 1e-9)
    pieces = _Pieces(
        shape=shape,
        coat=np.zeros((count, 6)),
        glow=np.zeros((count, 3)),
        middle=shape[:, :3] + (u + v) / 2,
        reach=np.maximum(np.linalg.norm(u + v, axis=1), np.linalg.norm(u - v, axis=1)) / 2,
        normal=across / np.maximum(area, 1e-30)[:, None],
        area=area,
        luminance=np.full(count, mean),
        halves=np.tile(halves / mean, (count, 1)),
        kind=np.full(count, OPENING),
        face=np.full(count, -1),
        slot=np.arange(first_slot, first_slot + count),
    )
    return pieces, np.array(parts, np.int32).reshape(-1, 3)


def _sky_halves(panorama: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "2"]:
    """Return the mean luminance of the sky's upper and lower half."""
    height = len(panorama)
    rows = panorama.mean((1, 2)).astype(np.float64)
    angle = panorama_solid_angles(height)[:, 0].astype(np.float64)
    up = panorama_directions(height)[:, 0, 1] > 0
    return np.array([np.average(rows[half], weights=angle[half]) for half in (up, ~up)])


def _spot_pieces(spots: Spots) -> _Pieces:
    count = len(spots.area)
    return _Pieces(
        shape=np.concatenate([spots.position, spots.normal, spots.facing], 1).astype(np.float64),
        coat=np.concatenate([spots.alpha[:, None], spots.lobe, np.zeros((count, 2))], 1).astype(np.float64),
        glow=spots.radiance.astype(np.float64),
        middle=spots.position.astype(np.float64),
        reach=np.sqrt(spots.area).astype(np.float64),
        normal=spots.normal.astype(np.float64),
        area=spots.area.astype(np.float64),
        luminance=np.maximum((spots.radiance + spots.lobe_mean).mean(1), 1e-12).astype(np.float64),
        halves=np.ones((count, 2)),
        kind=np.full(count, SPOT),
        face=np.full(count, -1),
        slot=np.full(count, -1),
    )


def _grouped(pieces: _Pieces) -> Int[np.ndarray, " p"]:
    """Assign each piece a cluster; those of spots come last."""
    count = len(pieces.area)
    kind = pieces.kind
    own = np.zeros(count, np.int64)
    clusters = 0
    for spots in (False, True):
        some = np.flatnonzero((kind == SPOT) == spots)
        size = PIECE_M
        while len(some):
            # An opening's piece is a cluster of its own, until there are too many of them.
            alone = np.where((kind[some] == OPENING) & (size == PIECE_M), some, -1)
            side = np.argmax(np.abs(pieces.normal[some]), 1) * 2 + (pieces.coat[some, 0] > 0) if spots else kind[some]
            cell = np.floor(pieces.middle[some] / size + 0.37).astype(np.int64)
            keys = np.concatenate([cell, side[:, None], alone[:, None]], 1)
            place = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
            if place.max() < (MOST_SPOT_CLUSTERS if spots else MOST_CLUSTERS):
                own[some] = place + clusters
                clusters += int(place.max()) + 1
                break
            size *= 1.3
    return own


def _clustered(
    pieces: _Pieces,
    face_cuts: Int32[np.ndarray, " f"],
    face_first: Int32[np.ndarray, " f"],
    slots: int,
    sun: Float32[np.ndarray, "3"],
) -> Lights:
    own = _grouped(pieces)
    count = len(own)
    clusters = int(own.max()) + 1 if count else 0
    kind = pieces.kind

    def per(values: Float[np.ndarray, " p"]) -> Float[np.ndarray, " l"]:
        return np.bincount(own, values, clusters).astype(np.float64)  # without a source NumPy counts in integers

    power = pieces.area * pieces.luminance
    total = np.maximum(per(power), 1e-30)
    heavy = power / total[own]
    centre = np.stack([per(heavy * pieces.middle[:, k]) for k in range(3)], 1)
    radius = np.zeros(clusters)
    np.maximum.at(radius, own, np.linalg.norm(pieces.middle - centre[own], axis=1) + pieces.reach)
    axis = np.stack([per(heavy * pieces.normal[:, k]) for k in range(3)], 1)
    coherence = np.linalg.norm(axis, axis=1)
    axis /= np.maximum(coherence, 1e-12)[:, None]
    thickness = np.zeros(clusters)
    off = np.abs(((pieces.middle - centre[own]) * axis[own]).sum(1))
    lean = np.sqrt(np.clip(1 - (pieces.normal * axis[own]).sum(1) ** 2, 0, 1))
    np.maximum.at(thickness, own, off + lean * pieces.reach)
    coated = np.where(kind == SPOT, pieces.coat[:, 0], 0)
    reflected = np.where(kind == SPOT, pieces.coat[:, 1:4].mean(1), 0) * pieces.area
    coat = coat_table()
    # Near a point, triangles of one cluster represent each other; pieces of openings represent only themselves.
    near = np.where(kind == TRIANGLE, np.minimum(per(pieces.area)[own], PIECE_M**2), pieces.area)
    near[kind == SPOT] = NEAR_SPOT_M2
    near_area = np.zeros(len(face_cuts), np.float32)
    shining = np.flatnonzero(kind == TRIANGLE)
    near_area[pieces.face[shining]] = near[shining]
    near[shining] = near_area[pieces.face[shining]]  # one for all pieces of a face
    order = np.argsort(own, kind="stable")
    starts = np.searchsorted(own[order], np.arange(clusters))
    running = np.cumsum(heavy[order])
    before = (running - heavy[order])[starts]
    fraction = running - before[own[order]]
    fraction[np.append(starts[1:], count)[: len(starts)] - 1] = 1.0
    table = np.concatenate(
        [
            pieces.shape,
            pieces.coat,
            pieces.glow,
            near[:, None],
            (pieces.luminance / total[own])[:, None],
            np.zeros((count, 1)),
        ],
        1,
    )[order]
    table[:, 20] = fraction
    piece_at = np.full(max(slots, 1), -1, np.int32)
    listed = np.flatnonzero(kind[order] != SPOT)
    piece_at[pieces.slot[order][listed]] = listed
    real = int(own[kind != SPOT].max(initial=-1)) + 1
    return Lights(
        piece=table.astype(np.float32),
        kind=pieces.kind[order].astype(np.int32),
        face=pieces.face[order].astype(np.int32),
        cluster=own[order].astype(np.int32),
        start=starts.astype(np.int32),
        pieces=np.bincount(own, minlength=clusters).astype(np.int32),
        centre=np.ascontiguousarray(centre.T, np.float32),
        radius=radius.astype(np.float32),
        power_up=per(power * pieces.halves[:, 0]).astype(np.float32),
        power_down=per(power * pieces.halves[:, 1]).astype(np.float32),
        axis=np.ascontiguousarray(axis.T, np.float32),
        coherence=coherence.astype(np.float32),
        thickness=thickness.astype(np.float32),
        lobe_power=per(reflected).astype(np.float32),
        lobe_alpha=(per(coated * reflected) / np.maximum(per(reflected), 1e-30)).astype(np.float32),
        sun=sun.astype(np.float32),
        coat_share=coat.through / coat.mean_through[:, None],
        near_area=near_area,
        face_cuts=face_cuts,
        face_first=face_first,
        piece_at=piece_at,
        real=real,
    )
