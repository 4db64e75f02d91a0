"""Opening graphs does not change the caller's thread; unavailable providers are refused by name."""

import numpy as np
import pytest

from roomlight.engine.networks import providers
from roomlight.engine.networks.providers import open_graph, resolve_provider
from roomlight.errors import ModelError


def test_opening_a_graph_does_not_switch_the_callers_denormals(tiny_video):
    tiny = np.array([1e-310, 3e-40])
    open_graph(tiny_video[1] / "single_sg_encoder.onnx", "cpu")
    assert (tiny * 0.5 > 0).all()
    assert np.float32(3e-40) * np.float32(0.5) > 0


def test_a_file_that_is_no_graph_is_refused_by_name(tmp_path):
    path = tmp_path / "broken.onnx"
    path.write_bytes(b"not a graph")
    with pytest.raises(ModelError, match=r"broken\.onnx"):
        open_graph(path, "cpu")


def test_auto_is_openvino_only_where_it_is_supported(monkeypatch):
    monkeypatch.setattr(providers, "openvino_device", lambda: None)
    assert resolve_provider("auto") == "cpu"
    assert resolve_provider("cpu") == "cpu"
    with pytest.raises(ModelError, match="openvino"):
        resolve_provider("openvino")
    monkeypatch.setattr(providers, "openvino_device", object)
    assert resolve_provider("auto") == "openvino"
