"""The loss relative to the fill of what was observed: easy rooms count as hard ones, harm counts twice."""

from dataclasses import replace

import pytest
import torch

from roomlight.errors import OptionError
from roomlight_model.training.batches import Batch
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.stages import EVEN, RELATIVE_SCALE, WORSE_WEIGHT, log_errors, log_l2_loss, relative_errors

SHAPE = (2, 1, 3, 4, 8)  # examples, probes, channels, rows, columns
FILL_ERROR = 0.25  # squared difference of the logarithms


def _batch(fill_error=(FILL_ERROR, FILL_ERROR)):
    """Two examples of black light, whose fills have these errors."""
    offset = torch.tensor(fill_error).sqrt().reshape(2, 1, 1, 1, 1)
    eye = torch.eye(3).expand(2, 3, 3)
    none = torch.zeros(2, 1, 3)
    return Batch(
        world_to_volume_rotation=eye, origins=none, to_viewer=none, lower_m=torch.zeros(2, 3), voxel_m=torch.ones(2, 3),
        volume=torch.zeros(2, 5, 1, 1, 1), truth=torch.zeros(SHAPE), partial=torch.expm1(offset.expand(SHAPE)),
    )  # fmt: skip


def _light(*errors):
    """Light with these errors against black."""
    return torch.expm1(torch.tensor(errors).sqrt().reshape(2, 1, 1, 1, 1).expand(SHAPE))


def _relative(error, fill):
    return RELATIVE_SCALE * (error + WORSE_WEIGHT * max(error - fill, 0)) / (fill + EVEN)


def test_errors_of_examples_have_the_mean_of_the_batch():
    light, truth = torch.rand(SHAPE), torch.rand(SHAPE)
    torch.testing.assert_close(log_errors(light, truth).mean(), log_l2_loss(light, truth))


@pytest.mark.parametrize("error", [0.0, FILL_ERROR, 2 * FILL_ERROR])
def test_error_beyond_the_fills_counts_twice(error):
    loss, _ = relative_errors(_light(error, error), _batch())
    assert float(loss) == pytest.approx(_relative(error, FILL_ERROR), rel=1e-4)


def test_an_easy_example_counts_as_much_as_a_hard_one():
    easy, hard = 0.5, 5.0
    half, _ = relative_errors(_light(easy / 2, hard / 2), _batch((easy, hard)))
    expected = (_relative(easy / 2, easy) + _relative(hard / 2, hard)) / 2
    assert float(half) == pytest.approx(expected, rel=1e-4)
    assert _relative(easy / 2, easy) == pytest.approx(_relative(hard / 2, hard), rel=0.05)


def test_the_fill_has_what_the_probe_keeps():
    batch = _batch()
    kept = replace(batch, before=torch.zeros(SHAPE), kept=torch.ones(2, 1, 1, 4, 8))
    _, weight = relative_errors(_light(0.1, 0.1), kept)
    torch.testing.assert_close(weight, torch.full((2,), RELATIVE_SCALE / EVEN))


@pytest.mark.parametrize("stage", ["single-sglv", "video-blend"])
def test_other_stages_have_no_fill_to_be_relative_to(stage):
    with pytest.raises(OptionError, match=f"relative needs the stage single-blend or single-joint, not {stage}"):
        TrainOptions(stage=stage, relative=True, frames=2)
