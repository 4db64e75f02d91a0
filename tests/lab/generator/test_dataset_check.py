"""The check's own arithmetic, and one small room by both renderers."""

from dataclasses import replace

import numpy as np
import pytest

from present import present
from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_directions
from roomlight_generator.rooms.scene import Item, Material, Mesh, Opening, Scene, Sky, Sun
from roomlight_generator.rooms.shapes import box, rectangle, with_material
from roomlight_generator.sequences.surface_kinds import surface_kinds, without_glass
from roomlight_generator.transport import Tracer
from roomlight_generator.verification.check import CheckReport, check_view
from roomlight_generator.verification.deviation import cube_normals, deviation, irradiance, luminance, pooled
from roomlight_generator.verification.reference import Reference

DARK = Sky(np.zeros((4, 8, 3), np.float32))
WHITE = Material("wall", (0.6, 0.5, 0.4))
CAMERA = Intrinsics(30.0, 30.0, 20.0, 16.0, 40, 32)


def pose(x: float, y: float, z: float) -> np.ndarray:
    """Looks along -z."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def box_room() -> list[Mesh]:
    """4 x 2.6 x 4 m about the y axis; its floor is coated, its far wall holds a mirror."""
    coated = Material("floor", (0.4, 0.3, 0.2), roughness=0.2)
    return [
        with_material(rectangle((-2, 0, 2), (4, 0, 0), (0, 0, -4), step=5), coated),
        with_material(rectangle((-2, 2.6, -2), (4, 0, 0), (0, 0, 4), step=5), WHITE),
        with_material(rectangle((-2, 0, -2), (4, 0, 0), (0, 2.6, 0), step=5), WHITE),
        with_material(rectangle((2, 0, 2), (-4, 0, 0), (0, 2.6, 0), step=5), WHITE),
        with_material(rectangle((-2, 0, 2), (0, 0, -4), (0, 2.6, 0), step=5), WHITE),
        with_material(rectangle((2, 0, -2), (0, 0, 4), (0, 2.6, 0), step=5), WHITE),
        with_material(rectangle((0.6, 0.9, -1.99), (0.6, 0, 0), (0, 0.8, 0), step=5), Material("mirror", mirror=0.9)),
        with_material(box(0.8, 0.03, 0.8), Material("panel", (0.8, 0.8, 0.8), emission=(5.0, 4.0, 3.0))).placed(
            0.0, 2.5, 0.2
        ),
    ]


def scene(meshes: list[Mesh]) -> Scene:
    return Scene(tuple(Item(str(k), "wall", mesh) for k, mesh in enumerate(meshes)), (), DARK)


def test_equal_light_has_no_deviation_and_a_factor_its_own() -> None:
    truth = np.random.default_rng(0).uniform(0.5, 2, (50, 3))
    same = deviation(truth, np.stack([truth, truth]))
    assert (same.points, same.mean, same.median, same.noise) == (50, 0, 0, 0)
    brighter = deviation(1.1 * truth, np.stack([truth, truth]))
    assert brighter.mean == pytest.approx(0.1)
    assert brighter.median == pytest.approx(0.1)
    assert brighter.less_noise == pytest.approx(0.1)


def test_noise_of_the_reference_is_separated() -> None:
    """A reference of 10 % noise in each half: of their mean 7.1 %, whose mean size is 5.6 %."""
    rng = np.random.default_rng(1)
    truth = np.ones((20_000, 3))
    halves = 1 + 0.1 * rng.standard_normal((2, 20_000, 1)) * np.ones(3)
    measured = deviation(truth, halves)
    assert measured.noise == pytest.approx(0.0564, rel=0.03)
    assert measured.mean == pytest.approx(measured.noise, rel=0.03)
    shifted = deviation(1.1 * truth, halves)
    assert shifted.less_noise == pytest.approx(0.1, rel=0.1)
    assert measured.rms < 0.02  # of 20,000 points: one standard deviation is 0.9 %
    # Exact but for the noise of what it is divided by, which at 7 % adds an eighth.
    assert shifted.rms == pytest.approx(0.1125, rel=0.02)
    assert deviation(1.1 * truth, 1 + 0.2 * (halves - 1)).rms == pytest.approx(0.1, rel=0.01)


def test_a_black_points_error_is_bounded() -> None:
    halves = np.ones((2, 100, 3))
    halves[:, 0] = 0
    measured = deviation(np.ones((100, 3)), halves)
    assert measured.mean == pytest.approx(1 / 0.02 / 100, rel=0.02)
    with pytest.raises(ValueError, match="no points"):
        deviation(np.ones((0, 3)), np.ones((2, 0, 3)))


def test_pooled_figures_are_weighted_by_points() -> None:
    first, second = np.ones((30, 3)), np.ones((10, 3))
    parts = [deviation(1.1 * first, np.stack([first, first])), deviation(1.5 * second, np.stack([second, second]))]
    together = present(pooled(parts))
    assert together.points == 40
    assert together.mean == pytest.approx(0.2)
    assert together.rms == pytest.approx(np.sqrt(0.75 * 0.01 + 0.25 * 0.25))
    assert pooled([]) is None


def test_irradiance_under_an_even_sky_is_pi_for_all_26_normals() -> None:
    normals = cube_normals()
    assert len(np.unique(normals.round(6), axis=0)) == 26
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    received = irradiance(np.ones((60, 120, 3), np.float32), normals)
    np.testing.assert_allclose(received, np.pi, rtol=2e-3)
    above = np.where(panorama_directions(60)[..., 1:2] > 0, np.float32(1), np.float32(0)).repeat(3, axis=2)
    np.testing.assert_allclose(irradiance(above, np.array([[0.0, 1, 0], [0, -1, 0], [1, 0, 0]]))[:, 0],
                               [np.pi, 0, np.pi / 2], atol=5e-3)  # fmt: skip


def test_pixels_are_classified_by_surface() -> None:
    tracer = Tracer(scene(box_room()))
    kinds = surface_kinds(tracer, CAMERA, pose(0, 1.2, 1.2))
    rows, columns = np.mgrid[:32, :40]
    # From z = 1.2 the far wall is 3.2 m away: 9.4 pixels a metre, its foot at row 16 + 1.2 * 9.4.
    foot = 16 + 1.2 * 30 / 3.2
    inside = (columns > 20 - 2 * 9.3 + 1) & (columns < 20 + 2 * 9.3 - 2)
    mirror = (columns >= 20 + 0.5 * 9.3) & (columns <= 20 + 1.3 * 9.3) & (rows >= 10) & (rows <= 20)
    wall = inside & (rows > 5) & (rows < foot - 2) & ~mirror
    assert kinds.diffuse[wall].all()
    assert kinds.coated[inside & (rows > foot + 1)].all()
    assert not kinds.coated[rows < foot - 1].any()
    of_mirror = (columns > 20 + 0.75 * 9.4) & (columns < 20 + 1.05 * 9.4) & (rows > 13) & (rows < 17)
    assert of_mirror.any()
    assert not (kinds.diffuse | kinds.coated)[of_mirror].any()
    edge = np.abs(rows + 0.5 - foot) < 0.5
    assert not (kinds.diffuse | kinds.coated)[edge & inside].any()


def test_lights_and_the_sky_are_not_classified() -> None:
    panel = with_material(
        rectangle((-3, -3, -2), (6, 0, 0), (0, 6, 0), step=7), Material("panel", emission=(1.0, 1.0, 1.0))
    )
    kinds = surface_kinds(Tracer(scene([panel])), CAMERA, pose(0, 0, 0))
    assert not (kinds.diffuse | kinds.coated).any()
    away = pose(0, 0, -3)
    assert not surface_kinds(Tracer(scene([panel])), CAMERA, away).diffuse.any()


def test_panes_are_removed_also_from_shared_meshes() -> None:
    pane = with_material(rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), step=2), Material("pane", glass=True))
    frame = with_material(rectangle((1, 0, 0), (1, 0, 0), (0, 1, 0), step=2), WHITE)
    whole = scene([frame, pane, Mesh.joined([frame, pane])])
    left = without_glass(whole)
    assert [len(item.mesh.faces) for item in left.items] == [2, 2]
    assert not any(item.mesh.materials[k].glass for item in left.items for k in item.mesh.face_materials)
    assert left.openings == whole.openings


@pytest.mark.slow
@pytest.mark.statistical
def test_both_renderers_agree_in_a_small_room() -> None:
    """Frame and probe of a box room with a panel, a mirror and a coated floor; few paths, wide bounds."""
    room = check_view(
        scene(box_room()), replace(CAMERA, cy=6.0), pose(0.2, 1.2, 1.2), np.array([-0.5, 1.0, 0.3]),
        samples=16, paths=120_000, probe_height=48, name="box",
    )  # fmt: skip
    assert room.diffuse is not None
    assert room.coated is not None
    # A frame so small has cells 15 cm wide; with 1,000 paths a block, 7 to 8 % were measured.
    assert room.diffuse.blocks.less_noise < 0.13
    assert room.coated.blocks.less_noise < 0.16
    # With 16 paths a pixel, 6 % were measured with either variant.
    assert abs(room.diffuse.bias) < 0.1
    # Of 48 x 96 pixels, 8 paths each, the sum is known to 1 %.
    assert room.probe.irradiance < 0.06
    assert room.frame.reference.shape == (32, 40, 3)
    report = CheckReport((room, replace(room, coated=None)), ())
    assert report.probe().irradiance == pytest.approx(room.probe.irradiance)
    both, coated = report.diffuse(), report.coated()
    assert both is not None
    assert coated is not None
    assert both.pixels.points == 2 * room.diffuse.pixels.points
    assert coated.pixels.mean == pytest.approx(room.coated.pixels.mean)


@pytest.mark.slow
def test_the_sun_is_added_to_the_references_panorama() -> None:
    """A probe on which the sun shines through a roof window: most of its light is the disc, by both."""
    sun = Sun(np.array([0.1, 0.99, 0.1]) / np.linalg.norm([0.1, 0.99, 0.1]), (80.0, 70.0, 60.0))
    meshes = [mesh for k, mesh in enumerate(box_room()) if k not in (1, 7)]
    roof = Opening(np.array([-2.0, 2.6, -2]), np.array([0, 0, 4.0]), np.array([4.0, 0, 0]))
    sky = Sky(np.full((8, 16, 3), 2.0, np.float32), sun)
    sunlit = Scene(tuple(Item(str(k), "wall", mesh) for k, mesh in enumerate(meshes)), (roof,), sky)
    room = check_view(
        sunlit, CAMERA, pose(0, 1.2, 1.2), np.array([0.0, 1.0, 0.0]), samples=4, paths=4000, probe_height=16
    )
    above = np.array([[0.0, 1.0, 0.0]])
    for panorama in (room.panorama.ours, room.panorama.reference):
        # The disc alone, in a pixel 6 degrees off the zenith.
        assert panorama[0].max() > 100
        assert luminance(irradiance(panorama, above))[0] > 0.9 * 70 * sun.direction[1]
    assert room.probe.irradiance < 0.1
    assert len(Reference(sunlit).sun_seen(np.array([0.0, 1.0, 0.0]), samples=16)) == 16
    assert len(Reference(sunlit).sun_seen(np.array([0.0, -1.0, 0.0]), samples=16)) == 0
