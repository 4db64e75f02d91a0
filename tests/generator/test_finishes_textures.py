"""Textures tile without a seam, have plausible reflectance, and differ between splits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.conventions import srgb8_to_linear
from roomlight_generator.rooms.colour import LUMINANCE
from roomlight_generator.rooms.finishes import (
    RESERVED,
    fabric_texture,
    families,
    make_texture,
    picture_texture,
    screen_picture,
    wood_texture,
)
from roomlight_generator.rooms.finishes.noise import (
    basket_weave_blocks,
    fbm,
    herringbone_blocks,
    hexagon_blocks,
    row_blocks,
    speckle,
    texture_seed,
)
from roomlight_generator.rooms.finishes.patterns import FAMILIES
from roomlight_generator.rooms.finishes.stone import plaster

WHOLE = ("rug", "books", "screen")
TILED = [(group, name) for group in FAMILIES if group not in WHOLE for name in FAMILIES[group]]
# Mean luminous reflectance: the darkest is blackened wood or slate, the lightest white paper and glaze.
LEAST, MOST = 0.012, 0.86


def seam(image):
    """Return the mean step across the seam and the largest mean step between inner neighbours, along columns."""
    wide = image.astype(np.float64)
    steps = np.abs(np.diff(wide, axis=1)).mean((0, 2))
    return float(np.abs(wide[:, 0] - wide[:, -1]).mean()), float(steps.max())


def reflectance(texture):
    return float((srgb8_to_linear(texture.image).mean((0, 1)) @ LUMINANCE).item())


@pytest.mark.parametrize(("group", "name"), TILED, ids=[f"{group}-{name}" for group, name in TILED])
def test_textures_tile_and_have_plausible_reflectance(group, name):
    for seed in range(2):
        texture = make_texture(group, "test", np.random.default_rng(seed), family=name)
        for image in (texture.image, texture.image.transpose(1, 0, 2)):
            across, inside = seam(image)
            assert across <= inside + 1
        assert LEAST < reflectance(texture) < MOST
        assert 64 <= min(texture.image.shape[:2]) <= max(texture.image.shape[:2]) <= 512
        assert all(0.05 < side < 5 for side in texture.size_m)


@pytest.mark.parametrize("group", FAMILIES)
def test_the_same_state_gives_the_same_bytes(group):
    a, b = (make_texture(group, "train", np.random.default_rng(5)) for _ in range(2))
    assert a.size_m == b.size_m
    assert a.image.tobytes() == b.image.tobytes()
    other = make_texture(group, "test", np.random.default_rng(5))
    assert a.image.shape != other.image.shape or (a.image != other.image).any()


@given(st.integers(0, 2**32), st.integers(0, 2**32))
@settings(max_examples=50)
def test_splits_share_no_texture_seed(one, two):
    assert texture_seed("train", np.random.default_rng(one)) != texture_seed("test", np.random.default_rng(two))


def test_train_rooms_never_show_reserved_families():
    assert all(any(name in FAMILIES[group] for group in FAMILIES) for name in RESERVED)
    for group in FAMILIES:
        shown = families(group, "train")
        assert shown
        assert set(families(group, "test")) - set(shown) == set(FAMILIES[group]) & RESERVED
    with pytest.raises(KeyError, match="train split has no wallpaper texture 'damask'"):
        make_texture("wallpaper", "train", np.random.default_rng(0), family="damask")


@pytest.mark.parametrize("aspect", [0.3, 1, 1.7])
def test_pictures_keep_their_aspect(aspect):
    for seed in range(6):
        texture = picture_texture("train", np.random.default_rng(seed), aspect=aspect)
        height, width = texture.image.shape[:2]
        assert width / height == pytest.approx(aspect, rel=0.2)
        assert texture.size_m[0] / texture.size_m[1] == pytest.approx(width / height, rel=1e-6)
        assert texture.image.std() > 2


def test_screens_cloths_and_woods_are_plausible():
    rng = np.random.default_rng(3)
    assert {screen_picture("train", rng).image.shape for _ in range(6)} == {(144, 256, 3)}
    blue = (0.05, 0.1, 0.4)
    # The given colour stays the cloth's main colour under any weave or print.
    mean = np.mean(
        [srgb8_to_linear(fabric_texture("train", rng, colour=blue).image).mean((0, 1)) for _ in range(12)], 0
    )
    assert mean[2] > 1.3 * mean[0]
    brown = srgb8_to_linear(wood_texture("test", rng, colour=(0.3, 0.2, 0.1)).image).mean((0, 1))
    np.testing.assert_allclose(brown, (0.3, 0.2, 0.1), rtol=0.2)


def test_plaster_hardly_darkens():
    for seed in range(5):
        assert 0.9 < reflectance(plaster(np.random.default_rng(seed))) < 1


@pytest.mark.parametrize("shape", [(64, 96), (50, 37)])
def test_noise_is_centred_and_tiles(shape):
    rng = np.random.default_rng(2)
    for field in (fbm(rng, shape, (4, 4)), speckle(rng, shape, (1.5, 2.5))):
        assert field.shape == shape
        assert field.dtype == np.float32
        assert abs(float(field.mean())) < 0.5
        across, inside = seam(field[..., None])
        assert across <= inside * 1.05


def test_block_patterns_have_equal_blocks():
    rng = np.random.default_rng(0)
    laid = {
        "rows": (row_blocks(rng, (96, 96), rows=4, columns=3), 12),
        "herringbone": (herringbone_blocks((96, 96), length=4), 16),
        "basket": (basket_weave_blocks((96, 96), squares=4, strips=4), 64),
        "hexagons": (hexagon_blocks((96, 96), columns=4, rows=2), 16),
    }
    for name, (blocks, count) in laid.items():
        labels, sizes = np.unique(blocks.index, return_counts=True)
        assert len(labels) == count, name
        # Pixels on a joint belong to either block.
        assert sizes.min() > 0.7 * sizes.max(), name
        assert blocks.joint_px.min() >= 0, name
