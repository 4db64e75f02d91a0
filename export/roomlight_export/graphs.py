"""The ONNX graphs of a model, with their inputs and outputs.

Names, shapes and order are the interface to the programs that run the graphs. Encoders, GRUs and decoders are separate
graphs, so that a server can keep states bound between them. Volumes are [z, y, x]; all tensors are float32.

`unit`, an input of the video form's 3D encoder and decoder, is the first frame's mean colour
(`roomlight.engine.networks.units`).
"""

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
    inputs: dict[str, Shape]
    outputs: dict[str, Shape]


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
    if isinstance(model, VideoModel):
        return _single_graphs(model.single) + _video_graphs(model)
    if isinstance(model, SingleModel):
        return _single_graphs(model)
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


@dataclass(frozen=True)
class _Shapes:
    volume: Shape
    alpha: Shape
    lobes: Shape
    f0: Shape
    f1: Shape
    panorama: Shape
    b0: Shape
    b1: Shape

    @classmethod
    def of(cls, model: SingleModel | VideoModel) -> "_Shapes":
        sg, blend = model.config.sg, model.config.blend
        panorama = (blend.height, 2 * blend.height)
        return cls(
            volume=(1, 5, *sg.volume_shape),
            alpha=sg.volume_shape,
            lobes=(*sg.volume_shape, 10),
            f0=(1, sg.channels, *(size // 2 for size in sg.volume_shape)),
            f1=(1, 4 * sg.channels, *(_eighth(size) for size in sg.volume_shape)),
            panorama=panorama,
            b0=(1, blend.channels, *(size // 2 for size in panorama)),
            b1=(1, 4 * blend.channels, *(_eighth(size) for size in panorama)),
        )


def _single_graphs(model: SingleModel) -> list[Graph]:
    at = _Shapes.of(model)
    mask, features = (1, 1, *at.panorama), {"f0": at.b0, "f1": at.b1}
    return [
        Graph("single_sg_encoder", model.sg_encoder, {"volume": at.volume}, {"f0": at.f0, "f1": at.f1}),
        Graph(
            "single_sg_decoder",
            _FirstDecoder(model.sg_decoder),
            {"f0": at.f0, "f1": at.f1, "volume": at.volume},
            {"alpha": at.alpha, "lobes": at.lobes},
        ),
        Graph("single_blend_encoder", model.blend_encoder, {"panels": (1, SINGLE_PANELS, *at.panorama)}, features),
        Graph("single_blend_decoder", model.blend_decoder, {**features, "mask": mask}, {"weight": mask}),
    ]


def _video_graphs(model: VideoModel) -> list[Graph]:
    at = _Shapes.of(model)
    mask, features = (1, 1, *at.panorama), {"f0": at.b0, "f1": at.b1}
    unit: Shape = (1, 3, 1, 1, 1)
    return [
        Graph("video_sg_encoder", model.sg_encoder, {"volume": at.volume, "unit": unit}, {"f0": at.f0, "f1": at.f1}),
        Graph(
            "video_sg_gru",
            _TwoGRUs(model.sg_gru0, model.sg_gru1),
            {"h0": at.f0, "h1": at.f1, "f0": at.f0, "f1": at.f1},
            {"h0_next": at.f0, "h1_next": at.f1},
        ),
        Graph(
            "video_sg_decoder",
            _MergingDecoder(model.sg_decoder),
            {
                "h0": at.f0,
                "h1": at.f1,
                "volume": at.volume,
                "alpha_previous": at.alpha,
                "lobes_previous": at.lobes,
                "unit": unit,
            },
            {"alpha": at.alpha, "lobes": at.lobes},
        ),
        Graph("video_blend_encoder", model.blend_encoder, {"panels": (1, VIDEO_PANELS, *at.panorama)}, features),
        Graph(
            "video_blend_gru",
            _TwoGRUs(model.blend_gru0, model.blend_gru1),
            {"h0": at.b0, "h1": at.b1, **features},
            {"h0_next": at.b0, "h1_next": at.b1},
        ),
        Graph("video_blend_decoder", model.blend_decoder, {"h0": at.b0, "h1": at.b1, "mask": mask}, {"weight": mask}),
    ]
