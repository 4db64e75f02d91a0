"""The rotations that docs/conventions.md states, against each tool's published mapping of a panorama.

Each function is the tool's own formula: from a direction in the tool's axes to (u, v), v from the top.
"""

import numpy as np
import pytest
from jaxtyping import Float

from roomlight.conventions import direction_to_uv

Directions = Float[np.ndarray, "n 3"]
Coordinates = Float[np.ndarray, "n 2"]


def three_js(d: Directions) -> Coordinates:
    """`equirectUv` of common.glsl; its v counts from the bottom."""
    return np.stack([np.arctan2(d[:, 2], d[:, 0]) / (2 * np.pi) + 0.5, 0.5 - np.arcsin(d[:, 1]) / np.pi], -1)


def blender(d: Directions) -> Coordinates:
    """`direction_to_equirectangular` of Cycles; its v counts from the bottom."""
    u = -np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) + 0.5
    return np.stack([u, 0.5 - np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1])) / np.pi], -1)


def mitsuba(d: Directions) -> Coordinates:
    """`EnvironmentMapEmitter::eval`, in the emitter's local axes."""
    return np.stack([np.arctan2(d[:, 0], -d[:, 2]) / (2 * np.pi), np.arccos(d[:, 1]) / np.pi], -1)


def usd(d: Directions) -> Coordinates:
    """OpenEXR's latitude-longitude map, which UsdLux cites: longitude pi at the left, 0 at +Z, pi / 2 at +X."""
    return np.stack([0.5 - np.arctan2(d[:, 0], d[:, 2]) / (2 * np.pi), np.arccos(d[:, 1]) / np.pi], -1)


def unity(d: Directions) -> Coordinates:
    """`ToRadialCoords` of Skybox/Panoramic; its v counts from the bottom."""
    u = 0.5 - np.arctan2(d[:, 2], d[:, 0]) / (2 * np.pi)
    return np.stack([u, np.arccos(d[:, 1]) / np.pi], -1)


def about_y(degrees: float) -> Float[np.ndarray, "3 3"]:
    angle = np.radians(degrees)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


IDENTITY = np.eye(3)
BLENDER_IMPORT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) to (x, -z, y)
UNITY_FLIP = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("mapping", "world_to_tool", "rotation"),
    [
        (three_js, IDENTITY, IDENTITY),
        (blender, BLENDER_IMPORT, IDENTITY),
        (mitsuba, IDENTITY, about_y(90)),
        (usd, IDENTITY, about_y(90)),
        (unity, UNITY_FLIP, IDENTITY),
    ],
    ids=["three.js", "Blender", "Mitsuba", "USD", "Unity"],
)
def test_stated_rotation_shows_our_panorama_unturned(mapping, world_to_tool, rotation):
    ours = np.random.default_rng(0).normal(size=(500, 3))
    ours /= np.linalg.norm(ours, axis=-1, keepdims=True)
    local = ours @ world_to_tool.T @ rotation  # the inverse of the rotation, applied to rows
    difference = mapping(local) - direction_to_uv(ours)
    difference[:, 0] -= np.rint(difference[:, 0])  # u wraps around
    np.testing.assert_allclose(difference, 0, atol=1e-9)
