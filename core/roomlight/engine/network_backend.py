"""The paper's recursion on ONNX graphs: one session's 3D state, and each probe's 2D hidden states.

Single view: every frame's initial volume is fused with those before (`roomlight.engine.volume.fusion`), and the mean is
encoded and decoded like one frame's. A probe's panorama accumulates as in the video form. Inferred values (the SGLV and
each probe's HDR panorama) move half-way to the new estimate at each frame (`FILL_UPDATE`). The paper's single view
keeps nothing between frames.

Video: the first frame goes through the single-view graphs and its features become the hidden states (h = f); from
then on encoder, GRU, decoder, and the decoder merges with the previous SGLV by V_u. Every state has two buffers, and
each frame's graphs read one and write the other: nothing is copied. Encoder and decoder take the first frame's mean
colour as an input (`roomlight.engine.networks.units`). Where the fill has a share of the light (`hedged`), the HDR
panorama moves half-way here too.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.engine.backend import FILL_UPDATE, Arrays, Estimate, ProbeMemory
from roomlight.engine.networks.graphs import BoundGraph, Buffers, LightingGraphs
from roomlight.engine.networks.units import mean_colour
from roomlight.engine.panorama.blend import PanoramaState, fill_in, filled_detail
from roomlight.engine.surface.mesh import PartialPanorama
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv
from roomlight.errors import ModelError


class NetworkBackend:
    """The state of one session on shared graphs."""

    far: Far = "boundary"

    def __init__(self, graphs: LightingGraphs, *, hedge: float = 0.0) -> None:
        """Begin without frames; `hedge` is the share of the fill in inferred light (`hedged`)."""
        self._graphs, self._hedge = graphs, hedge
        self.name = graphs.form
        self.digest = graphs.digest

    def start(self, grid: VolumeGrid) -> None:
        """Allocate and bind the 3D states.

        Raises:
            ModelError: the graphs were exported for another volume shape.
        """
        g = self._graphs.graphs
        if tuple(grid.shape) != self._graphs.volume_shape:
            raise ModelError(
                f"{self._graphs.path}: exported for volumes of {self._graphs.volume_shape}, "
                f"this session's is {grid.shape}"
            )
        self._volume = np.zeros((5, *grid.shape), np.float32)
        single = self._graphs.form == "single"
        self._frame_volume = np.zeros_like(self._volume) if single else self._volume
        self._fused = FusedVolume.fresh(grid.shape) if single else None
        self._frames = 0
        sglv = [g["single_sg_decoder"].new_outputs() for _ in range(2)]
        self._sglv = [Sglv(grid, out["alpha"], out["lobes"]) for out in sglv]
        features = g["single_sg_encoder"].new_outputs()
        self._first = [
            g["single_sg_encoder"].bind({"volume": self._volume}, features),
            g["single_sg_decoder"].bind({**features, "volume": self._volume}, sglv[0]),
        ]
        self._next: list[list[BoundGraph]] = []
        self._hidden: list[Buffers] = []
        if self._graphs.form == "video":
            hidden = self._hidden = [{"h0": features["f0"], "h1": features["f1"]}]  # after the first frame, h = f
            hidden.append({key: np.zeros_like(array) for key, array in hidden[0].items()})
            fresh = g["video_sg_encoder"].new_outputs()
            self._unit = np.ones((1, 3, 1, 1, 1), np.float32)
            first = {"unit": self._unit} if "unit" in g["video_sg_encoder"].inputs else {}
            encode = g["video_sg_encoder"].bind({"volume": self._volume, **first}, fresh)
            for old, new in ((0, 1), (1, 0)):
                h_next = {f"{key}_next": array for key, array in hidden[new].items()}
                before = {"alpha_previous": sglv[old]["alpha"], "lobes_previous": sglv[old]["lobes"]}
                self._next.append(
                    [
                        encode,
                        g["video_sg_gru"].bind({**hidden[old], **fresh}, h_next),
                        g["video_sg_decoder"].bind(
                            {**hidden[new], **before, "volume": self._volume, **first}, sglv[new]
                        ),
                    ]
                )

    def volume_buffer(self) -> Float[np.ndarray, "5 z y x"]:
        """Return the buffer for the frame's initial volume: in the video form the encoder's bound input."""
        return self._frame_volume

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> Sglv:
        """Run this frame's graphs on the volume in the buffer."""
        if self._fused is not None:
            self._fused.add(self._frame_volume, clipping)
            self._fused.write(self._volume)
        if self._frames == 0 or self._fused is not None:
            steps, result = self._first, self._sglv[0]
        else:
            parity = (self._frames - 1) % 2
            steps, result = self._next[parity], self._sglv[1 - parity]
        if self._fused is None and self._frames == 0:
            self._unit[0, :, 0, 0, 0] = mean_colour(self._volume)
        for step in steps:
            step.run()
        self._frames += 1
        return result if self._fused is None else self._move_towards_new()

    def _move_towards_new(self) -> Sglv:
        """Move the kept SGLV half-way to this frame's; voxels observed as empty are cleared at once."""
        new, kept = self._sglv
        share = np.float32(FILL_UPDATE if self._frames > 1 else 1)
        empty = self._volume[4] < 0
        for target, values in ((new.alpha, kept.alpha), (new.lobes, kept.lobes)):
            values += share * (target - values)
            values[empty] = 0
        return kept

    def save(self) -> Arrays:
        """Return copies of the SGLV, and of the sums over frames (single view) or the hidden states (video)."""
        sglv = self._sglv[self._latest]
        saved: Arrays = {"frames": np.array(self._frames), "alpha": sglv.alpha.copy(), "lobes": sglv.lobes.copy()}
        if self._fused is not None:
            return saved | self._fused.save()
        saved["unit"] = self._unit.copy()
        return saved | {key: array.copy() for key, array in self._hidden[self._latest].items()}

    def restore(self, grid: VolumeGrid, saved: Arrays) -> Sglv:
        """Continue from a saved state."""
        self.start(grid)
        self._frames = int(saved["frames"])
        sglv = self._sglv[self._latest]
        sglv.alpha[:], sglv.lobes[:] = saved["alpha"], saved["lobes"]
        if self._fused is not None:
            self._fused.restore(saved)
            return sglv
        self._unit[:] = saved["unit"]
        for key, array in self._hidden[self._latest].items():
            array[:] = saved[key]
        return sglv

    @property
    def _latest(self) -> int:
        """Number of the buffers that hold the states after the last frame."""
        return 1 if self._fused is not None else (self._frames - 1) % 2

    def new_probe(self) -> ProbeMemory:
        """Return the 2D hidden states of one probe, bound to the graphs."""
        return _ProbeNetworks(self._graphs)

    def save_probe(self, memory: ProbeMemory) -> Arrays:
        """Return copies of the 2D hidden states of one probe; single-view networks keep none."""
        assert isinstance(memory, _ProbeNetworks)
        return memory.save()

    def restore_probe(self, saved: Arrays) -> ProbeMemory:
        """Return the 2D hidden states of one probe from saved ones."""
        memory = _ProbeNetworks(self._graphs)
        memory.restore(saved)
        return memory

    def estimate(
        self,
        memory: ProbeMemory,
        state: PanoramaState,
        *,
        rendered: Float[np.ndarray, "h w 3"],
        transmittance: Float[np.ndarray, "h w"],
        partial: PartialPanorama,
        depth_max_m: float,
    ) -> Estimate:
        """Estimate HDR panorama and weight.

        HDR: the SGLV as rendered; beyond the mesh mixed with a fill of the observed radiance, by the network's weight.
        Weight: the network's, within the mesh.
        """
        del transmittance
        assert isinstance(memory, _ProbeNetworks)
        first = memory.frames == 0
        ldr = filled_detail(state, partial.radiance, partial.depth_m, mask=partial.mask, hdr=rendered)
        weight = memory.weigh(state, rendered, replace(partial, radiance=ldr), depth_max_m)
        hdr = fill_in(rendered, ldr, partial.mask, weight=weight) if self._graphs.filled else rendered
        hdr = hedged(hdr, ldr, share=self._hedge)
        if (self._fused is not None or self._hedge > 0) and not first:  # the fill has no memory of its own
            hdr = state.radiance + np.float32(FILL_UPDATE) * (hdr - state.radiance)
        return Estimate(hdr, weight * partial.mask)


def hedged(
    hdr: Float[np.ndarray, "h w 3"], fill: Float[np.ndarray, "h w 3"], *, share: float
) -> Float[np.ndarray, "h w 3"]:
    """Return the weighted mean, in log(1 + L), of the networks' light and of the fill from what was observed.

    The two err in different rooms: the fill where the light is behind the camera, the networks in rooms unlike those
    of their training. The error of the mean is never above the mean of both errors, since log-L2 is convex.
    """
    if share == 0:
        return hdr
    logarithm = np.log1p(hdr)
    return np.expm1(logarithm + np.float32(share) * (np.log1p(fill) - logarithm))


@dataclass
class _ProbeNetworks:
    """One probe's blending graphs with their buffers; panoramas of other heights are resampled, for the weight only."""

    graphs: LightingGraphs
    frames: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        g = self.graphs.graphs
        self._height = self.graphs.panorama_height
        shape = (self._height, 2 * self._height)
        self._mask = np.zeros((1, 1, *shape), np.float32)
        self._weight = np.zeros((1, 1, *shape), np.float32)
        self._panels8 = np.zeros((1, 8, *shape), np.float32)
        features = g["single_blend_encoder"].new_outputs()
        self._first = [
            g["single_blend_encoder"].bind({"panels": self._panels8}, features),
            g["single_blend_decoder"].bind({**features, "mask": self._mask}, {"weight": self._weight}),
        ]
        self._next: list[list[BoundGraph]] = []
        self._hidden: list[Buffers] = []
        if self.graphs.form == "video":
            self._panels13 = np.zeros((1, 13, *shape), np.float32)
            hidden = self._hidden = [{"h0": features["f0"], "h1": features["f1"]}]
            hidden.append({key: np.zeros_like(array) for key, array in hidden[0].items()})
            fresh = g["video_blend_encoder"].new_outputs()
            encode = g["video_blend_encoder"].bind({"panels": self._panels13}, fresh)
            for old, new in ((0, 1), (1, 0)):
                h_next = {f"{key}_next": array for key, array in hidden[new].items()}
                self._next.append(
                    [
                        encode,
                        g["video_blend_gru"].bind({**hidden[old], **fresh}, h_next),
                        g["video_blend_decoder"].bind({**hidden[new], "mask": self._mask}, {"weight": self._weight}),
                    ]
                )

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
        state: PanoramaState,
        rendered: Float[np.ndarray, "h w 3"],
        partial: PartialPanorama,
        depth_max_m: float,
    ) -> Float[np.ndarray, "h w"]:
        """Compute the raw blending weight L_M of this frame; beyond the mesh, of the fill in `partial.radiance`."""
        mask = partial.mask.astype(np.float32)
        first = self.frames == 0 or self.graphs.form == "single"
        target, height = (self._panels8 if first else self._panels13)[0], self._height
        at = 0 if first else 3
        target[at : at + 3] = _planes(_resample(rendered, height))
        target[at + 3 : at + 6] = _planes(_resample(partial.radiance, height))
        self._mask[0, 0] = target[at + 6] = _nearest(mask, height)
        np.subtract(1, target[at + 6], out=target[at + 7])
        if not first:
            target[:3] = _planes(_resample(state.radiance, height))
            target[11] = _nearest(partial.depth_m, height) / depth_max_m
            target[12] = _nearest(state.depth_m, height) / depth_max_m
        for step in self._first if first else self._next[(self.frames - 1) % 2]:
            step.run()
        self.frames += 1
        return _resample(self._weight[0, 0], mask.shape[0])


def _planes(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3 h w"]:
    return np.moveaxis(image, -1, 0)


def _resample(image: Float[np.ndarray, "h w *c"], height: int) -> Float[np.ndarray, "{height} 2*{height} *c"]:
    if image.shape[0] == height:
        return image
    interpolation = cv2.INTER_AREA if image.shape[0] > height else cv2.INTER_LINEAR
    return cv2.resize(image, (2 * height, height), interpolation=interpolation)


def _nearest(plane: Float[np.ndarray, "h w"], height: int) -> Float[np.ndarray, "{height} 2*{height}"]:
    """Resample masks and depth by nearest neighbour: a mean across an edge would be a surface that does not exist."""
    if plane.shape[0] == height:
        return plane
    return cv2.resize(plane, (2 * height, height), interpolation=cv2.INTER_NEAREST_EXACT)
