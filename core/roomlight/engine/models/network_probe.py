"""One probe on the paper's blending graphs: its 2D hidden states, and its estimates.

The HDR panorama is the SGLV as rendered; beyond the mesh it is mixed with a fill of the observed radiance, by the
network's weight, and then, by a fixed share, with two fills that need no network (`hedged`). With single-view networks
or a share it moves half-way to the new estimate at each frame.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight.engine.kernels.fill import mute
from roomlight.engine.models.interface import FILL_UPDATE, Arrays, Estimate, Rendered
from roomlight.engine.networks.graph import BoundGraph
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.networks.runtime import Buffers
from roomlight.engine.panorama.blend import (
    PanoramaState,
    PartialPanorama,
    fill_beyond,
    fill_in,
    latest_detail,
    mean_colour,
)
from roomlight.engine.panorama.panels import resized
from roomlight.engine.panorama.prior import PanoramaPrior

OWN_COLOUR: Final = 0.5
"""Share of its own colour that inferred light keeps (`muted`). On 27 captures log-L2, the matte sphere's error and the
mirror's are the same as at 1; the matte sphere's colour is 0.2 degrees farther off."""


def hedged(
    hdr: Float[np.ndarray, "h w 3"], fills: Sequence[Float[np.ndarray, "h w 3"]], *, share: float
) -> Float[np.ndarray, "h w 3"]:
    """Return the weighted mean, in log(1 + L), of the networks' light and of fills from what was observed.

    They err in different rooms: fills where the light is behind the camera, networks in rooms unlike those of their
    training. The error of the mean is never above the mean of the errors, since log-L2 is convex.

    The fills have equal parts of the share, 0 to 1.
    """
    if share == 0:
        return hdr
    logarithm = np.float32(1 - share) * np.log1p(hdr)
    for fill in fills:
        logarithm += np.float32(share / len(fills)) * np.log1p(fill)
    return np.expm1(logarithm)


def muted(
    hdr: Float[np.ndarray, "h w 3"], detail: Float[np.ndarray, "h w 3"], known: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Return inferred light with its colour moved toward the mean colour of what was observed; luminance stays.

    Which direction has which colour is a guess: a wall's green smeared over the ceiling shows in every mirror. `known`
    is 1 where `detail` was observed, 0 elsewhere.
    """
    if not known.any():
        return hdr
    changed = np.empty(hdr.shape, np.float32)
    light = np.ascontiguousarray(hdr, np.float32)
    mute(light, mean_colour(detail, known), np.float32(OWN_COLOUR), changed)
    return changed


class NetworkProbe:
    """One probe's blending graphs with their buffers; panoramas of other heights are resampled, for the weight only."""

    def __init__(self, graphs: LightingGraphs, prior: PanoramaPrior, hedge: float = 0.0) -> None:
        """Begin without frames; `hedge` is the share of the fills (`hedged`)."""
        self._graphs, self._prior, self._hedge = graphs, prior, hedge
        self.frames = 0
        loaded = graphs.graphs
        self._height = graphs.panorama_height
        shape = (self._height, 2 * self._height)
        self._mask = np.zeros((1, 1, *shape), np.float32)
        self._weight = np.zeros((1, 1, *shape), np.float32)
        self._panels8 = np.zeros((1, 8, *shape), np.float32)
        features = loaded["single_blend_encoder"].new_outputs()
        self._first = [
            loaded["single_blend_encoder"].bind({"panels": self._panels8}, features),
            loaded["single_blend_decoder"].bind({**features, "mask": self._mask}, {"weight": self._weight}),
        ]
        self._next: list[list[BoundGraph]] = []
        self._hidden: list[Buffers] = []
        if graphs.form == "video":
            self._panels13 = np.zeros((1, 13, *shape), np.float32)
            hidden = self._hidden = [{"h0": features["f0"], "h1": features["f1"]}]
            hidden.append({key: np.zeros_like(array) for key, array in hidden[0].items()})
            fresh = loaded["video_blend_encoder"].new_outputs()
            encode = loaded["video_blend_encoder"].bind({"panels": self._panels13}, fresh)
            for old, new in ((0, 1), (1, 0)):
                h_next = {f"{key}_next": array for key, array in hidden[new].items()}
                self._next.append(
                    [
                        encode,
                        loaded["video_blend_gru"].bind({**hidden[old], **fresh}, h_next),
                        loaded["video_blend_decoder"].bind(
                            {**hidden[new], "mask": self._mask}, {"weight": self._weight}
                        ),
                    ]
                )

    def estimate(
        self, panorama: PanoramaState, rendered: Rendered, partial: PartialPanorama, *, depth_max_m: float
    ) -> Estimate:
        """Estimate HDR panorama and weight; the weight is the network's, within the mesh."""
        first = self.frames == 0
        hdr = rendered.radiance
        detail, known = latest_detail(panorama, partial)
        ldr = fill_beyond(detail, known, partial, hdr=hdr)
        weight = self.weigh(panorama, hdr, replace(partial, radiance=ldr), depth_max_m)
        hdr = fill_in(hdr, ldr, partial.mask, weight=weight)
        if self._hedge > 0:
            hdr = muted(hedged(hdr, (ldr, self._prior.fill(detail, known)), share=self._hedge), detail, known)
        if (self._graphs.form == "single" or self._hedge > 0) and not first:  # the fill has no memory of its own
            hdr = panorama.radiance + np.float32(FILL_UPDATE) * (hdr - panorama.radiance)
        return Estimate(hdr, np.where(_above_white(partial), np.float32(1), weight * partial.mask))

    def save(self) -> Arrays:
        """Return copies of the hidden states after the last frame, and the number of frames."""
        hidden = self._hidden[(self.frames - 1) % 2] if self._hidden and self.frames else {}
        return {"frames": np.array(self.frames)} | {key: array.copy() for key, array in hidden.items()}

    def restore(self, saved: Arrays) -> None:
        """Take over saved hidden states."""
        self.frames = int(saved["frames"])
        if self._hidden and self.frames:
            for key, array in self._hidden[(self.frames - 1) % 2].items():
                array[:] = saved[key]

    def weigh(
        self,
        panorama: PanoramaState,
        rendered: Float[np.ndarray, "h w 3"],
        partial: PartialPanorama,
        depth_max_m: float,
    ) -> Float[np.ndarray, "h w"]:
        """Compute the raw blending weight L_M of this frame; beyond the mesh, of the fill in `partial.radiance`."""
        mask = partial.mask.astype(np.float32)
        first = self.frames == 0 or self._graphs.form == "single"
        target, height = (self._panels8 if first else self._panels13)[0], self._height
        at = 0 if first else 3
        target[at : at + 3] = _planes(resized(rendered, height))
        target[at + 3 : at + 6] = _planes(resized(partial.radiance, height))
        self._mask[0, 0] = target[at + 6] = _nearest(mask, height)
        np.subtract(1, target[at + 6], out=target[at + 7])
        if not first:
            target[:3] = _planes(resized(panorama.radiance, height))
            target[11] = _nearest(partial.depth_m, height) / depth_max_m
            target[12] = _nearest(panorama.depth_m, height) / depth_max_m
        for step in self._first if first else self._next[(self.frames - 1) % 2]:
            step.run()
        self.frames += 1
        return resized(self._weight[0, 0], mask.shape[0])


def _above_white(partial: PartialPanorama) -> Bool[np.ndarray, "h w"]:
    """Return where measured light is brighter than white: it is taken whole, as a share of a volume would dim lamps."""
    above = partial.mask & (partial.radiance.max(axis=-1) > 1)
    return above if partial.clipped is None else above & (partial.clipped == 0)


def _planes(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3 h w"]:
    return np.moveaxis(image, -1, 0)


def _nearest(plane: Float[np.ndarray, "h w"], height: int) -> Float[np.ndarray, "{height} 2*{height}"]:
    """Resample masks and depth by nearest neighbour: a mean across an edge would be a surface that does not exist."""
    if plane.shape[0] == height:
        return plane
    return cv2.resize(plane, (2 * height, height), interpolation=cv2.INTER_NEAREST_EXACT)
