"""The paper's networks as lighting models: the 3D recursion on ONNX graphs; `network_probe` has each probe's 2D part.

Single view: every frame's initial volume is fused with those before (`roomlight.engine.volume.fusion`), and the mean is
encoded and decoded like one frame's. Inferred values (the SGLV, and each probe's HDR panorama) move half-way to the new
estimate at each frame (`FILL_UPDATE`). The paper's single view keeps nothing between frames.

Video: the first frame goes through the single-view graphs and its features become the hidden states (h = f); from
then on encoder, GRU, decoder, and the decoder merges with the previous SGLV by V_u. Every state has two buffers, and
each frame's graphs read one and write the other: nothing is copied. Encoder and decoder take the first frame's mean
colour as an input (`roomlight.engine.networks.units`).
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from roomlight.engine.kernels.fusion import move_towards
from roomlight.engine.models.interface import FILL_UPDATE, Arrays
from roomlight.engine.models.network_probe import NetworkProbe
from roomlight.engine.networks.graph import BoundGraph
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.networks.runtime import Buffers
from roomlight.engine.networks.units import mean_colour
from roomlight.engine.panorama.prior import PanoramaPrior, shipped_prior
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv
from roomlight.errors import ModelError
from roomlight.threads import parallel_for


@dataclass(frozen=True)
class NetworkModel:
    """The networks of either form.

    Attributes:
        graphs: Loaded graphs, shared between sessions.
        hedge: Share of the fill in inferred light (`roomlight.engine.models.network_probe.hedged`).
        prior: Fills what no frame has shown.
    """

    graphs: LightingGraphs
    hedge: float = 0.0
    prior: PanoramaPrior = field(default_factory=shipped_prior)

    @property
    def name(self) -> str:
        """The networks' form: single or video."""
        return self.graphs.form

    @property
    def digest(self) -> str:
        """Identity of the weights."""
        return self.graphs.digest

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Voxels along z, y, x that the graphs take."""
        return self.graphs.volume_shape

    def begin(self, grid: VolumeGrid) -> "SingleViewVolume | RecurrentVolume":
        """Allocate and bind the 3D states.

        Raises:
            ModelError: The graphs were exported for another volume shape.
        """
        if tuple(grid.shape) != self.volume_shape:
            raise ModelError(
                f"{self.graphs.path}: exported for volumes of {self.volume_shape}, this session's is {grid.shape}"
            )
        return (SingleViewVolume if self.graphs.form == "single" else RecurrentVolume)(self.graphs, grid)

    def new_probe(self) -> NetworkProbe:
        """Begin a probe that has observed nothing."""
        return NetworkProbe(self.graphs, self.prior, self.hedge)


def _bound_single_view(
    graphs: LightingGraphs, volume: Float[np.ndarray, "5 z y x"], sglv: Buffers
) -> tuple[Buffers, list[BoundGraph]]:
    """Bind encoder and decoder of one frame; return the features between them, and both."""
    encoder, decoder = graphs.graphs["single_sg_encoder"], graphs.graphs["single_sg_decoder"]
    features = encoder.new_outputs()
    return features, [
        encoder.bind({"volume": volume}, features),
        decoder.bind({**features, "volume": volume}, sglv),
    ]


class SingleViewVolume:
    """The single-view networks on the mean of all frames' initial volumes."""

    far: Far = "boundary"

    def __init__(self, graphs: LightingGraphs, grid: VolumeGrid) -> None:
        """Begin without frames."""
        self.volume = np.zeros((5, *grid.shape), np.float32)
        self._fused = FusedVolume.fresh(grid.shape)
        self._mean = np.zeros_like(self.volume)  # bound to the encoder
        decoder = graphs.graphs["single_sg_decoder"]
        inferred, kept = (decoder.new_outputs() for _ in range(2))
        self._inferred = Sglv(grid, inferred["alpha"], inferred["lobes"])
        self.sglv = Sglv(grid, kept["alpha"], kept["lobes"])
        _, self._steps = _bound_single_view(graphs, self._mean, inferred)
        self._frames = 0

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Infer the mean volume's SGLV and move the kept one half-way to it; clear voxels observed as empty at once."""
        self._fused.add(self.volume, clipping)
        self._fused.write(self._mean)
        for step in self._steps:
            step.run()
        share = np.float32(FILL_UPDATE if self._frames > 0 else 1)
        observed = self._mean[4].reshape(-1)
        for target, values in ((self._inferred.alpha, self.sglv.alpha), (self._inferred.lobes, self.sglv.lobes)):
            flat = (len(observed), -1)
            move = partial(move_towards, values.reshape(flat), target.reshape(flat), share, observed)
            parallel_for(move, len(observed))
        self._frames += 1

    def add(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Add the volume to the mean."""
        self._fused.add(self.volume, clipping)

    def save(self) -> Arrays:
        """Return copies of the SGLV and of the sums over frames."""
        sglv = {"alpha": self.sglv.alpha.copy(), "lobes": self.sglv.lobes.copy()}
        return {"frames": np.array(self._frames)} | sglv | self._fused.save()

    def restore(self, saved: Arrays) -> None:
        """Take over a saved state."""
        self._frames = int(saved["frames"])
        self.sglv.alpha[:], self.sglv.lobes[:] = saved["alpha"], saved["lobes"]
        self._fused.restore(saved)


class RecurrentVolume:
    """The recurrent networks; buffers 0 and 1 take turns, and `_latest` is the number of those of the last frame."""

    far: Far = "boundary"

    def __init__(self, graphs: LightingGraphs, grid: VolumeGrid) -> None:
        """Begin without frames."""
        loaded = graphs.graphs
        self.volume = np.zeros((5, *grid.shape), np.float32)  # bound to the encoders
        self._unit = np.ones((1, 3, 1, 1, 1), np.float32)
        decoded = [loaded["single_sg_decoder"].new_outputs() for _ in range(2)]
        self._sglvs = [Sglv(grid, arrays["alpha"], arrays["lobes"]) for arrays in decoded]
        first, self._first = _bound_single_view(graphs, self.volume, decoded[0])
        hidden = {"h0": first["f0"], "h1": first["f1"]}  # after the first frame, h = f
        self._hidden = [hidden, {key: np.zeros_like(array) for key, array in hidden.items()}]
        features = loaded["video_sg_encoder"].new_outputs()
        unit = {"unit": self._unit} if "unit" in loaded["video_sg_encoder"].inputs else {}
        encode = loaded["video_sg_encoder"].bind({"volume": self.volume, **unit}, features)
        self._next: list[tuple[BoundGraph, ...]] = []  # by the number of the buffers that are written
        for old, new in ((1, 0), (0, 1)):
            h_next = {f"{key}_next": array for key, array in self._hidden[new].items()}
            before = {"alpha_previous": decoded[old]["alpha"], "lobes_previous": decoded[old]["lobes"]}
            update = loaded["video_sg_gru"].bind({**self._hidden[old], **features}, h_next)
            decode = loaded["video_sg_decoder"].bind(
                {**self._hidden[new], **before, "volume": self.volume, **unit}, decoded[new]
            )
            self._next.append((encode, update, decode))
        self._frames = 0

    @property
    def _latest(self) -> int:
        return max(self._frames - 1, 0) % 2

    @property
    def sglv(self) -> Sglv:
        """The SGLV after the last frame."""
        return self._sglvs[self._latest]

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Run this frame's graphs on the volume in the buffer."""
        del clipping
        self._frames += 1
        if self._frames == 1:
            self._unit[0, :, 0, 0, 0] = mean_colour(self.volume)
        for step in self._first if self._frames == 1 else self._next[self._latest]:
            step.run()

    def add(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Run the graphs: the recursion takes frames one by one."""
        self.update(clipping)

    def save(self) -> Arrays:
        """Return copies of the SGLV, the hidden states and the unit of colour."""
        saved: Arrays = {"frames": np.array(self._frames), "unit": self._unit.copy()}
        saved |= {"alpha": self.sglv.alpha.copy(), "lobes": self.sglv.lobes.copy()}
        return saved | {key: array.copy() for key, array in self._hidden[self._latest].items()}

    def restore(self, saved: Arrays) -> None:
        """Take over a saved state."""
        self._frames = int(saved["frames"])
        self._unit[:] = saved["unit"]
        self.sglv.alpha[:], self.sglv.lobes[:] = saved["alpha"], saved["lobes"]
        for key, array in self._hidden[self._latest].items():
            array[:] = saved[key]
