"""The networks' configuration: JSON round trip, and every way it can be refused."""

import json
import subprocess
import sys

import pytest

from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import ModelError
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig


def test_it_survives_json_and_missing_fields_take_defaults():
    config = ModelConfig(
        SGConfig(volume_shape=(17, 14, 23), channels=8, full_channels=4),
        BlendConfig(height=24, channels=4, full_channels=2),
    )
    assert ModelConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert ModelConfig.from_dict({"sg": {"channels": 16}}) == ModelConfig(sg=SGConfig(channels=16))


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ([1, 2], r"\[1, 2\]"),
        ({"sg": 3}, "version: sg: .*got 3"),
        ({"sg": {1, 2}}, "not JSON"),
        ({"head": {}}, "head"),
        ({"sg": {"depth": 3}}, "sg.depth"),
        ({"sg": {"channels": "many"}}, "sg.channels: .*integer.*got 'many'"),
        ({"sg": {"channels": True}}, "sg.channels"),
        ({"sg": {"channels": 30}}, "multiple of 4"),
        ({"sg": {"channels": 0}}, "multiple of 4"),
        ({"sg": {"volume_shape": [64, 60]}}, "volume_shape"),
        ({"sg": {"volume_shape": [64, 60, 4]}}, "volume_shape"),
        ({"sg": {"volume_shape": [64, 60, 84.5]}}, "volume_shape"),
        ({"sg": {"full_channels": 0}}, "full_channels"),
        ({"blend": {"height": 121}}, "height"),
        ({"blend": {"channels": 0}}, "widths"),
    ],
)
def test_refuses(values, named):
    with pytest.raises(ModelError, match=named):
        ModelConfig.from_dict(values)


def test_configuration_needs_no_pytorch():
    code = "import sys, roomlight_model, roomlight_model.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_was_an_option_is_read_from_older_weights_with_the_value_that_is_left():
    described = json.loads((SHIPPED / "single" / "model.json").read_text())["config"]
    assert described["sg"]["units"] == "first"
    config = ModelConfig.from_dict(described)
    assert set(config.to_dict()["sg"]) < set(described["sg"])
    for part, key, value in (("sg", "units", "own"), ("sg", "full_layers", 2), ("blend", "filled", False)):
        older = {**described, part: {**described[part], key: value}}
        with pytest.raises(ModelError, match=rf"{part}.{key}: .*{value!r}"):
            ModelConfig.from_dict(older)
