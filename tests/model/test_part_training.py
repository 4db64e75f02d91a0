"""The small networks that serve every model: examples, learning, resuming, checkpoints."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from roomlight.compositing.light.object_light import OBJECT_PANELS
from roomlight.conventions import panorama_directions
from roomlight.engine.networks.clipping import SIDE
from roomlight.engine.networks.graphs import PartForm
from roomlight.engine.panorama.panels import HEIGHT, PANELS
from roomlight.errors import DatasetError, ModelError, OptionError, OutputError
from roomlight_evaluation.objects.lit_objects import LOOKS as EVALUATED
from roomlight_evaluation.objects.lit_objects import LitObjects
from roomlight_model.clipping_network import LOG_RANGE, ClippingNetwork, clipping_input_shape
from roomlight_model.completion_network import CompletionNetwork
from roomlight_model.part_checkpoint import is_part_checkpoint, load_part_checkpoint, save_part_checkpoint
from roomlight_model.training.clipping_examples import CLIPPED, ClippingFrames, clipping_batch
from roomlight_model.training.clipping_stage import ClippingStage
from roomlight_model.training.completion_examples import CompletionExamples, completion_batch
from roomlight_model.training.completion_stage import CompletionStage, completed
from roomlight_model.training.objects_stage import LOOKS, ObjectsStage, lights, look_errors
from roomlight_model.training.part_trainer import PartOptions, PartTrainer
from roomlight_model.training.trainer import LAST

SMALL = PartOptions(steps=8, batch=2, learning_rate=0.02, seed=5)


class SmallStage:
    """The network of clipped radiance on squares of 32 pixels: the trainer's own behaviour costs nothing there."""

    def __init__(self, form: PartForm = "clipping"):
        self._form: PartForm = form
        self._planes = torch.from_numpy(np.random.default_rng(0).random((6, 11, 32, 32)).astype(np.float32))

    @property
    def form(self) -> PartForm:
        return self._form

    def network(self):
        return ClippingNetwork() if self.form == "clipping" else CompletionNetwork()

    def __len__(self):
        return 6

    def loss(self, network, chosen, rng):
        return (network(self._planes[chosen]) - 2 - 0.01 * rng.normal()).square().mean()

    def scores(self, network):
        with torch.no_grad():
            return {"loss": float((network(self._planes) - 2).square().mean())}


def lines(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def train(folder, options=SMALL, stage=None, **arguments):
    trainer = PartTrainer(stage or SmallStage(), options, folder)
    trainer.train(**{"report": lambda _: None, "every_steps": 2, **arguments})
    return trainer


def after(steps):
    """Stop after this many steps: the trainer asks before each."""
    asked = iter(range(steps + 1))
    return lambda: next(asked) >= steps


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "whole"
    return train(folder)


def test_a_run_leaves_weights_scores_and_a_curve(finished):
    folder = finished.out
    assert sorted(path.name for path in folder.iterdir()) == [
        "best.pt", "last.pt", "log.jsonl", "model.pt", "options.json",
    ]  # fmt: skip
    assert [line["step"] for line in lines(folder)] == [2, 4, 6, 8]
    card = load_part_checkpoint(folder / "model.pt").card
    assert (card["stage"], card["steps"], card["examples"], card["seed"]) == ("clipping", 8, 6, 5)
    scores = [line["scores"]["loss"] for line in lines(folder)]
    assert load_part_checkpoint(folder / "best.pt").card["scores"]["loss"] == min(scores)
    assert scores[-1] < scores[0]


def test_a_resumed_run_repeats_the_curve(finished, tmp_path):
    assert train(tmp_path / "run", stop=after(4)).step == 4
    resumed = train(tmp_path / "run")
    assert lines(tmp_path / "run") == lines(finished.out)
    for name, value in resumed.network.state_dict().items():
        assert value.equal(finished.network.state_dict()[name]), name
        assert resumed.average[name].equal(finished.average[name]), name


def test_a_killed_run_logs_its_lost_steps_once(finished, tmp_path):
    """Steps after the last saved state run again: their earlier lines, the last one cut off, are left out."""
    folder = tmp_path / "run"
    train(folder, stop=after(2))
    with (folder / "log.jsonl").open("a") as log:
        log.write('{"step": 4, "loss": 9}\n{"step": 6, "lo')
    train(folder)
    assert lines(folder) == lines(finished.out)


def test_a_stopped_run_has_scored_weights(tmp_path):
    trainer = train(tmp_path / "run", every_steps=1000, stop=after(3))
    card = load_part_checkpoint(tmp_path / "run" / "model.pt").card
    assert card["steps"] == trainer.step == 3
    assert card["scores"]["loss"] > 0


@pytest.mark.parametrize("change", [{"seed": 6}, {"batch": 3}, {"learning_rate": 0.01}, {"ema": 0.5}])
def test_other_options_are_refused(change, finished):
    before = (finished.out / "options.json").read_bytes()
    with pytest.raises(ModelError, match=rf"other options \({next(iter(change))}\)"):
        PartTrainer(SmallStage(), replace(SMALL, **change), finished.out)
    assert (finished.out / "options.json").read_bytes() == before


def test_another_stage_in_the_folder_is_refused(finished):
    with pytest.raises(ModelError, match=r"other options \(stage\)"):
        PartTrainer(SmallStage("completion"), SMALL, finished.out)


def test_more_steps_continue_a_finished_run(tmp_path):
    train(tmp_path / "run", replace(SMALL, steps=2))
    assert train(tmp_path / "run", replace(SMALL, steps=3)).step == 3


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "cat.jpg").write_text("")
    with pytest.raises(OutputError, match="holds other files"):
        PartTrainer(SmallStage(), SMALL, tmp_path)


def test_too_few_examples_are_refused(tmp_path):
    with pytest.raises(ModelError, match="6 examples are fewer than a batch of 7"):
        PartTrainer(SmallStage(), replace(SMALL, batch=7), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04 damaged"])
def test_a_damaged_state_names_the_remedy(content, tmp_path):
    train(tmp_path / "run", replace(SMALL, steps=1))
    (tmp_path / "run" / LAST).write_bytes(content)
    with pytest.raises(ModelError, match=r"last\.pt: cannot be resumed from .*delete it"):
        PartTrainer(SmallStage(), replace(SMALL, steps=1), tmp_path / "run")


@pytest.mark.parametrize("content", ["{", "[1]"])
def test_damaged_options_are_refused(content, tmp_path):
    (tmp_path / "options.json").write_text(content)
    with pytest.raises(ModelError, match=r"options\.json: .*another folder"):
        PartTrainer(SmallStage(), SMALL, tmp_path)


def test_a_loss_that_is_not_finite_ends_the_run(tmp_path):
    class Diverging(SmallStage):
        def loss(self, network, chosen, rng):
            return super().loss(network, chosen, rng) * float("nan")

    with pytest.raises(ModelError, match=r"the loss is nan at step 0; use a lower learning rate"):
        train(tmp_path / "run", stage=Diverging())


def test_training_starts_from_earlier_weights(finished, tmp_path):
    start = finished.out / "model.pt"
    trainer = PartTrainer(SmallStage(), SMALL, tmp_path / "run", start_from=start)
    for name, value in load_part_checkpoint(start).network.state_dict().items():
        assert trainer.network.state_dict()[name].equal(value)
    with pytest.raises(ModelError, match="holds a clipping network; this stage trains completion"):
        PartTrainer(SmallStage("completion"), SMALL, tmp_path / "other", start_from=start)


@pytest.mark.parametrize(
    "change", [{"steps": 0}, {"batch": 0}, {"learning_rate": 0.0}, {"learning_rate": 2.0}, {"ema": 1.1}, {"ema": -0.1}]
)
def test_options_out_of_range_are_refused(change):
    with pytest.raises(OptionError, match=str(next(iter(change.values())))):
        PartOptions(**change)


# --- checkpoints


def test_checkpoints_keep_form_weights_and_card(tmp_path):
    networks: dict[PartForm, torch.nn.Module] = {"clipping": ClippingNetwork(), "completion": CompletionNetwork()}
    for form, network in networks.items():
        path = tmp_path / f"{form}.pt"
        save_part_checkpoint(path, form, network, card={"steps": 3})
        assert is_part_checkpoint(path)
        loaded = load_part_checkpoint(path)
        assert (loaded.form, loaded.card, loaded.network.training) == (form, {"steps": 3}, False)
        assert all(value.equal(network.state_dict()[name]) for name, value in loaded.network.state_dict().items())


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04 damaged"])
def test_other_files_are_no_part_checkpoint(content, tmp_path):
    path = tmp_path / "weights.pt"
    path.write_bytes(content)
    assert not is_part_checkpoint(path)
    with pytest.raises(ModelError, match="not the checkpoint of a network of the form clipping, completion, objects"):
        load_part_checkpoint(path)


def test_checkpoints_of_other_networks_are_refused(tmp_path):
    path = tmp_path / "weights.pt"
    state = ClippingNetwork().state_dict()
    torch.save({"format": 1, "form": "single", "state": state, "card": {}}, path)
    assert not is_part_checkpoint(path)
    with pytest.raises(ModelError, match="form 'single' are not of this version"):
        load_part_checkpoint(path)
    torch.save({"format": 1, "form": "completion", "state": state, "card": {}}, path)
    with pytest.raises(ModelError, match="not the checkpoint"):
        load_part_checkpoint(path)


def test_weights_that_diverged_are_refused(tmp_path):
    network = ClippingNetwork()
    network.head.weight.data[0] = float("nan")
    save_part_checkpoint(tmp_path / "weights.pt", "clipping", network, card={})
    with pytest.raises(ModelError, match="NaN or infinity"):
        load_part_checkpoint(tmp_path / "weights.pt")


# --- the networks


def test_clipped_radiance_stays_in_its_range():
    torch.manual_seed(0)
    network = ClippingNetwork()
    planes = torch.rand(clipping_input_shape())
    assert network(planes).shape == (1, 3, SIDE // 2, SIDE // 2)
    network.head.weight.data *= 1e4
    found = network(planes)
    assert found.min() >= LOG_RANGE[0]
    assert found.max() <= LOG_RANGE[1]


def test_completion_begins_without_a_change():
    network = CompletionNetwork()
    panels = torch.rand(2, PANELS, HEIGHT, 2 * HEIGHT)
    assert (network(panels) == 0).all()


def test_completion_rotates_with_the_panorama():
    """By eight columns, the coarsest layer's; further ones would interpolate."""
    torch.manual_seed(1)
    network = CompletionNetwork()
    torch.nn.init.normal_(network.head.conv.weight, std=0.1)
    panels = torch.rand(1, PANELS, HEIGHT, 2 * HEIGHT)
    with torch.no_grad():
        rolled, found = network(panels.roll(8, 3)), network(panels).roll(8, 3)
    inner = torch.ones(2 * HEIGHT, dtype=torch.bool)
    inner[6:10] = False  # the last interpolation does not wrap around at the seam
    inner[-2:] = inner[:2] = False
    assert torch.allclose(rolled[..., inner], found[..., inner], atol=1e-5)
    assert found.std() > 0.01


# --- examples


def lamp_frames(count, *, bright=9.0):
    """Frames of a lamp on a grey wall; its radiance is told by how bright the wall is."""
    rng = np.random.default_rng(2)
    radiance = np.empty((count, 3, SIDE, SIDE), np.float16)
    for number in range(count):
        wall = rng.uniform(0.1, 0.5)
        radiance[number] = wall
        row, column = rng.integers(30, 100, 2)
        radiance[number, :, row : row + 30, column : column + 30] = bright * wall + 1
    geometry = np.zeros((count, 7, SIDE, SIDE), np.float16)
    geometry[:, 0] = 1
    geometry[:, 3] = rng.uniform(-1, 1, (count, 1, 1))
    geometry[:, 0, :20] = 0
    return ClippingFrames(radiance, geometry)


def test_batches_hold_what_a_camera_shows_and_the_truth():
    frames = lamp_frames(3)
    planes, truth, weight = clipping_batch(frames, [0, 2], np.random.default_rng(0), augment=False)
    assert planes.shape == (2, 11, SIDE, SIDE)
    assert planes[:, :3].max() <= 1
    clipped = torch.from_numpy(frames.radiance[[0, 2]].astype(np.float32)).amax(1) >= CLIPPED
    assert (planes[:, 3].bool() == (clipped & (planes[:, 4] > 0))).all()
    assert (planes[:, :4, :20] == 0).all()  # outside the frame
    assert ((weight > 0) <= (truth.amax(1, keepdim=True) >= CLIPPED)).all()
    assert truth.amax() == pytest.approx(float(frames.radiance[[0, 2]].max()), rel=1e-3)


def test_exposure_and_mirroring_keep_the_truth_consistent():
    """Whatever is drawn: clipped pixels are those at white, and their truth is above it."""
    frames, mirrored = lamp_frames(2), 0
    for seed in range(12):
        planes, truth, weight = clipping_batch(frames, [0, 1], np.random.default_rng(seed), augment=True)
        marked = planes[:, 3] > 0
        assert (planes[:, :3].amax(1)[marked] >= CLIPPED).all()
        assert (truth.amax(1, keepdim=True)[weight > 0] >= CLIPPED).all()
        mirrored += int(torch.sign(planes[0, 7, 50, 50]) != np.sign(frames.geometry[0, 3, 50, 50]))
    assert 0 < mirrored < 12


def test_held_out_frames_are_no_training_frames():
    frames = lamp_frames(13)
    training, held = frames.split(0)
    assert (len(training), len(held)) == (12, 1)
    assert not any(np.array_equal(held.radiance[0], one) for one in training.radiance)


def test_held_out_frames_need_clipped_pixels():
    dark = ClippingFrames(np.zeros((2, 3, SIDE, SIDE), np.float16), np.zeros((2, 7, SIDE, SIDE), np.float16))
    with pytest.raises(DatasetError, match="none of the 2 held-out frames has a clipped pixel"):
        ClippingStage(lamp_frames(2), dark)


def half_rooms(count):
    """Panoramas of which one half is observed; the other is half as bright in log(1 + L) as the fill says."""
    rng = np.random.default_rng(3)
    panels = np.zeros((count, OBJECT_PANELS, HEIGHT, 2 * HEIGHT), np.float16)
    truth = np.zeros((count, 3, HEIGHT, 2 * HEIGHT), np.float16)
    for number in range(count):
        light = rng.uniform(0.5, 2.0)
        panels[number, :3, :, :HEIGHT] = light
        panels[number, 3, :, :HEIGHT] = 1
        panels[number, 5, :, :HEIGHT] = 2
        panels[number, 6:9] = truth[number] = light
        truth[number, :, :, HEIGHT:] = np.expm1(np.log1p(light) / 2)
    return CompletionExamples(panels, truth)


def test_completed_light_keeps_what_was_observed():
    panels, _ = completion_batch(half_rooms(2), [0, 1], np.random.default_rng(0), augment=False)

    class Brighter(torch.nn.Module):
        def forward(self, panels):
            return torch.full_like(panels[:, :3], 0.5)

    with torch.no_grad():
        light = completed(Brighter(), panels[:, :9])
    assert torch.allclose(light[..., :HEIGHT], panels[:, 6:9, :, :HEIGHT], rtol=1e-5)
    assert torch.allclose(torch.log1p(light[..., HEIGHT:]), torch.log1p(panels[:, 6:9, :, HEIGHT:]) + 0.5, rtol=1e-5)


def test_light_of_objects_keeps_what_was_measured():
    """What was seen stays, unless it is an estimate for clipped pixels."""
    examples = half_rooms(1)
    examples.panels[:, 9, : HEIGHT // 2, :HEIGHT] = 10 * examples.panels[:, 6, : HEIGHT // 2, :HEIGHT]
    panels, _ = completion_batch(examples, [0], np.random.default_rng(0), augment=False)

    class Brighter(torch.nn.Module):
        def forward(self, panels):
            return torch.cat([torch.full_like(panels[:, :3], 0.5), torch.full_like(panels[:, :3], 0.25)], dim=1)

    with torch.no_grad():
        for light, change in zip(lights(Brighter(), panels), (0.5, 0.25), strict=True):
            gain = torch.log1p(light) - torch.log1p(panels[:, 6:9])
            assert torch.allclose(gain[..., HEIGHT // 2 :, :HEIGHT], torch.zeros(1), atol=1e-5)
            assert torch.allclose(gain[..., : HEIGHT // 2, :HEIGHT], torch.tensor(change), atol=1e-5)
            assert torch.allclose(gain[..., HEIGHT:], torch.tensor(change), atol=1e-5)


def test_errors_of_objects_are_those_of_the_evaluation():
    """Seen from six sides: the training has normals all around, and lobes instead of a microfacet."""
    rng = np.random.default_rng(1)
    directions = panorama_directions(HEIGHT)
    truth, found = (
        np.exp(-1.2 + directions @ rng.normal(0, 0.25, 3))[..., None] * np.ones(3) * scale for scale in (1.0, 1.3)
    )
    as_tensors = [torch.from_numpy(np.moveaxis(one, -1, 0)[None].astype(np.float32)) for one in (truth, found)]
    ours = look_errors(as_tensors[1], as_tensors[1], as_tensors[0])[0].tolist()
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    views = [LitObjects(truth, (s * x, s * y, s * z)).errors(found) for x, y, z in axes for s in (-1, 1)]
    wanted = {look: float(np.sqrt(np.mean([view[look] ** 2 for view in views]))) for look in EVALUATED}
    found_by_look = dict(zip(LOOKS, ours, strict=True))
    for look in EVALUATED:
        error = found_by_look[look]
        assert error == pytest.approx(wanted[look], rel=0.25, abs=5e-3), look


def test_light_beyond_white_is_no_error_and_still_has_a_gradient():
    truth = torch.full((1, 3, HEIGHT, 2 * HEIGHT), 5.0)
    assert look_errors(2 * truth, 2 * truth, truth)[0, :4].tolist() == pytest.approx([0] * 4, abs=4e-3)
    bright = torch.full_like(truth, 3.0).requires_grad_()
    look_errors(bright, bright, torch.full_like(truth, 0.3)).sum().backward()
    assert bright.grad is not None
    assert (bright.grad > 0).all()


def test_augmented_panoramas_stay_consistent():
    """Observed pixels show the truth in every channel, wherever they were turned."""
    for seed in range(8):
        panels, truth = completion_batch(half_rooms(2), [0, 1], np.random.default_rng(seed), augment=True)
        known = (panels[:, 3:4] == 1).expand(-1, 3, -1, -1)
        assert known.float().mean() == pytest.approx(0.5)
        assert torch.allclose(panels[:, :3][known], truth[known], rtol=1e-3)
        assert torch.allclose(panels[:, 6:9][known], truth[known], rtol=1e-3)


@pytest.mark.parametrize("form", ["clipping", "completion", "objects"])
def test_a_stage_learns_what_its_examples_show(form, tmp_path):
    if form == "clipping":
        stage, rate = ClippingStage(lamp_frames(8, bright=40.0), lamp_frames(3, bright=40.0)), 0.008
    else:
        build = CompletionStage if form == "completion" else ObjectsStage
        stage, rate = build(half_rooms(8), half_rooms(3)), 0.03
    options = PartOptions(steps=24, batch=2, learning_rate=rate, ema=0.5, seed=1)
    trainer = PartTrainer(stage, options, tmp_path / "run")
    with torch.random.fork_rng():
        before = stage.scores(trainer.network.eval())["loss"]
    trainer.train(report=lambda _: None, every_steps=100)
    after = load_part_checkpoint(tmp_path / "run" / "model.pt").card["scores"]
    assert after["loss"] < 0.6 * before
    assert all(np.isfinite(value) for value in after.values())
