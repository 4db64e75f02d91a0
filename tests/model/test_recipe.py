"""Recipes: those of the shipped networks follow their cards; wrong ones are refused before any work."""

import json
from typing import Any

import pytest
import torch

import lamp_rooms
import stub_rooms
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import DatasetError, OptionError
from roomlight_model.training.clipping import ClippingOptions, ClippingStage
from roomlight_model.training.objects import ObjectsOptions
from roomlight_model.training.recipe import RECIPES, StageRecipe, build_stage, read_recipe
from roomlight_model.training.single_view import SingleViewOptions
from roomlight_model.training.video import VideoOptions

RENAMED: dict[str, str] = {"second_looks": "revisits"}
LATER = {"validate_steps", "held_out", "model"}
"""Not in the cards; as many as there were; the widths of the weights before."""
SMALL = """
ships = "second/best.pt"
[data.rooms]
sequences = 8
[data.walks]
[[stages]]
name = "first"
stage = "single-sglv"
data = ["rooms", "rooms"]
steps = 4
learning_rate = 1
volume_shape = [16, 15, 21]
model = {sg = {channels = 4}}
[[stages]]
name = "second"
stage = "video-blend"
data = ["walks"]
start_from = "first/model.pt"
"""


def cards(form: str) -> list[dict[str, Any]]:
    """The cards of a shipped network and of the weights before, the first stage first."""
    card, chain = json.loads((SHIPPED / form / "model.json").read_text())["card"], []
    while card is not None:
        chain.insert(0, card)
        card = card.get("before")
    return [card for card in chain if card["stage"].split("-")[0] == form]


@pytest.mark.parametrize("form", ["single", "video", "clipping", "objects", "depth"])
def test_the_shipped_recipes_follow_the_cards(form: str) -> None:
    recipe, chain = read_recipe(form), cards(form)
    assert [stage.options.stage for stage in recipe.stages] == [card["stage"] for card in chain]
    assert recipe.ships.partition("/")[0] == recipe.stages[-1].name
    for stage, card in zip(recipe.stages, chain, strict=True):
        stated: dict[str, Any] = {RENAMED.get(str(name), str(name)): value for name, value in card["options"].items()}
        ours = stage.options.to_dict()
        compared = (set(stated) & set(ours)) - LATER
        assert {name: ours[name] for name in compared} == {name: stated[name] for name in compared}
        assert {"steps", "batch", "learning_rate", "seed", "ema"} <= compared
        if "data" in card:
            seeds = [recipe.data[name].get("seed", 0) for name in stage.data]
            frames = [recipe.data[name].get("frames", 31) for name in stage.data]
            assert sorted(zip(seeds, frames, strict=True)) == sorted((d["seed"], d["frames"]) for d in card["data"])
    assert len(list(RECIPES.glob("*.toml"))) == 5


def test_every_dataset_of_a_shipped_recipe_is_used() -> None:
    for path in RECIPES.glob("*.toml"):
        recipe = read_recipe(str(path))
        assert {name for stage in recipe.stages for name in stage.data} == set(recipe.data)


def write(tmp_path, text):
    (tmp_path / "small.toml").write_text(text)
    return str(tmp_path / "small.toml")


def test_a_file_is_read_into_the_options_of_its_stages(tmp_path) -> None:
    recipe = read_recipe(write(tmp_path, SMALL))
    first, second = recipe.stages
    assert isinstance(first.options, SingleViewOptions)
    assert not isinstance(first.options, VideoOptions)
    assert isinstance(second.options, VideoOptions)
    assert (first.name, first.data, first.start_from) == ("first", ("rooms", "rooms"), None)
    assert (first.options.steps, first.options.learning_rate, first.options.batch) == (4, 1.0, 4)
    assert first.options.volume_shape == (16, 15, 21)
    assert first.options.model.sg.channels == 4
    assert (second.start_from, second.options.frames) == ("first/model.pt", 31)
    assert (recipe.ships, recipe.data) == ("second/best.pt", {"rooms": {"sequences": 8}, "walks": {}})


def test_options_change_in_every_stage_that_has_them(tmp_path) -> None:
    recipe = read_recipe(write(tmp_path, SMALL)).changed({"steps": 7, "light_changes": 0.5, "depth": "exact"})
    assert [stage.options.steps for stage in recipe.stages] == [7, 7]
    first, second = (stage.options for stage in recipe.stages)
    assert isinstance(first, SingleViewOptions)
    assert isinstance(second, VideoOptions)
    assert (first.depth, second.depth, second.light_changes) == ("exact", "exact", 0.5)
    assert first.volume_shape == (16, 15, 21)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, "no stage has an option colour; the options are augment, batch"),
        ({"stage": "video-joint"}, "no stage has an option stage"),
        ({"steps": "many"}, "stage first: steps is 'many': Input should be a valid integer"),
        ({"steps": 0}, "stage first: steps is 0: Input should be greater than or equal to 1"),
        ({"light_changes": 2}, "stage second: light_changes is 2"),
    ],
)
def test_wrong_changes_are_refused(change, message, tmp_path) -> None:
    with pytest.raises(OptionError, match=message):
        read_recipe(write(tmp_path, SMALL)).changed(change)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("steps = 4", "steps = 0", "stage first: steps is 0: Input should be greater than or equal to 1"),
        ("steps = 4", "step = 4", "stage first: step is 4: Unexpected keyword argument"),
        ("steps = 4", 'steps = "4"', "stage first: steps is '4': Input should be a valid integer"),
        ("steps = 4", "light_changes = 0.5", r"stage first: light_changes is 0\.5: Unexpected keyword argument"),
        ("channels = 4", "channels = 5", "stage first: .*channels must be a positive multiple of 4"),
        ("channels = 4", "depth = 4", r"stage first: model\.sg\.depth is 4: Unexpected"),
        ('stage = "single-sglv"', 'stage = "cats"', "stage is 'cats'; it must be one of single-sglv, single-blend"),
        ('stage = "single-sglv"', "", "stage is None"),
        ('name = "second"', 'name = "first"', "stage first: two stages have this name"),
        ('name = "second"', 'name = "../second"', "it must be the name of a folder"),
        ('data = ["walks"]', 'data = ["cats"]', r"stage second: no \[data\.cats\] .* datasets are rooms, walks"),
        ('data = ["walks"]', 'data = "walks"', "it must be a list of names"),
        ('start_from = "first/model.pt"', "start_from = 3", "start_from is 3; it must be a text"),
        ('ships = "second/best.pt"', 'ships = "third/best.pt"', "ships is 'third/best.pt'; it must be one of first/"),
        ('ships = "second/best.pt"', "ships = []", r"ships is \[\]: Input should be a valid string"),
        ('ships = "second/best.pt"', "", "ships is .*: Field required"),
        ('ships = "second/best.pt"', 'ship = "a"\nships = "second/best.pt"', "ship is 'a': Unexpected"),
        ("[data.walks]", "[data.walks", "is not TOML"),
    ],
)  # fmt: skip
def test_wrong_files_are_refused_with_their_fault(old, new, message, tmp_path) -> None:
    assert old in SMALL
    with pytest.raises(OptionError, match=rf"small\.toml: .*{message}"):
        read_recipe(write(tmp_path, SMALL.replace(old, new)))


def test_a_missing_recipe_names_the_shipped_ones(tmp_path) -> None:
    with pytest.raises(
        OptionError, match=r"cats\.toml: cannot be read .*one of clipping, depth, objects, single, video"
    ):
        read_recipe("cats")
    with pytest.raises(OptionError, match=r"none\.toml: cannot be read"):
        read_recipe(str(tmp_path / "none.toml"))


@pytest.mark.parametrize(
    ("data", "options", "message"),
    [
        ({"split": "test"}, ClippingOptions(), "rooms: has no sequence of the split train"),
        ({}, VideoOptions(), "rooms: its walks have 1 frame; stage video-sglv needs 2 or more"),
        ({"renderer": stub_rooms.VIEWS}, SingleViewOptions(), "rooms: has no probes, whose light stage single-sglv"),
        ({"renderer": stub_rooms.VIEWS}, ObjectsOptions(), "rooms: has no probes, whose light stage objects learns"),
    ],
)
def test_data_without_what_a_stage_learns_from_is_named(data, options, message, tmp_path) -> None:
    stub_rooms.make_dataset(tmp_path / "rooms", 2, frames=1, **data)
    recipe, device = StageRecipe("run", options, ("rooms",)), torch.device("cpu")
    with pytest.raises(DatasetError, match=message):
        build_stage(recipe, [tmp_path / "rooms"], start_from=None, device=device)


def test_small_networks_score_rooms_that_they_do_not_train_on(tmp_path) -> None:
    folder = tmp_path / "lamps"
    stub_rooms.make_dataset(folder, 6, frames=1, renderer=lamp_rooms.NAME)
    recipe, device = StageRecipe("run", ClippingOptions(), ("lamps", "lamps")), torch.device("cpu")
    stage = build_stage(recipe, [folder, folder], start_from=None, device=device)
    assert isinstance(stage, ClippingStage)
    seen, scored = ([frame.tobytes() for frame in part.radiance] for part in (stage.training, stage.held_out))
    assert (len(seen), len(scored)) == (8, 2)  # two rooms, each walk twice, and one
    assert set(seen).isdisjoint(scored)
