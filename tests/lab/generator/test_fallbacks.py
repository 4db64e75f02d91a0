"""Fallback models: ten kinds, exact sizes, valid meshes, disjoint splits."""

import hashlib

import numpy as np
import pytest
from plain_shapes import faces_match_normals

from roomlight_generator.rooms.furniture import fallback_models
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.roles import CEILING_ROLES, WALL_ROLES
from roomlight_generator.rooms.scene import Mesh

MAX_TRIANGLES = 700
MODELS = (*fallback_models("train"), *fallback_models("test"))
LAMPS = ("floor_lamp", "ceiling_lamp")


def digest(mesh: Mesh) -> str:
    parts = (mesh.vertices, mesh.normals, mesh.uvs, mesh.faces, mesh.face_materials)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def ids(model: FurnitureModel) -> str:
    return model.id


@pytest.mark.parametrize("model", MODELS, ids=ids)
def test_a_mesh_is_valid_and_has_the_size_of_its_model(model: FurnitureModel) -> None:
    mesh = model.mesh
    half_x, half_z = model.width_m / 2, model.depth_m / 2
    np.testing.assert_allclose(mesh.bounds(), [[-half_x, 0, -half_z], [half_x, model.height_m, half_z]], atol=1e-3)
    assert 0 < len(mesh.faces) <= MAX_TRIANGLES
    assert all(np.isfinite(part).all() for part in (mesh.vertices, mesh.normals, mesh.uvs))
    assert set(np.unique(mesh.face_materials)) == set(range(len(mesh.materials)))
    assert faces_match_normals(mesh).all()
    for material in mesh.materials:
        assert 0 < min(material.albedo) <= max(material.albedo) <= 0.95
        assert material.roughness is None or 0.03 <= material.roughness <= 0.6
        assert not any(material.emission)
        assert material.name


@pytest.mark.parametrize("model", MODELS, ids=ids)
def test_a_model_has_a_plausible_place_and_top(model: FurnitureModel) -> None:
    assert (model.elevation_m > 0) == (model.role in WALL_ROLES)
    assert model.elevation_m + model.height_m < 2.2
    assert (model.top_m is not None) == (model.role in ("dining_table", "coffee_table", "sideboard"))
    assert model.top_m is None or model.top_m == pytest.approx(model.height_m, abs=1e-5)
    if model.role in CEILING_ROLES:
        assert model.height_m < 1.0
    if model.role in ("sofa", "chair", "bed"):  # the back is at -z
        high = model.mesh.vertices[model.mesh.vertices[:, 1] > 0.92 * model.height_m]
        assert high[:, 2].mean() < 0


@pytest.mark.parametrize("model", [model for model in MODELS if model.role in LAMPS], ids=ids)
def test_lamps_have_a_bulb_inside_and_a_shade(model: FurnitureModel) -> None:
    low, high = model.mesh.bounds()
    assert len(model.lights) == 1
    assert (model.lights[0].position >= low).all()
    assert (model.lights[0].position <= high).all()
    assert any(material.name == "shade" for material in model.mesh.materials)


def test_the_same_id_gives_the_same_bytes() -> None:
    for model, again in zip(fallback_models("test"), fallback_models("test"), strict=True):
        assert model.id == again.id
        assert digest(model.mesh) == digest(again.mesh)
