"""The run loop, on a stage that costs nothing: it resumes to the same curve after a stop or a kill, and refuses
unusable options and folders.
"""

import json
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from roomlight.errors import ModelError, OptionError, OutputError
from roomlight_model.checkpoint import Checkpoint, load_checkpoint
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.config import ModelConfig
from roomlight_model.training.clipping import ClippingBatch, ClippingOptions
from roomlight_model.training.loop import Run, learning_rate
from roomlight_model.training.run_folder import LAST, RunFolder
from tiny_stages import VIEWS, WALKS, logged

SMALL = ClippingOptions(steps=6, batch=2, learning_rate=0.005, seed=5, validate_steps=3)


class SmallStage:
    """The network of clipped radiance on squares of 32 pixels."""

    def __init__(self, options=SMALL, *, examples=6, data=None, start_seed=0, scored=True, factor=1.0):
        self.options, self.device, self.piece_size = options, torch.device("cpu"), 1
        self.data = data or [{"seed": 3, "sequences": examples}]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(start_seed)
            self.start_from = Checkpoint("clipping", ModelConfig(), ClippingNetwork(), {"steps": 1})
        self._planes = torch.from_numpy(np.random.default_rng(0).random((examples, 11, 32, 32)).astype(np.float32))
        self._scored, self._factor = scored, factor

    def __len__(self):
        return len(self._planes)

    def network(self):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            network = ClippingNetwork()
        network.room.requires_grad_(False)
        return network

    def batch(self, step):
        drawn = [index for index, _ in self.options.draw_examples(len(self), step)]
        planes = self._planes[drawn] + 0.01 * float(self.options.rng(step).normal())
        return ClippingBatch(planes, torch.zeros(len(drawn), 3, 16, 16), torch.ones(len(drawn), 1, 16, 16))

    def losses(self, network, batch, generator):
        noise = 0.01 * torch.randn(1, generator=generator)
        error = (network(batch.planes) - 2 - noise).square().mean()
        return {"loss": self._factor * error, "half": error / 2}

    def scores(self, network):
        assert not network.training
        with torch.no_grad():
            return {"loss": float((network(self._planes) - 2).square().mean())} if self._scored else {}

    def draw(self, _, path):
        path.parent.mkdir(exist_ok=True)
        path.write_text("a picture")


def run_of(folder, options=SMALL, *, stop_after=None, **changes):
    run = Run(SmallStage(options, **changes), folder)
    run.train(stop=lambda: run.step == stop_after)
    return run


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("run") / "whole")


def test_a_run_leaves_weights_scores_curves_and_pictures(finished):
    folder = finished.folder.path
    files = {"best.pt", "last.pt", "log.jsonl", "model.pt", "options.json", "pictures", "tensorboard"}
    assert {path.name for path in folder.iterdir()} == files
    assert [path.name for path in sorted((folder / "pictures").iterdir())] == [f"000000{k}.png" for k in (3, 6)]
    assert any((folder / "tensorboard").iterdir())
    scored = [entry["scores"]["loss"] for entry in logged(folder) if "scores" in entry]
    assert len(scored) == 2
    assert scored[-1] < scored[0]
    card = load_checkpoint(folder / "model.pt").card
    assert (card["stage"], card["steps"], card["examples"], card["seed"]) == ("clipping", 6, 6, 5)
    assert card["data"] == [{"seed": 3, "sequences": 6}]
    assert card["before"] == {"steps": 1}
    assert card["scores"]["loss"] == scored[-1]
    assert load_checkpoint(folder / "best.pt").card["scores"]["loss"] == min(scored)
    for name, value in load_checkpoint(folder / "model.pt").model.state_dict().items():
        torch.testing.assert_close(value, finished.average[name], rtol=0, atol=0)


@pytest.mark.parametrize("stop_after", [2, 3])
def test_a_stopped_run_goes_on_to_the_same_weights(finished, tmp_path, stop_after):
    assert run_of(tmp_path / "run", stop_after=stop_after).step == stop_after
    card = load_checkpoint(tmp_path / "run" / "model.pt").card
    assert card["steps"] == stop_after
    assert card["scores"]["loss"] > 0
    assert (tmp_path / "run" / "best.pt").exists() == (stop_after == 3)
    resumed = run_of(tmp_path / "run")
    curves = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert [event.step for event in curves.Scalars("held out/loss")] == sorted({stop_after, 3, 6})
    kept = [entry for entry in logged(tmp_path / "run") if entry["step"] != stop_after or stop_after == 3]
    assert kept == logged(finished.folder.path)
    for name, value in resumed.network.state_dict().items():
        assert value.equal(finished.network.state_dict()[name]), name
        assert resumed.average[name].equal(finished.average[name]), name


SCRIPT = textwrap.dedent("""
    import sys
    from pathlib import Path
    import test_loop as t

    class Waiting(t.SmallStage):
        def batch(self, step):
            if step == 4:
                print("waiting", flush=True)
                sys.stdin.readline()
            return super().batch(step)

    run = t.Run(Waiting(), Path(sys.argv[1]))
    run.train(checkpoint_s=0.0)
""")


@pytest.mark.slow
def test_a_killed_run_repeats_the_curve_of_a_whole_one(finished, tmp_path):
    """It is killed while step 4 waits for its batch."""
    folder, environment = tmp_path / "run", {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command, pipe = [sys.executable, "-c", SCRIPT, str(folder)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        while not (folder / LAST).exists():  # the steps before go on meanwhile
            assert process.poll() is None
        process.kill()
    resumed = run_of(folder)
    assert logged(folder) == logged(finished.folder.path)
    for name, value in resumed.average.items():
        assert value.equal(finished.average[name]), name


def test_sigterm_ends_the_run_of_this_process(tmp_path):
    run = Run(SmallStage(), tmp_path / "run")
    before = signal.getsignal(signal.SIGTERM)

    reported = []

    def send(progress):
        reported.append(progress.step)
        if progress.step == 3:
            signal.raise_signal(signal.SIGTERM)

    run.train(report=send)
    assert run.step == 3
    assert reported[:3] == [1, 2, 3]
    assert signal.getsignal(signal.SIGTERM) is before


def test_lost_steps_are_logged_once(finished, tmp_path):
    """Steps after the last saved state run again: their earlier lines, the last one cut off, are left out."""
    folder = tmp_path / "run"
    run_of(folder, stop_after=3)
    with (folder / "log.jsonl").open("a") as log:
        log.write('{"step": 4, "loss": 9}\n{"step": 5, "lo')
    run_of(folder)
    assert logged(folder) == logged(finished.folder.path)


def test_a_finished_run_is_left_as_it_is(finished, tmp_path):
    folder = finished.folder.path
    before = logged(folder)
    assert RunFolder(folder).is_finished(SMALL)
    assert not RunFolder(folder).is_finished(replace(SMALL, steps=9))
    assert not RunFolder(tmp_path / "other").is_finished(SMALL)
    run_of(folder)
    assert logged(folder) == before


def test_a_run_can_be_extended_and_continued_after_its_time(tmp_path):
    run = Run(SmallStage(), tmp_path / "run")
    run.train(minutes=0.0)
    assert run.step == 0
    assert run_of(tmp_path / "run", stop_after=2).step == 2
    assert not RunFolder(tmp_path / "run").is_finished(replace(SMALL, steps=2))
    run_of(tmp_path / "run", replace(SMALL, steps=2))
    assert load_checkpoint(tmp_path / "run" / "best.pt").card["steps"] == 2
    assert run_of(tmp_path / "run", replace(SMALL, steps=3, validate_steps=5)).step == 3
    assert json.loads((tmp_path / "run" / "options.json").read_text())["steps"] == 3


def test_a_run_without_held_out_examples_has_no_best_weights(tmp_path):
    run_of(tmp_path / "run", scored=False)
    assert load_checkpoint(tmp_path / "run" / "model.pt").card["steps"] == 6
    assert not (tmp_path / "run" / "best.pt").exists()


def test_only_a_better_score_replaces_the_best(tmp_path):
    folder, network = RunFolder(tmp_path), ClippingNetwork()
    assert not folder.keep_best(network, {"scores": {"loss": float("nan")}})
    assert folder.keep_best(network, {"scores": {"loss": 0.5}})
    assert not folder.keep_best(network, {"scores": {"loss": float("nan")}})
    assert not folder.keep_best(network, {"scores": {"loss": 0.6}})
    assert folder.keep_best(network, {"scores": {"loss": 0.4}})
    assert load_checkpoint(tmp_path / "best.pt").card["scores"]["loss"] == 0.4


@pytest.mark.parametrize("change", [{"seed": 6}, {"batch": 3}, {"learning_rate": 0.01}, {"ema": 0.5}])
def test_other_options_are_refused_by_name(change, finished):
    folder = finished.folder.path
    before = (folder / "options.json").read_bytes()
    with pytest.raises(ModelError, match=rf"other options \({next(iter(change))}\)"):
        Run(SmallStage(replace(SMALL, **change)), folder)
    with pytest.raises(ModelError, match=rf"other options \({next(iter(change))}\)"):
        RunFolder(folder).is_finished(replace(SMALL, **change))
    for data in ([{"seed": 3, "sequences": 7}], [{"seed": 4, "sequences": 6, "frames": 3}], []):
        with pytest.raises(ModelError, match=r"other options \(data\)"):
            RunFolder(folder).is_finished(SMALL, data=data)
    with pytest.raises(ModelError, match=r"other options \(data\); delete the folder to train the stage again"):
        Run(SmallStage(examples=7), folder)
    with pytest.raises(ModelError, match=r"started from other weights \(start_from\); delete the folder"):
        Run(SmallStage(start_seed=1), folder)
    with pytest.raises(ModelError, match="started from other weights"):
        RunFolder(folder).is_finished(SMALL, start_from=None)
    assert (folder / "options.json").read_bytes() == before


def test_a_folder_with_other_files_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(OutputError, match="holds other files"):
        Run(SmallStage(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_too_few_examples_are_refused(tmp_path):
    with pytest.raises(ModelError, match=r"stage clipping has 6 examples, fewer than its batch of 7; give"):
        Run(SmallStage(replace(SMALL, batch=7)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_damaged_state_or_that_of_another_version_names_the_remedy(tmp_path):
    Run(SmallStage(), tmp_path / "run")
    for content in (b"", b"nonsense", b"PK\x03\x04 damaged"):
        (tmp_path / "run" / LAST).write_bytes(content)
        with pytest.raises(ModelError, match=r"last\.pt: cannot be resumed from \(it is cut off.*delete it"):
            Run(SmallStage(), tmp_path / "run")
    torch.save({"step": 3}, tmp_path / "run" / LAST)
    with pytest.raises(ModelError, match=r"last\.pt: cannot be resumed from \('network'\); delete it"):
        Run(SmallStage(), tmp_path / "run")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is damaged"),
        ("[1]", "no run of this version"),
        ('{"stage": "clipping", "steps": 8}', "no run of this version"),
    ],
)
def test_options_that_are_damaged_or_of_another_version_are_refused(content, message, tmp_path):
    (tmp_path / "options.json").write_text(content)
    with pytest.raises(ModelError, match=rf"options\.json: .*{message}.*another folder"):
        Run(SmallStage(), tmp_path)
    assert (tmp_path / "options.json").read_text() == content


def test_a_loss_or_gradient_that_is_not_finite_ends_the_run(tmp_path):
    with pytest.raises(ModelError, match=r"the loss is nan at step 0; use a lower learning rate"):
        run_of(tmp_path / "run", factor=float("nan"))
    with pytest.raises(ModelError, match=r"the gradient's norm is inf at step 0; use a lower learning rate"):
        run_of(tmp_path / "gradient", factor=1e37)


def test_the_learning_rate_warms_up_and_falls_to_a_hundredth():
    options = replace(SMALL, learning_rate=0.5, warm_up=10, steps=110)
    rates = [learning_rate(options, step) for step in range(111)]
    assert rates[0] == pytest.approx(0.05)
    assert max(rates) == rates[10] == 0.5
    assert rates[60] == pytest.approx(0.5 * 0.505)
    assert rates[110] == pytest.approx(0.005)


def test_an_epoch_has_every_example_once():
    drawn = [index for step in range(6) for index, _ in replace(SMALL, batch=4).draw_examples(12, step)]
    assert sorted(drawn[:12]) == sorted(drawn[12:]) == list(range(12))
    assert drawn[:12] != drawn[12:]


@pytest.mark.parametrize(
    ("options", "change", "message"),
    [
        (SMALL, {"steps": 0}, "steps is 0; it must be 1 or more"),
        (SMALL, {"learning_rate": 0.0}, r"learning_rate is 0\.0; it must be above 0 to 1"),
        (SMALL, {"ema": 1.1}, r"ema is 1\.1; it must be 0 to 1"),
        (SMALL, {"seed": -1}, "seed is -1; it must be 0 or more"),
        (VIEWS, {"surround_max": -0.1}, r"surround_max is -0\.1; it must be 0 to 100"),
        (VIEWS, {"volume_shape": (4, 30, 42)}, "volume_shape"),
        (VIEWS, {"panorama_height": 61}, "panorama_height is 61; it must be even"),
        (WALKS, {"frames": 1}, "frames is 1; it must be 2 or more"),
        (WALKS, {"revisits": 1.5}, r"revisits is 1\.5; it must be 0 to 1"),
    ],
)
def test_options_out_of_range_are_refused(options, change, message):
    with pytest.raises(OptionError, match=message):
        replace(options, **change)
