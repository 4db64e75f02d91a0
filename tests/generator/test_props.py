"""Procedural furniture: every role, exact sizes, valid meshes, materials within their ranges, disjoint splits."""

import hashlib
import pickle
from collections import Counter
from functools import cache

import numpy as np
import pytest

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.props import procedural_models
from roomlight_generator.rooms.props.draft import scaled_to_size
from roomlight_generator.rooms.props.procedural import KINDS, build_draft
from roomlight_generator.rooms.roles import CEILING_ROLES, OPENING_ROLES, ROLES, WALL_ROLES
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import block, faces_match_normals

LAMPS = ("floor_lamp", "table_lamp", "wall_lamp", "ceiling_lamp")
MAX_TRIANGLES = 3000
"""Keeps a room of a hundred props under a third of a million triangles, and each under 20 ms to build: a thousand
triangles take some 3 ms on one slow core."""

VARIANTS = [pytest.param(1, id="one variant"), pytest.param(None, id="all variants", marks=pytest.mark.slow)]


@cache
def models_of(split: Split, variants: int | None) -> tuple[FurnitureModel, ...]:
    """Build models once for all tests: the meshes stay in the models."""
    return procedural_models(split, variants=variants)


@pytest.fixture(params=VARIANTS)
def models(request: pytest.FixtureRequest) -> tuple[FurnitureModel, ...]:
    """One train variant of each kind and some test models; or all train variants and five test variants of each."""
    if request.param is None:
        return (*models_of("train", None), *models_of("test", 5))
    return (*models_of("train", 1), *models_of("test", 1)[::8])


@pytest.fixture
def train_models(models: tuple[FurnitureModel, ...]) -> tuple[FurnitureModel, ...]:
    return tuple(model for model in models if model.split == "train")


def digest(mesh: Mesh) -> str:
    parts = (mesh.vertices, mesh.normals, mesh.uvs, mesh.faces, mesh.face_materials)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def volume_m3(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def pieces(mesh: Mesh) -> list[np.ndarray]:
    """Return the faces of each connected piece; vertices within 0.1 mm count as one."""
    _, place = np.unique(np.rint(mesh.vertices * 1e4).astype(np.int64), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    label = np.arange(int(faces.max()) + 1)
    while True:
        low = label[faces].min(1)
        after = label.copy()
        np.minimum.at(after, faces.ravel(), np.repeat(low, 3))
        after = after[after]
        if (after == label).all():
            break
        label = after
    owner = label[faces[:, 0]]
    return [np.flatnonzero(owner == piece) for piece in np.unique(owner)]


def test_every_role_has_at_least_five_models() -> None:
    counts: Counter[str] = Counter()
    for kind in KINDS:
        counts[kind.role] += kind.variants
    expected = set(ROLES) - {"person", "pet", *OPENING_ROLES}
    assert set(counts) == expected
    assert min(counts.values()) >= 5


def test_mesh_bounds_equal_the_size_of_the_model(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        half_x, half_z = model.width_m / 2, model.depth_m / 2
        expected = [[-half_x, 0, -half_z], [half_x, model.height_m, half_z]]
        np.testing.assert_allclose(model.mesh.bounds(), expected, atol=1e-3, err_msg=model.id)


def test_meshes_are_valid(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        mesh = model.mesh
        assert 0 < len(mesh.faces) <= MAX_TRIANGLES, model.id
        assert mesh.vertices.dtype == np.float32, model.id
        assert all(np.isfinite(part).all() for part in (mesh.vertices, mesh.normals, mesh.uvs)), model.id
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-3, err_msg=model.id)
        assert mesh.faces.min() >= 0, model.id
        assert mesh.faces.max() < len(mesh.vertices), model.id
        assert set(np.unique(mesh.face_materials)) == set(range(len(mesh.materials))), model.id
        assert faces_match_normals(mesh).all(), model.id


@pytest.mark.parametrize("number", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_no_piece_is_inside_out(number: int) -> None:
    """No closed connected piece has a negative volume about its own centre.

    The insides of lamps and the fronts of drawers are separate open pieces that rightly face inward, so open pieces are
    skipped.
    """
    for model in models_of("train", number + 1):
        if not model.id.endswith(f"train{number}"):
            continue
        mesh = model.mesh
        for piece in pieces(mesh):
            corners = mesh.vertices[mesh.faces[piece]].astype(np.float64)
            geometric_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = 0.5 * np.linalg.norm(geometric_normals, axis=1).sum()
            # The area vectors of a closed surface cancel; the holes at poles are 1 mm wide.
            if np.linalg.norm(0.5 * geometric_normals.sum(0)) > 0.02 * area:
                continue
            middle = corners.mean((0, 1))
            volume = float(((corners[:, 0] - middle) * geometric_normals).sum() / 6)
            assert volume > -1e-7, (model.id, mesh.materials[int(mesh.face_materials[piece[0]])].name)


def test_materials_stay_within_their_ranges(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        for material in model.mesh.materials:
            assert 0 <= min(material.albedo) <= max(material.albedo) <= 0.95, (model.id, material.name)
            assert material.roughness is None or 0.03 <= material.roughness <= 0.6, (model.id, material.name)
            assert 0 <= material.mirror <= 0.95
            assert not material.emits or model.role == "fireplace", (model.id, material.name)
            assert material.name, model.id


def mean_albedo(material: Material) -> float:
    albedo = float(np.mean(material.albedo))
    if material.texture is None:
        return albedo
    srgb = material.texture.image.mean((0, 1)) / 255
    return albedo * float(np.mean(srgb**2.2))


@pytest.mark.slow
@pytest.mark.statistical
def test_albedos_span_black_to_white_and_strong_colours() -> None:
    models = models_of("train", None)
    chosen = [material for model in models for material in model.mesh.materials if not material.glass]
    levels = np.array([mean_albedo(material) for material in chosen])
    assert (levels < 0.05).mean() > 0.08
    assert (levels > 0.6).mean() > 0.12
    assert ((levels > 0.1) & (levels < 0.5)).mean() > 0.3
    plain = np.array([material.albedo for material in chosen if material.texture is None])
    saturation = 1 - plain.min(1) / np.maximum(plain.max(1), 1e-6)
    assert (saturation > 0.8).mean() > 0.08
    assert 0.3 < np.mean([material.roughness is not None for material in chosen]) < 0.9


def test_lamps_have_bulbs_inside_them_and_a_shade_material(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        if model.role not in LAMPS:
            continue
        assert model.lights, model.id
        low, high = model.mesh.bounds()
        for light in model.lights:
            assert (light.position >= low).all(), model.id
            assert (light.position <= high).all(), model.id
        assert any(material.name.startswith("shade") for material in model.mesh.materials), model.id


@pytest.mark.parametrize("most", [1, pytest.param(99, marks=pytest.mark.slow)])
def test_lamp_meshes_are_built_close_to_their_size(most: int) -> None:
    """Light positions refer to the size of the draft, so the built mesh must be close to it."""
    for kind in KINDS:
        if kind.role not in LAMPS:
            continue
        for number in range(min(kind.variants, most)):
            draft = build_draft(kind, "train", number)
            low, high = draft.build().bounds()
            np.testing.assert_allclose(
                (high - low) / np.array(draft.size), 1, atol=0.08, err_msg=f"{kind.name} {number}"
            )


def test_screens_mirrors_and_prints_have_their_materials(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        names = {material.name for material in model.mesh.materials}
        if model.role in ("television", "wall_television", "computer", "laptop"):
            assert "screen" in names, model.id
        if model.role == "mirror":
            assert any(material.mirror > 0.8 for material in model.mesh.materials), model.id
        if model.role == "picture":
            assert any(m.name == "print" and m.texture is not None for m in model.mesh.materials), model.id
        if model.role == "shower":
            assert any(material.glass for material in model.mesh.materials), model.id


def test_elevations_tops_and_sizes_are_plausible(models: tuple[FurnitureModel, ...]) -> None:
    for model in models:
        if model.role in WALL_ROLES:
            assert 0.2 < model.elevation_m < 2.2, model.id
            assert model.elevation_m + model.height_m < 2.55, model.id
        else:
            assert model.elevation_m == 0, model.id
        if model.top_m is not None:
            assert 0 < model.top_m <= model.height_m + 1e-6, model.id
        if model.role in ("dining_table", "desk"):
            assert 0.68 < (model.top_m or 0) < 0.8, model.id
        if model.role == "rug":
            assert model.height_m < 0.02, model.id
        if model.role in CEILING_ROLES:
            assert model.height_m < 1.5, model.id
        assert max(model.width_m, model.depth_m) < 3.2, model.id


def test_sofas_and_screens_face_plus_z(train_models: tuple[FurnitureModel, ...]) -> None:
    """A sofa's highest parts are behind its middle; a screen's normal is +z."""
    for model in train_models:
        mesh = model.mesh
        if model.role in ("sofa", "armchair", "chair", "office_chair", "bed"):
            high = mesh.vertices[mesh.vertices[:, 1] > 0.92 * model.height_m]
            assert high[:, 2].mean() < 0, model.id
        screens = [k for k, material in enumerate(mesh.materials) if material.name == "screen"]
        if screens:
            normals = mesh.normals[mesh.faces[np.isin(mesh.face_materials, screens)]].reshape(-1, 3)
            assert (normals[:, 2] > 0.8).all(), model.id


def test_kitchen_units_of_one_number_match(train_models: tuple[FurnitureModel, ...]) -> None:
    """Units of one number share depth, front colour and worktop height."""
    by_id = {model.id: model for model in train_models}
    numbers = [number for number in range(6) if f"procedural/kitchen_unit-drawers-60/train{number}" in by_id]
    assert numbers
    for number in numbers:
        units = [
            by_id[f"procedural/kitchen_unit-{what}/train{number}"] for what in ("drawers-60", "doors-80", "sink-80")
        ]
        assert len({unit.depth_m for unit in units}) == 1
        assert [unit.width_m for unit in units] == [0.6, 0.8, 0.8]
        assert units[0].top_m == units[1].top_m == 0.9
        assert len({tuple(sorted({m.albedo for m in unit.mesh.materials if m.name == "paint"})) for unit in units}) == 1


def test_the_same_id_gives_the_same_bytes(train_models: tuple[FurnitureModel, ...]) -> None:
    quick = len(train_models) == len(KINDS)
    chosen = procedural_models("train", variants=1)[::8] if quick else procedural_models("train", variants=3)
    again = {model.id: model for model in chosen}
    for model in train_models:
        if model.id in again:
            assert digest(model.mesh) == digest(again[model.id].mesh), model.id
            for mine, other in zip(model.mesh.materials, again[model.id].mesh.materials, strict=True):
                assert (mine.albedo, mine.roughness, mine.mirror) == (other.albedo, other.roughness, other.mirror)
                if mine.texture is not None and other.texture is not None:
                    np.testing.assert_array_equal(mine.texture.image, other.texture.image)


def test_loading_twice_and_after_pickling_gives_the_same_bytes() -> None:
    for model in procedural_models("test", variants=1)[::20]:
        assert digest(model.load()) == digest(model.load()) == digest(pickle.loads(pickle.dumps(model)).mesh)


def test_splits_share_neither_ids_nor_meshes(models: tuple[FurnitureModel, ...]) -> None:
    train = [model for model in models if model.split == "train"]
    test = [model for model in models if model.split == "test"]
    assert len({model.id for model in (*train, *test)}) == len(train) + len(test)
    assert all(model.split == "train" for model in train)
    assert all(model.split == "test" for model in test)
    assert not {digest(model.mesh) for model in train} & {digest(model.mesh) for model in test}


@pytest.mark.parametrize("roles", [{"book"}, {"vase"}, pytest.param(set(ROLES), marks=pytest.mark.slow)], ids=len)
def test_variants_of_a_kind_differ(roles: set[str]) -> None:
    digests = Counter(digest(model.mesh) for model in models_of("train", None) if model.role in roles)
    assert max(digests.values()) == 1


def test_meshes_are_built_on_demand() -> None:
    models = procedural_models("train", variants=1)
    assert len(models) == len(KINDS)
    assert all("mesh" not in vars(model) for model in models)


def test_scaling_to_size_scales_and_centres() -> None:
    mesh = scaled_to_size(block(1.0, 1.0, 1.0).placed(3.0, 1.0, -2.0), (0.5, 2.0, 0.25))
    np.testing.assert_allclose(mesh.bounds(), [[-0.25, 0, -0.125], [0.25, 2, 0.125]], atol=1e-5)
    assert faces_match_normals(mesh).all()
    assert volume_m3(mesh) == pytest.approx(0.25, rel=1e-4)
