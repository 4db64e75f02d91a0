"""The ONNX graphs of a model, with their inputs and outputs.

Names, shapes and order are the interface to the programs that run the graphs. Encoders, GRUs and decoders are separate
graphs, so that a server can keep states bound between them. Volumes are [z, y, x]; all tensors are float32.

`unit`, an input of the video form's 3D encoder and decoder, is the first frame's mean colour
(`roomlight.engine.networks.units`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from roomlight.engine.lighting import LIGHTING_PANELS
from roomlight.engine.networks.clipping import CHANNELS, SIDE
from roomlight.engine.panorama.panels import HEIGHT
from roomlight.monocular.network import DEPTH_CHANNELS, DEPTH_SIDE
from roomlight_model.checkpoint import Network
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.depth.network import DepthNetwork
from roomlight_model.layers import ConvGRU
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.panorama_networks import SINGLE_PANELS, VIDEO_PANELS
from roomlight_model.volume_networks import SGDecoder, SGVolume, merge

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Graph:
    """One graph to export: the module and its named inputs and outputs."""

    name: str
    module: nn.Module
    inputs: Mapping[str, Shape]
    outputs: Mapping[str, Shape]


class _FirstDecoder(nn.Module):
    """The single-view decoder without a batch dimension at its outputs, as the renderer takes them."""

    def __init__(self, decoder: SGDecoder) -> None:
        super().__init__()
        self.decoder = decoder

    def forward(self, f0: Tensor, f1: Tensor, volume: Tensor) -> tuple[Tensor, Tensor]:
        predicted: SGVolume = self.decoder(f0, f1, volume)
        return predicted.alpha[0], predicted.lobes[0]


class _MergingDecoder(nn.Module):
    """The recurrent decoder and the merge with the previous volume."""

    def __init__(self, decoder: SGDecoder) -> None:
        super().__init__()
        self.decoder = decoder

    def forward(
        self,
        h0: Tensor,
        h1: Tensor,
        volume: Tensor,
        alpha_previous: Float[Tensor, "z y x"],
        lobes_previous: Float[Tensor, "z y x 10"],
        unit: Tensor,
    ) -> tuple[Tensor, Tensor]:
        merged = merge(self.decoder(h0, h1, volume, unit), alpha_previous[None], lobes_previous[None])
        return merged.alpha[0], merged.lobes[0]


class _TwoGRUs(nn.Module):
    """The GRUs of both levels in one graph, for one call per frame."""

    def __init__(self, gru0: ConvGRU, gru1: ConvGRU) -> None:
        super().__init__()
        self.gru0 = gru0
        self.gru1 = gru1

    def forward(self, h0: Tensor, h1: Tensor, f0: Tensor, f1: Tensor) -> tuple[Tensor, Tensor]:
        return self.gru0(h0, f0), self.gru1(h1, f1)


def graphs_of(model: Network) -> list[Graph]:
    """Return all graphs of a model: four of the single-view form; ten of the video form, including those four.

    A small network has one graph, with the name of its form.
    """
    if isinstance(model, SingleModel | VideoModel):
        return _large_graphs(model)
    panorama = (HEIGHT, 2 * HEIGHT)
    if isinstance(model, ClippingNetwork):
        shapes = {"planes": (1, CHANNELS, SIDE, SIDE)}, {"log_radiance": (1, 3, SIDE // 2, SIDE // 2)}
    elif isinstance(model, DepthNetwork):
        half = DEPTH_SIDE // 2
        shapes = {"planes": (1, DEPTH_CHANNELS, DEPTH_SIDE, DEPTH_SIDE)}, {"log_depth": (1, 2, half, half)}
    else:
        shapes = {"panels": (1, LIGHTING_PANELS, *panorama)}, {"change": (1, 3, *panorama)}
    return [Graph(model.form, model, *shapes)]


def _eighth(size: int) -> int:
    return size // 2 // 2 // 2  # each strided convolution rounds down


def _large_graphs(model: SingleModel | VideoModel) -> list[Graph]:
    sg, blend = model.config.sg, model.config.blend
    volume, panorama = {"volume": (1, 5, *sg.volume_shape)}, (blend.height, 2 * blend.height)
    predicted = {"alpha": sg.volume_shape, "lobes": (*sg.volume_shape, 10)}
    f0 = (1, sg.channels, *(size // 2 for size in sg.volume_shape))
    f1 = (1, 4 * sg.channels, *(_eighth(size) for size in sg.volume_shape))
    b0 = (1, blend.channels, *(size // 2 for size in panorama))
    b1 = (1, 4 * blend.channels, *(_eighth(size) for size in panorama))
    features, blend_features = {"f0": f0, "f1": f1}, {"f0": b0, "f1": b1}
    mask, weight = {"mask": (1, 1, *panorama)}, {"weight": (1, 1, *panorama)}
    single = model.single if isinstance(model, VideoModel) else model
    panels = {"panels": (1, SINGLE_PANELS, *panorama)}
    graphs = [
        Graph("single_sg_encoder", single.sg_encoder, volume, features),
        Graph("single_sg_decoder", _FirstDecoder(single.sg_decoder), features | volume, predicted),
        Graph("single_blend_encoder", single.blend_encoder, panels, blend_features),
        Graph("single_blend_decoder", single.blend_decoder, blend_features | mask, weight),
    ]
    if isinstance(model, SingleModel):
        return graphs
    unit = {"unit": (1, 3, 1, 1, 1)}
    state, blend_state = {"h0": f0, "h1": f1}, {"h0": b0, "h1": b1}
    previous = {f"{name}_previous": shape for name, shape in predicted.items()}
    panels = {"panels": (1, VIDEO_PANELS, *panorama)}
    return [
        *graphs,
        Graph("video_sg_encoder", model.sg_encoder, volume | unit, features),
        Graph("video_sg_gru", _TwoGRUs(model.sg_gru0, model.sg_gru1), state | features, {"h0_next": f0, "h1_next": f1}),
        Graph("video_sg_decoder", _MergingDecoder(model.sg_decoder), state | volume | previous | unit, predicted),
        Graph("video_blend_encoder", model.blend_encoder, panels, blend_features),
        Graph(
            "video_blend_gru",
            _TwoGRUs(model.blend_gru0, model.blend_gru1),
            blend_state | blend_features,
            {"h0_next": b0, "h1_next": b1},
        ),
        Graph("video_blend_decoder", model.blend_decoder, blend_state | mask, weight),
    ]
