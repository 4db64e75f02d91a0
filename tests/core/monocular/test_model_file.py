"""Depth models of the user's: tiny graphs with the conventions of published exports, and what is refused by name."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.errors import FrameError, ModelError
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.model_file import DepthModelFile
from roomlight.monocular.stream import DepthStream

TRUTH = exact_depth(pose(0.3), LENS.resized(SIZE[1], SIZE[0])).astype(np.float64)


def run(path: Path) -> tuple[DepthModelFile, np.ndarray]:
    """Return the model and 1 / what it answers on the room's picture."""
    model = DepthModelFile(path)
    answer = model.estimate(srgb_picture(frame(0, pose(0.3))), LENS)
    return model, answer.inverse


Graph = dict[str, Any]
ZEROS, LENS_OF = np.zeros((1, 1, *SIZE)), np.eye(3)[None]
SMALL = LENS.resized(SIZE[1], SIZE[0])
POINTS = SMALL.rays() * np.array([1, -1, -1]) * TRUTH[..., None]


def of_focal_length(focal_px: float) -> np.ndarray:
    """The room's depth as a network answers that is for this focal length."""
    return TRUTH[None] * focal_px / (LENS.fx * np.sqrt(SIZE[1] / LENS.width * SIZE[0] / LENS.height))


@pytest.mark.parametrize(
    ("name", "outputs", "graph", "kind"),
    [
        ("depth_anything_v2_metric_indoor", {"predicted_depth": TRUTH[None]}, {}, "metric"),
        ("depth_anything_v2_vits_indoor_dynamic", {"depth": TRUTH[None]}, {}, "metric"),
        ("depth_pro", {"predicted_depth": TRUTH[None], "focallength_px": np.array([300.0])}, {}, "metric"),
        ("unidepth", {"depth": TRUTH[None, None], "confidence": ZEROS, "intrinsics": LENS_OF}, {}, "metric"),
        ("u", {"out_K": LENS_OF, "depth": TRUTH[None, None], "depth_ssi": ZEROS, "confidence": ZEROS}, {}, "metric"),
        (  # the coordinates first
            "u",
            {"pts_3d": np.moveaxis(POINTS, -1, 0)[None], "confidence": ZEROS, "intrinsics": LENS_OF},
            {"picture": "rgbs"},
            "metric",
        ),
        ("da3", {"depth": TRUTH[None, None], "depth_conf": ZEROS + 1}, {"shape": (1, 1, 3, *SIZE)}, "scale"),
        ("da3_large", {"depth": TRUTH[None, None], "sky": ZEROS, "intrinsics": LENS_OF}, {}, "scale"),
        ("da3_nested_metric", {"depth": TRUTH[None, None], "sky": ZEROS}, {}, "metric"),
        ("da3metric_large", {"depth": of_focal_length(300), "sky": ZEROS}, {}, "metric"),
        ("metric3d_vit_small", {"pred_depth": of_focal_length(1000)}, {}, "metric"),
        (
            "vit_small",
            {"predicted_depth": of_focal_length(1000), "predicted_normal": np.zeros((1, 3, *SIZE))},
            {},
            "metric",
        ),
    ],
)
def test_exports_are_told_by_their_names_and_outputs(
    tmp_path: Path, name: str, outputs: dict[str, np.ndarray], graph: Graph, kind: str
) -> None:
    model, inverse = run(write_depth_model(tmp_path / f"{name}.onnx", outputs, **graph))
    assert model.kind == kind
    assert np.allclose(inverse, 1 / TRUTH, rtol=1e-4)


def test_relative_depth_is_inverse(tmp_path: Path) -> None:
    model, inverse = run(write_depth_model(tmp_path / "depth_anything_v2_vits.onnx", {"depth": (7 / TRUTH + 2)[None]}))
    assert model.kind == "inverse"
    assert np.allclose(inverse, 7 / TRUTH + 2, rtol=1e-4)


@pytest.mark.parametrize("metric_scale", [None, 2.0])
def test_points_get_their_shift_from_the_lens(tmp_path: Path, metric_scale: float | None) -> None:
    points = POINTS - [0, 0, 0.9]  # MoGe's points are known up to a shift along z
    outputs = {"points": points[None] / (metric_scale or 1), "mask": np.ones((1, *SIZE))}
    if metric_scale:
        outputs["metric_scale"] = np.array([metric_scale])
    tokens = {"num_tokens": (TensorProto.INT64, ())}
    model, inverse = run(write_depth_model(tmp_path / "moge.onnx", outputs, picture="image", others=tokens))
    assert model.kind == ("metric" if metric_scale else "scale")
    assert np.allclose(inverse, 1 / TRUTH, rtol=2e-2)


def test_unidepth_takes_the_lens(tmp_path: Path) -> None:
    """The graph multiplies depth by K's first entry, so that the answer shows the K that it was given."""
    picture = helper.make_tensor_value_info("rgbs", TensorProto.FLOAT, [1, 3, *SIZE])
    lens = helper.make_tensor_value_info("K", TensorProto.FLOAT, [1, 3, 3])
    depth = numpy_helper.from_array((TRUTH / SMALL.fx)[None, None].astype(np.float32), "canonical")
    index = numpy_helper.from_array(np.array([0, 0, 0]), "first")
    nodes = [
        helper.make_node("GatherND", ["K", "first"], ["fx"]),
        helper.make_node("Mul", ["canonical", "fx"], ["depth"]),
    ]
    info = helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, 1, *SIZE])
    graph = helper.make_graph(nodes, "unidepth", [picture, lens], [info], [depth, index])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), tmp_path / "u.onnx")
    model, inverse = run(tmp_path / "u.onnx")
    assert model.kind == "metric"
    assert np.allclose(inverse, 1 / TRUTH, rtol=1e-4)


def halves(left: float, right: float) -> np.ndarray:
    picture = np.full((240, 320, 3), right, np.float32)
    picture[:, :160] = left
    return picture


@pytest.mark.parametrize(
    ("name", "output", "others", "wanted"),
    [
        ("v2_indoor", "depth", {}, (0.5 - 0.485) / 0.229),
        ("depth_pro", "depth", {"focallength_px": np.array([300.0])}, 0.0),
        ("unidepth", "depth", {"out_K": LENS_OF}, (0.5 - 0.485) / 0.229),
        ("unidepth", "pts_3d", {}, (0.5 - 0.406) / 0.225),
        ("metric3d", "depth", {"predicted_normal": np.zeros((1, 3, *SIZE))}, 127.5),
    ],
)
def test_pictures_are_normalised_as_the_exports_take_them(
    tmp_path: Path, name: str, output: str, others: dict[str, np.ndarray], wanted: float
) -> None:
    """The graph answers with the colour that it was given, and 5 more, so that this is a depth."""
    path = _echo(tmp_path / f"{name}.onnx", shape=(1, 3, *SIZE), name=output, others=others, more=5.0)
    focal = np.sqrt(LENS.fx * SIZE[1] / LENS.width * LENS.fy * SIZE[0] / LENS.height)
    scale = focal / 1000 if name == "metric3d" else 1.0
    answer = DepthModelFile(path).estimate(halves(0.4, 0.5), LENS).inverse
    assert 1 / answer[0, -1] == pytest.approx((wanted + 5) * scale, rel=1e-4)


def _echo(
    path: Path,
    *,
    shape: tuple[int | str, ...],
    kind: int = TensorProto.FLOAT,
    others: dict[str, np.ndarray] | None = None,
    name: str = "depth",
    more: float = 0.0,
) -> Path:
    """Write a graph whose depth is the picture's first channel, and `more`; whose points are all three."""
    picture = helper.make_tensor_value_info("image", kind, list(shape))
    channel = shape.index(3)
    bounds = (("a", 0), ("b", 1), ("c", channel))
    axes = [numpy_helper.from_array(np.array([bound]), name) for name, bound in bounds]
    axes += [numpy_helper.from_array(np.array(more, np.float32), "more")]
    axes += [numpy_helper.from_array(value.astype(np.float32), f"{key}_value") for key, value in (others or {}).items()]
    nodes = [
        helper.make_node("Cast", ["image"], ["cast"], to=TensorProto.FLOAT),
        helper.make_node("Slice", ["cast", "a", "b", "c"], ["red"]),
        helper.make_node("Add", ["red" if name == "depth" else "cast", "more"], [name]),
        *(helper.make_node("Identity", [f"{key}_value"], [key]) for key in others or {}),
    ]
    size = [1 if size == 3 and name == "depth" else size for size in shape]
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, size)]
    infos += [helper.make_tensor_value_info(k, TensorProto.FLOAT, list(v.shape)) for k, v in (others or {}).items()]
    graph = helper.make_graph(nodes, "echo", [picture], infos, axes)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_the_sidecar_states_size_and_normalisation(tmp_path: Path) -> None:
    path = _echo(tmp_path / "own.onnx", shape=(1, 3, "height", "width"), kind=TensorProto.FLOAT16)
    stated = {"kind": "inverse", "size": 98, "mean": [10, 0, 0], "deviation": [2, 1, 1], "white": 255}
    path.with_suffix(".json").write_text(json.dumps(stated))
    answer = DepthModelFile(path).estimate(halves(0.25, 0.5), LENS).inverse
    assert answer.shape == (70, 98)  # the longest side as stated, both multiples of 14
    assert answer[0, 0] == pytest.approx((0.25 * 255 - 10) / 2, rel=1e-2)
    assert answer[0, -1] == pytest.approx((0.5 * 255 - 10) / 2, rel=1e-2)


@pytest.mark.parametrize("shape", [(1, 3, *SIZE), (1, *SIZE, 3), (1, "height", "width", 3)])
@pytest.mark.parametrize("kind", [TensorProto.UINT8, TensorProto.INT32])
def test_whole_numbers_and_channels_last_get_the_picture_from_0_to_255(
    tmp_path: Path, shape: tuple[int | str, ...], kind: int
) -> None:
    path = _echo(tmp_path / "own.onnx", shape=shape, kind=kind)
    path.with_suffix(".json").write_text(json.dumps({"kind": "inverse"}))
    answer = DepthModelFile(path).estimate(halves(0.25, 0.5) * np.array([1, 0, 0], np.float32), LENS).inverse
    assert (answer[0, 0], answer[0, -1]) == (64, 128)


def test_depth_that_contradicts_the_metric_model_is_refused(tmp_path: Path) -> None:
    metric = DepthModelFile(write_depth_model(tmp_path / "metric.onnx", {"depth": TRUTH[None]}))
    far_is_large = DepthModelFile(write_depth_model(tmp_path / "relative.onnx", {"depth": TRUTH[None]}))
    with pytest.raises(FrameError, match=r"relative\.onnx \(its depth as 1 / depth\) contradicts .* check `kind`"):
        DepthStream(far_is_large, metric).complete(frame(0, pose(0.3)))


def test_a_stream_scales_relative_depth_by_a_metric_model(tmp_path: Path) -> None:
    metric = DepthModelFile(write_depth_model(tmp_path / "metric.onnx", {"depth": TRUTH[None]}))
    relative = DepthModelFile(write_depth_model(tmp_path / "relative.onnx", {"depth": (7 / TRUTH + 2)[None]}))
    completed = DepthStream(relative, metric).complete(frame(0, pose(0.3)))
    assert np.median(np.abs(completed.depth_m / exact_depth(pose(0.3)) - 1)) < 0.02


@pytest.mark.parametrize(
    ("outputs", "graph", "sidecar", "message"),
    [
        ({"depth": TRUTH[None]}, {"shape": (1, 4, *SIZE)}, None, r"no input is a picture .* pixel_values \[1, 4"),
        ({"a": TRUTH[None], "b": TRUTH[None]}, {}, None, "which of its outputs a, b is depth is not known"),
        ({"answer": TRUTH[None]}, {}, None, "whether its output answer is depth or 1 / depth is not known"),
        ({"depth": TRUTH[None]}, {}, {"output": "deep"}, "has no output deep, only depth"),
        ({"depth": TRUTH[None]}, {}, {"kind": "metres"}, "kind: .*metres"),
        ({"depth": TRUTH[None]}, {}, {"sise": 3}, "sise: .*known: kind, output"),
        ({"depth": TRUTH[None]}, {}, {"size": 3}, "size: .*got 3"),
        ({"depth": TRUTH[None]}, {"shape": (1, 32, 3, *SIZE)}, None, r"picture is \[1, 32, .*one picture at a time"),
        ({"depth": TRUTH.T[None]}, {}, None, "its output depth is 28 x 42 for a picture of 42 x 28: another aspect"),
        ({"depth": 1000 * TRUTH[None]}, {}, {"kind": "metric"}, "no metres; state its `kind` in bad.json: scale"),
        ({"depth": -TRUTH[None]}, {}, {"kind": "scale"}, "median of its output depth is -.*no depth"),
        ({"depth": TRUTH[None]}, {"others": {"K": (TensorProto.FLOAT, (1, 4, 4))}}, None, "its input K is .*3 x 3"),
        ({"depth": TRUTH[None]}, {"others": {"text": (TensorProto.FLOAT, (1,))}}, None, "its input text is not known"),
        ({"depth": TRUTH[None]}, {"kind": TensorProto.DOUBLE}, None, "the type of its input pixel_values is none of"),
        ({"depth": np.ones((1, *SIZE))}, {}, None, "its output depth is constant or not finite"),
        ({"depth": np.full((1, *SIZE), np.nan)}, {}, None, "its output depth is constant or not finite"),
        ({"depth": np.ones((1, 2, *SIZE))}, {}, None, r"its output depth has the shape \(1, 2, 28, 42\), not \[h, w\]"),
        ({"depth": TRUTH[None]}, {"shape": (1, 3, 4000, 28)}, None, "its picture is 28 x 4000; at most 2048"),
    ],
)
def test_a_bad_model_is_refused_by_what_is_wrong(
    tmp_path: Path, outputs: dict[str, np.ndarray], graph: Graph, sidecar: Graph | None, message: str
) -> None:
    path = write_depth_model(tmp_path / "bad.onnx", outputs, **graph)
    if sidecar is not None:
        path.with_suffix(".json").write_text(json.dumps(sidecar))
    with pytest.raises(ModelError, match=message) as raised:
        run(path)
    assert "bad." in str(raised.value)


def test_what_is_no_graph_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="there is no such depth model"):
        DepthModelFile(tmp_path / "absent.onnx")
    (tmp_path / "text.onnx").write_text("not a graph")
    with pytest.raises(ModelError, match=r"text\.onnx: ONNX Runtime cannot load it"):
        DepthModelFile(tmp_path / "text.onnx")
