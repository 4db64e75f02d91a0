"""Disjoint splits, choice of models, and the search for installed libraries."""

from collections import Counter

import numpy as np
import pytest
from furniture_files import MTL, box_obj, entry, simple_library, write_library
from hypothesis import given, settings
from hypothesis import strategies as st

from present import present
from roomlight.dataset.recording import Split
from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture import Catalogue, build_cache, load_catalogue
from roomlight_generator.rooms.furniture.catalogue import cache_folder, installed_libraries, library_files
from roomlight_generator.rooms.furniture.splits import assign_splits
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.shapes import block


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Isolate the test from the user's files: an empty cache folder, nothing installed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("ROOMLIGHT_FURNITURE", raising=False)
    monkeypatch.setattr("roomlight_generator.rooms.furniture.catalogue.INSTALLED_FOLDER", tmp_path / "nowhere")
    return tmp_path


def refuse(text):
    raise AssertionError(text)


def chosen_id(catalogue, role, split, rng, **options):
    model = present(catalogue.choose(role, split, rng, **options))
    return model.id


def made(identity, role="sofa", split: Split = "train", width=1.0):
    return FurnitureModel(identity, identity, role, split, width, 1.0, 1.0, load=lambda: block(1, 1, 1))


@given(
    counts=st.lists(st.integers(1, 30), min_size=1, max_size=6),
    links=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), max_size=12),
)
@settings(max_examples=60, deadline=None)
def test_splits_share_no_digest_and_cover_every_role(counts, links):
    roles = {f"{role}-{k}": f"r{role}" for role, count in enumerate(counts) for k in range(count)}
    names = sorted(roles)
    shared: dict[str, list[str]] = {name: [f"own {name}"] for name in names}
    for number, (first, second) in enumerate(links):
        for place in (first, second):
            shared[names[place % len(names)]].append(f"link {number}")
    splits = assign_splits(roles, shared)
    assert splits == assign_splits(dict(reversed(roles.items())), shared)
    by_split = {
        split: {digest for name in names if splits[name] == split for digest in shared[name]}
        for split in ("train", "test")
    }
    assert not by_split["train"] & by_split["test"]
    total = Counter(roles.values())
    reserved = Counter(roles[name] for name in names if splits[name] == "test")
    for role, count in total.items():
        assert reserved[role] < count
        if not links:
            assert reserved[role] == (max(1, round(count / 5)) if count >= 3 else 0)


def test_new_models_do_not_change_existing_splits():
    roles = {f"m{k}": "sofa" for k in range(40)}
    before = assign_splits(roles, {})
    after = assign_splits(roles | {"new": "chair", "newer": "chair"}, {})
    assert all(before[name] == after[name] for name in roles)


def test_choose_respects_role_split_and_fits():
    rng = np.random.default_rng(1)
    library = (made("a"), made("b", width=3.0), made("c", split="test"), made("d", role="bed"))
    catalogue = Catalogue(library)
    assert {chosen_id(catalogue, "sofa", "train", rng) for _ in range(50)} == {"a", "b"}
    assert {chosen_id(catalogue, "sofa", "train", rng, fits=lambda m: m.width_m > 2) for _ in range(9)} == {"b"}
    assert chosen_id(catalogue, "sofa", "test", rng) == "c"
    assert catalogue.choose("sofa", "train", rng, fits=lambda _: False) is None
    assert catalogue.choose("oven", "train", rng) is None


def test_fallbacks_are_chosen_only_where_the_library_has_nothing_that_fits():
    rng = np.random.default_rng(2)
    catalogue = Catalogue((made("a"),), fallbacks=(made("p"), made("q", role="oven")))
    assert {chosen_id(catalogue, "sofa", "train", rng) for _ in range(60)} == {"a"}
    assert chosen_id(catalogue, "oven", "train", rng) == "q"
    assert chosen_id(catalogue, "sofa", "train", rng, fits=lambda model: model.id == "p") == "p"


def test_library_folder_and_cache_give_the_same_catalogue(tmp_path):
    folder = tmp_path / "libraries"
    folder.mkdir()
    path = simple_library(folder / "one.sh3f", tuple("abcdef"))
    out = tmp_path / "out.rlf"
    done: list[tuple[int, int]] = []
    build_cache([path], out, warn=refuse, progress=lambda k, n: done.append((k, n)))
    assert done == [(k, 6) for k in range(1, 7)]
    catalogues = [load_catalogue(where, warn=refuse) for where in (path, folder, out)]
    for catalogue in catalogues:
        models = {(model.id, model.split, model.width_m, model.top_m) for model in catalogue.library}
        assert models == {(model.id, model.split, model.width_m, model.top_m) for model in catalogues[0].library}
        assert {model.role for model in catalogue.library} == {"chair"}
        assert {model.attribution for model in catalogue.library} == {"Chair: Ann Onymous, CC-BY 3.0"}
    assert len(list(cache_folder().iterdir())) == 1
    assert sum(model.split == "test" for model in catalogues[0].library) == 1


def test_models_of_one_shape_are_in_one_split(tmp_path):
    catalogue = "".join(entry(k + 1, f"m{k}") for k in range(12))
    files = {f"m{k}/m{k}.obj": box_obj(high=(1, 1, 1 + k // 2)) for k in range(12)}
    path = write_library(tmp_path / "a.sh3f", catalogue, {**files, **{f"m{k}/m.mtl": MTL for k in range(12)}})
    splits = {model.id: model.split for model in load_catalogue(path, warn=refuse).library}
    assert all(splits[f"m{k}"] == splits[f"m{k + 1}"] for k in range(0, 12, 2))
    assert Counter(splits.values())["test"] == 2


def test_a_malformed_model_is_left_out_with_a_warning(tmp_path):
    path = write_library(
        tmp_path / "a.sh3f",
        entry(1, "good") + entry(2, "bad") + entry(3, "good"),
        {"good/good.obj": box_obj(), "good/m.mtl": MTL, "bad/bad.obj": "f 1 2 3\n"},
    )
    warnings: list[str] = []
    catalogue = load_catalogue(path, warn=warnings.append)
    assert [model.id for model in catalogue.library] == ["good"]
    assert len(warnings) == 2
    assert any("bad.obj" in text and "'bad' is left out" in text for text in warnings)
    assert any("'good' is also in an earlier library" in text for text in warnings)


def test_a_damaged_cache_is_rebuilt(tmp_path):
    path = simple_library(tmp_path / "a.sh3f")
    load_catalogue(path, warn=refuse)
    (cache,) = cache_folder().iterdir()
    cache.write_bytes(cache.read_bytes()[:-5])
    warnings: list[str] = []
    assert len(load_catalogue(path, warn=warnings.append).library) == 3
    assert len(warnings) == 1
    assert "damaged" in warnings[0]
    load_catalogue(path, warn=refuse)


def test_a_changed_library_rebuilds_the_cache(tmp_path):
    path = simple_library(tmp_path / "a.sh3f")
    load_catalogue(path, warn=refuse)
    simple_library(path, ("a", "b", "c", "d"))
    assert len(load_catalogue(path, warn=refuse).library) == 4


def test_an_unwritable_cache_folder_falls_back_to_tmp(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("x")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    warnings: list[str] = []
    assert len(load_catalogue(simple_library(tmp_path / "a.sh3f"), warn=warnings.append).library) == 3
    assert "cannot be written" in warnings[0]
    assert str(tmp_path / "tmp") in warnings[0]


def test_without_a_library_a_warning_says_what_to_install():
    warnings: list[str] = []
    catalogue = load_catalogue(warn=warnings.append)
    assert catalogue.library == ()
    assert len(warnings) == 1
    assert "apt install sweethome3d-furniture" in warnings[0]
    assert "plain" in warnings[0]


def test_the_environment_and_installed_libraries_are_found(tmp_path, monkeypatch):
    installed = tmp_path / "installed"
    (installed / "furniture").mkdir(parents=True)
    simple_library(installed / "furniture" / "a.sh3f", ("a", "b"))
    monkeypatch.setattr("roomlight_generator.rooms.furniture.catalogue.INSTALLED_FOLDER", installed)
    assert [path.name for path in installed_libraries()] == ["a.sh3f"]
    assert len(load_catalogue(warn=refuse).library) == 2
    monkeypatch.setenv("ROOMLIGHT_FURNITURE", str(simple_library(tmp_path / "mine.sh3f", ("x", "y", "z"))))
    assert len(load_catalogue(warn=refuse).library) == 3


def test_an_unusable_library_path_is_refused(tmp_path):
    with pytest.raises(FurnitureError, match="no such file or folder"):
        load_catalogue(tmp_path / "gone", warn=refuse)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FurnitureError, match="no furniture library in it"):
        library_files(tmp_path / "empty")
    (tmp_path / "text.sh3f").write_text("hello")
    with pytest.raises(FurnitureError, match="not a zip file"):
        load_catalogue(tmp_path / "text.sh3f", warn=refuse)
    bare = write_library(tmp_path / "bare.sh3f", None, {"x": "y"})
    with pytest.raises(FurnitureError, match="has no PluginFurnitureCatalog"):
        load_catalogue(bare, warn=refuse)
    cars = simple_library(tmp_path / "cars.sh3f", name="Car", category="Vehicles", tags="Car")
    with pytest.raises(FurnitureError, match="no furniture in"):
        load_catalogue(cars, warn=refuse)
