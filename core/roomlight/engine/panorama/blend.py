"""A probe's panorama between frames, and how a frame's details are blended into it (paper, section 4.2).

State: L (radiance), the accumulated depth panorama and the accumulated blending weight. Depth is distance along the
ray in metres. Where nothing was observed yet it is `UNSEEN_DEPTH` x D_max, farther than anything in the volume, so that
the first surface observed there is accepted.

Addition to the paper's conservative rule: a clipped observation is replaced by one of the same surface that knows more
(another exposure, see `roomlight.engine.surface.bracket`). The surface is the same within `CLOSER_M`. The share of
clipped radiance only falls and its lower bound only rises by this, so that no two frames replace each other in turn.

Second addition: light that changes. A surface that shows `CHANGED` times more or less light than before in
`CHANGED_FRAMES` consecutive frames is seen as if for the first time: a lamp was switched on or off, a curtain opened.
What frames do not show does not change. What looks different from elsewhere is no change: the view through a window, a
reflection. Therefore:

- A frame shows more only if its darkest pixel within `AROUND_DEG` does, and less only if its brightest one does.
- A change begins only where a camera at the same place (`SAME_VIEW`, seen from the surface) showed the surface as it
  was accumulated: the darkest and the brightest pixel around it agreed. Pixels beside such a pixel begin with it.

Third addition: things that leave, such as a person who passes. What `SEEN_THROUGH_FRAMES` consecutive frames see
through is forgotten (`roomlight.engine.probe`).
"""

from dataclasses import dataclass, fields, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from roomlight.conventions import LUMINANCE, panorama_rays, panorama_solid_angles
from roomlight.engine.kernels.blend import (
    BEGINS,
    CHANGED_FRAMES,
    DIFFERS,
    DetailArrays,
    StateArrays,
    accumulate_rows,
    compare_rows,
    find_extremes,
)
from roomlight.engine.kernels.fill import mix_beyond
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.fill import fill_unknown

FILL_COLOUR: Final = 0.75
"""Share of the fill's colour in the radiance inferred beyond the mesh. At 0, 0.75, 1 the angular error of a matte
sphere's colour is 6.14, 6.12, 6.28 degrees on 160 test rooms and 8.0, 6.8, 6.5 on three captures of other authors;
log-L2 does not change."""
DARK: Final = 1e-3
"""Relative to white. The colour of a fill darker than this is unreliable, and fades to grey."""
AROUND_DEG: Final = 3.0
"""Neighbourhood of a pixel in which a change must show: an edge that moves across it moves by twice as much between two
frames that agree with the old and with the new light, more than a camera at the same place makes it."""
AT_PROBE: Final = np.zeros(3, np.float32)
"""A camera at the probe."""
UNSEEN_DEPTH: Final = 4.0
"""In units of D_max; the volume's diagonal is 3.2 D_max."""


def unseen_depth_m(depth_max_m: float) -> float:
    """Return the accumulated depth of what was never seen."""
    return UNSEEN_DEPTH * depth_max_m


def farthest_depth_m(depth_max_m: float) -> float:
    """Return the depth to which farther surfaces are clamped: a little nearer than "unseen", so that they are accepted.

    Without it a session that begins with a close-up (small D_max) would never show the rest of its room.
    """
    unseen_m = unseen_depth_m(depth_max_m)
    return min(0.8 * unseen_m, unseen_m - 2 * CLOSER_M)


@dataclass(frozen=True)
class PartialPanorama:
    """What a probe sees of one frame's mesh.

    Attributes:
        radiance: [H, 2H, 3] linear RGB, 0 where the mask is False.
        mask: [H, 2H] directions in which the mesh is seen.
        depth_m: [H, 2H] distance along the ray in metres, 0 where the mask is False.
        clipped: [H, 2H] share of the surface whose pixels were clipped, 0 to 1; None: nothing was clipped.
        guessed: [H, 2H] luminance of the radiance that was estimated for these pixels; None: nothing was clipped.
        measured: [H, 2H] where depth was measured; elsewhere it was completed. None: all of it was measured.
    """

    radiance: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "h w"]
    clipped: Float[np.ndarray, "h w"] | None = None
    guessed: Float[np.ndarray, "h w"] | None = None
    measured: Bool[np.ndarray, "h w"] | None = None

    def within(self, farthest_m: float) -> "PartialPanorama":
        """Clamp the depth to `farthest_m`."""
        return replace(self, depth_m=np.minimum(self.depth_m, np.float32(farthest_m)))

    def not_before(self, state: "PanoramaState") -> "PartialPanorama":
        """Leave out surfaces of completed depth that would lie before one whose depth was measured."""
        if self.measured is None:
            return self
        before = self.mask & ~self.measured & (state.measured > 0.5) & state.is_closer(self.depth_m)
        if not before.any():
            return self
        radiance, depth_m = np.where(before[..., None], 0, self.radiance), np.where(before, 0, self.depth_m)
        return replace(self, radiance=radiance, mask=self.mask & ~before, depth_m=depth_m)


@dataclass(frozen=True)
class PanoramaState:
    """One probe's accumulated panorama, updated in place; float32.

    Attributes:
        radiance: [H, 2H, 3] linear RGB.
        depth_m: [H, 2H] distance along the ray.
        observed: [H, 2H] accumulated weight: 1 = shown by frames, 0 = inferred.
        clipped: [H, 2H] share of the observed surface whose pixels were clipped, 0 to 1.
        guessed: [H, 2H] luminance that the estimate for clipped pixels added to the observed radiance; the rest is a
            lower bound of the radiance.
        changed: [H, 2H] consecutive frames that showed other light on the same surface; negative: that saw through it.
        viewed_from: [H, 2H, 3] the camera that last showed this light, in metres from the probe, world axes.
        measured: [H, 2H] share of the observed surface whose depth was measured and not completed, 0 to 1.
    """

    radiance: Float[np.ndarray, "h w 3"]
    depth_m: Float[np.ndarray, "h w"]
    observed: Float[np.ndarray, "h w"]
    clipped: Float[np.ndarray, "h w"]
    guessed: Float[np.ndarray, "h w"]
    changed: Float[np.ndarray, "h w"]
    viewed_from: Float[np.ndarray, "h w 3"]
    measured: Float[np.ndarray, "h w"]

    @classmethod
    def fresh(cls, height: int, depth_max_m: float) -> "PanoramaState":
        """Return the state before the first frame: nothing observed."""
        shape = (height, 2 * height)
        unseen = np.full(shape, unseen_depth_m(depth_max_m), np.float32)
        observed, clipped, guessed, changed, measured = (np.zeros(shape, np.float32) for _ in range(5))
        radiance, viewed_from = (np.zeros((*shape, 3), np.float32) for _ in range(2))
        return cls(radiance, unseen, observed, clipped, guessed, changed, viewed_from, measured)

    @property
    def arrays(self) -> StateArrays:
        """The planes, for kernels."""
        return StateArrays(*(getattr(self, plane.name) for plane in fields(self)))

    def copy(self) -> "PanoramaState":
        """Return a copy that later frames do not change."""
        return PanoramaState(*(getattr(self, plane.name).copy() for plane in fields(self)))

    def for_lighting(self) -> "PanoramaState":
        """Return a copy that later frames do not change; what only blending needs is zero and takes no memory."""
        planes = {plane.name: getattr(self, plane.name) for plane in fields(self)}
        unused, zero = ("changed", "viewed_from", "measured"), np.zeros((), np.float32)
        return PanoramaState(
            **{k: np.broadcast_to(zero, plane.shape) if k in unused else plane.copy() for k, plane in planes.items()}
        )

    def is_closer(self, depth_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
        """Return where a surface is closer by `CLOSER_M` than the accumulated one: the conservative rule."""
        return self.depth_m - depth_m >= CLOSER_M

    def forget(self, changed: Bool[np.ndarray, "h w"], unseen_m: float) -> None:
        """Forget what was observed there, so that the next frame is seen as if it were the first."""
        for plane in (self.observed, self.clipped, self.guessed, self.measured):
            plane[changed] = 0
        self.depth_m[changed] = unseen_m

    def coverage(self) -> float:
        """Return the share of the sphere that was observed, by solid angle, in [0, 1]."""
        share = (self.observed * panorama_solid_angles(self.observed.shape[0])).sum() / (4 * np.pi)
        return min(1.0, float(share))


def accumulate(
    state: PanoramaState,
    partial: PartialPanorama,
    *,
    hdr: Float[np.ndarray, "h w 3"] | None,
    weight: Float[np.ndarray, "h w"],
    unseen_m: float,
    camera: Float[np.ndarray, "3"] = AT_PROBE,
) -> None:
    """Blend what one frame shows into the state, in place.

    With L_M the weight after the conservative rule, L~ the detail, L. the HDR panorama from the SGLV:
    L_M = max(L_M - 1(D^ - D~ < 0.25), 0);  L = L_M L~ + (1 - L_M)((1 - M^) L. + M^ L);
    D^ = L_M D~ + (1 - L_M) D^;  M^ = min(M^ + L_M, 1).  `weight` must be 0 where the frame's mesh is not seen.
    Without `hdr` (None) L. is L: nothing changes where the weight is 0.

    Where the state is clipped and the detail shows the same surface, L_M is at least min(weight, 1) times
    `better_share`. Where its light has changed (see the module), the state is forgotten first: M^ is 0 and D^ is
    `unseen_m`, the depth of what was never seen.

    `camera` is the frame's position in metres from the probe, world axes.
    """
    clipped = np.zeros_like(weight) if partial.clipped is None else partial.clipped
    guessed = np.zeros_like(weight) if partial.guessed is None else partial.guessed
    measured = np.ones_like(weight) if partial.measured is None else partial.measured.astype(np.float32)
    around = np.empty((3, *weight.shape), np.float32)
    height, closer_m = len(weight), np.float32(CLOSER_M)
    rows = find_extremes(partial.radiance, clipped, guessed, weight, len(neighbourhood(height)) // 2, around)
    place = np.asarray(camera, np.float32)
    seen = partial.radiance, partial.depth_m, clipped, guessed, weight
    frame = DetailArrays(*seen, around[0], around[1], around[2], place, measured)
    comparison = np.zeros(weight.shape, np.uint8)
    # One thread: both 0.1 ms for 120 x 240, more on a pool.
    compare_rows(state.arrays, frame, panorama_rays(height), closer_m, comparison, *rows)
    state.forget(replaced_by_change(state, comparison), unseen_m)
    behind = state.radiance if hdr is None else hdr
    start, stop = rows if hdr is None else (0, height)
    accumulate_rows(state.arrays, behind, frame, closer_m, hdr is None, start, stop)


def replaced_by_change(state: PanoramaState, comparison: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Count the frames that show other light; return where it replaces what was accumulated."""
    differs = comparison >= DIFFERS
    if not differs.any():
        return differs
    begins = cv2.dilate((comparison == BEGINS).astype(np.uint8), neighbourhood(len(comparison))) > 0
    counts = differs & (begins | (state.changed > 0))
    state.changed[differs] = np.where(counts, state.changed + 1, 0)[differs]
    taken = counts & (state.changed >= CHANGED_FRAMES)
    state.changed[taken] = 0
    return taken


def neighbourhood(height: int) -> UInt8[np.ndarray, "k k"]:
    """Return the pixels within `AROUND_DEG`, and at least those beside a pixel, as a mask."""
    radius = max(1, round(AROUND_DEG * height / 180))
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)


def latest_detail(
    state: PanoramaState, partial: PartialPanorama
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Return (radiance, confidence 0 to 1): this frame's detail where the conservative rule accepts it, else the
    accumulated radiance."""
    fresh = partial.mask & state.is_closer(partial.depth_m)
    known = np.where(fresh, np.float32(1), state.observed)
    return np.where(fresh[..., None], partial.radiance, state.radiance), known


def fill_beyond(
    radiance: Float[np.ndarray, "h w 3"],
    known: Float[np.ndarray, "h w"],
    partial: PartialPanorama,
    *,
    hdr: Float[np.ndarray, "h w 3"],
) -> Float[np.ndarray, "h w 3"]:
    """Return this frame's detail, with everything beyond its mask filled from all that was observed so far.

    `radiance` and `known` are what `latest_detail` returned. The blending network mixes the fill with the SGLV's
    panorama `hdr`, which is returned where nothing was observed yet.
    """
    around = fill_unknown(radiance, known) if known.any() else hdr
    return np.where(partial.mask[..., None], partial.radiance, around)


def mean_colour(detail: Float[np.ndarray, "h w 3"], known: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "3"]:
    """Return the mean colour of what was observed (`known` is 1), up to white, at luminance 1; grey if nothing was."""
    mean = np.tensordot(known * panorama_solid_angles(len(known)), np.minimum(detail, 1), axes=2)
    luminance = float(mean @ LUMINANCE)
    return (mean / luminance if luminance > 0 else np.ones(3)).astype(np.float32)


def fill_in(
    hdr: Float[np.ndarray, "h w 3"],
    ldr: Float[np.ndarray, "h w 3"],
    mask: Bool[np.ndarray, "h w"],
    *,
    weight: Float[np.ndarray, "h w"],
) -> Float[np.ndarray, "h w 3"]:
    """Mix the fill in `ldr` into the SGLV's panorama beyond the mesh, by `weight` and with most of its own colour.

    Networks learn how bright unobserved places are. Their colour follows from the surroundings as well, and better in
    rooms unlike the training rooms.
    """
    hdr, ldr, weight = (np.ascontiguousarray(plane, np.float32) for plane in (hdr, ldr, weight))
    mixed = np.empty_like(hdr)
    mix_beyond(hdr, ldr, np.ascontiguousarray(mask), weight, np.float32(FILL_COLOUR), np.float32(DARK), mixed)
    return mixed
