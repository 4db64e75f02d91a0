"""Frames of other exposure: a lamp of 20 x white that one frame clips and another one shows."""

import dataclasses
import itertools

import cv2
import numpy as np
import pytest

from part_models import write_part
from present import present
from roomlight.conventions import LUMINANCE, panorama_directions
from roomlight.engine.networks.clipping import shipped_clipping
from roomlight.engine.preparation import restored
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.surface import bracket
from roomlight.engine.surface.bracket import update_keyframes
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.surface.texture import Texture
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid, clipping_buffer, initial_volume
from rooms import BoxRoom, camera_at, saturated

LAMP = ((0.3, 1.6, -2.5), 0.45)
TRUE = 20.0
ROOM = BoxRoom(lamp=LAMP, lamp_radiance=TRUE)
PROBE = (0.3, 1.4, 0.2)
DARK = 1 / 32
CLASSICAL = SessionOptions(model="classical", provider="cpu", height=48)


@pytest.fixture(scope="module")
def twice_white(tmp_path_factory):
    """Options whose network says of every clipped pixel that it is twice as bright as white."""
    parts = tmp_path_factory.mktemp("parts")
    write_part(parts / "clipping", "clipping", constant=float(np.log(2)))
    write_part(parts / "objects", "objects")  # changes nothing
    return dataclasses.replace(CLASSICAL, parts=parts)


def prepared(frame, earlier=()):
    """The frame as a session prepares it, with the depth that it has."""
    return restored(frame, frame.depth_m, earlier, clipping=shipped_clipping("cpu"))


def shown(exposure, *, position=(0.3, 1.4, 0.2), yaw=0.0, index=0, room=ROOM, width=160):
    """A camera's frame at this exposure: what is above its white is clipped there."""
    frame = room.frame(camera_at(position, yaw), index=index, width=width, height=width * 3 // 4)
    return saturated(frame, 1 / exposure)


def in_lamp(height=48, radius_deg=5.0):
    to_lamp = np.array(LAMP[0]) - PROBE
    return panorama_directions(height) @ (to_lamp / np.linalg.norm(to_lamp)) > np.cos(np.radians(radius_deg))


def lamp_voxels(grid):
    """Voxels in whose middle the lamp's disc lies, and which are within the surface's band."""
    centres = grid.centres_m() @ grid.volume_to_world[:3, :3].T + grid.volume_to_world[:3, 3]
    away = np.linalg.norm(centres[..., :2] - np.array(LAMP[0][:2]), axis=-1)
    return (away < LAMP[1] / 2) & (abs(centres[..., 2] - LAMP[0][2]) < grid.edge_m)


def streamed(*frames, options=CLASSICAL):
    session = Session(options)
    session.track(PROBE)
    for index, frame in enumerate(frames):
        session.push(dataclasses.replace(frame, index=index))
    return session


MOVED = {"position": (-0.2, 1.3, 0.6), "yaw": -8.0}


@pytest.mark.parametrize("exposures", [(1, DARK), (DARK, 1), (1, DARK, 1), (1, 1, 1 / 4, DARK, 1)])
@pytest.mark.parametrize("moved", [{}, MOVED], ids=["in place", "moving"])
def test_a_short_exposure_shows_the_lamp_in_any_order(exposures, moved):
    poses = itertools.cycle([{}, moved])
    session = streamed(*(shown(exposure, **pose) for exposure, pose in zip(exposures, poses, strict=False)))
    lamp = in_lamp()
    assert lamp.sum() > 3
    np.testing.assert_allclose(session.light(0).panorama[lamp], TRUE, rtol=0.05)
    np.testing.assert_allclose(session.light_at(PROBE).panorama[lamp], TRUE, rtol=0.05)
    sglv = present(session.sglv)
    voxels = lamp_voxels(sglv.grid) & (sglv.alpha > 0.5)
    assert voxels.sum() > 3
    np.testing.assert_allclose(sglv.lobes[voxels][:, :3], TRUE, rtol=0.05)


@pytest.mark.parametrize("shortest", [1, 1 / 4])
def test_still_clipped_is_an_estimate_from_the_shortest_exposures_white(twice_white, shortest):
    """At a quarter of the exposure the lamp is clipped at 4: every estimate starts from there."""
    session = streamed(shown(1), shown(shortest, **MOVED), shown(1), options=twice_white)
    for light in (session.light(0), session.light_at(PROBE)):
        np.testing.assert_allclose(light.panorama[in_lamp()], 2 / shortest, rtol=0.05)


def test_learned_light_starts_from_the_shortest_exposure():
    """The network knows nothing of the bracket: its estimate is at least what the shortest exposure measured."""
    long, short = shown(1), shown(1 / 4, **MOVED)
    alone, together = streamed(long), streamed(long, short, long)
    lamp = alone.light(0).reflection[in_lamp()]
    assert lamp.min() > 1
    for light in (together.light(0), together.light_at(PROBE)):
        assert light.reflection[in_lamp()].min() >= 4
        assert np.median(light.reflection[in_lamp()]) > 1.5 * np.median(lamp)


def test_a_keyframe_keeps_its_bracket():
    bright, dark = shown(1), shown(DARK, **MOVED)
    key = FrameMesh(prepared(bright))
    clipped = bright.clipped.sum()
    taken = update_keyframes(FrameMesh(prepared(dark)), [key])
    assert taken > 0.95 * clipped
    true = ROOM.frame(bright.camera_to_world, width=160, height=120).image
    wrong = abs(key.texture.image / true - 1).max(axis=-1) > 0.05
    # pixels at the lamp's rim, where the other camera's pixel is half wall
    assert wrong.sum() < 0.05 * clipped
    np.testing.assert_array_equal(key.texture.image[~bright.clipped], bright.image[~bright.clipped])


def test_a_keyframe_with_a_taken_bound_is_a_frame_of_the_next_room(monkeypatch):
    """Rounding puts a bound just above the luminance of its radiance."""
    frame = prepared(shown(1))
    key = FrameMesh(frame)

    def raise_bounds(points, *_):
        points.bound[:] = np.nextafter(points.radiance @ LUMINANCE, np.float32(np.inf))
        return len(points.bound)

    monkeypatch.setattr(bracket, "take_radiance", raise_bounds)
    assert update_keyframes(FrameMesh(prepared(shown(DARK))), [key]) > 0
    guessed = present(key.texture.guessed)
    assert dataclasses.replace(frame, guessed=guessed).guessed is guessed  # which refuses negative luminance


def test_a_frame_takes_clipped_pixels_from_earlier_ones():
    bright, dark = shown(1, **MOVED), shown(DARK)
    frame = prepared(bright, [FrameMesh(prepared(dark))])
    assert frame.clipped.sum() < 0.05 * bright.clipped.sum()
    now_known = bright.clipped & ~frame.clipped
    np.testing.assert_allclose(frame.image[now_known], TRUE, rtol=0.05)
    assert frame.guessed is None or (frame.guessed[~frame.clipped] == 0).all()
    np.testing.assert_array_equal(frame.image[~bright.clipped], bright.image[~bright.clipped])


HIDDEN = BoxRoom(block=((-0.6, 0.8, -2.0), (1.2, 2.4, -1.9)), lamp=((0.3, 1.6, -1.9), 0.8), lamp_radiance=30.0)
"""A lamp on a block half a metre before the wall's lamp hides it from the second camera."""


@pytest.mark.parametrize("room", [HIDDEN, BoxRoom()], ids=["another surface", "switched off"])
def test_another_lamp_or_none_gives_no_radiance(room):
    key = FrameMesh(prepared(shown(1)))
    assert update_keyframes(FrameMesh(prepared(shown(DARK, room=room))), [key]) == 0


def test_the_rim_of_a_lamp_that_both_clip_is_no_evidence():
    """A camera four pixels off its pose, a lamp with a soft rim, twice the white."""
    sharp = shown(1)
    soft = cv2.blur(np.where(sharp.clipped[..., None], np.float32(TRUE), sharp.image), (15, 15))
    bright, later = (saturated(dataclasses.replace(sharp, image=soft), white) for white in (1.0, 2.0))
    moved = dataclasses.replace(later, camera_to_world=camera_at((0.2, 1.4, 0.2)))
    key = FrameMesh(prepared(bright))
    update_keyframes(FrameMesh(prepared(moved)), [key])
    resolved = bright.clipped & ~present(key.texture.clipped)
    assert (soft[resolved] < 2.0).all()


def test_the_number_of_projections_is_bounded_and_each_keyframe_has_its_turn(monkeypatch):
    counted = []
    take = bracket.take_radiance
    monkeypatch.setattr(bracket, "take_radiance", lambda p, *rest: counted.append(len(p.world)) or take(p, *rest))
    bright, dark = shown(1), FrameMesh(prepared(shown(DARK)))
    monkeypatch.setattr(bracket, "MAX_PROJECTIONS", int(bright.clipped.sum()))
    lost = saturated(dataclasses.replace(bright, image=np.full_like(bright.image, 2)), 1)  # clipped all over
    keys = [FrameMesh(prepared(frame)) for frame in (lost, bright, lost, bright)]
    for turn in range(2, 12, 2):  # every second frame is a dark one
        counted.clear()
        update_keyframes(dark, keys, turn=turn)
        assert 0 < sum(counted) <= bracket.MAX_PROJECTIONS
    assert [key.texture.clipped is None for key in keys] == [False, True, False, True]


def test_meshes_that_do_not_show_the_clipped_pixels_are_not_projected_into(monkeypatch):
    bright, dark = shown(1), FrameMesh(prepared(shown(DARK)))
    monkeypatch.setattr(bracket, "MAX_PROJECTIONS", int(1.5 * bright.clipped.sum()))
    away = [FrameMesh(prepared(shown(DARK, room=BoxRoom(lamp=((0.3, 1.6, 2.5), 0.45)), yaw=180))) for _ in range(3)]
    assert prepared(bright, [dark, *away]).clipped.sum() < 0.05 * bright.clipped.sum()


def test_nothing_clipped_gives_the_same_bits_at_any_exposure():
    """Without a clipped pixel neither frames nor textures nor volumes are touched."""
    dark, bright = shown(DARK), shown(DARK, **MOVED)
    frame = prepared(bright, [FrameMesh(dark)])
    assert frame.image is bright.image
    assert frame.guessed is None
    assert clipping_buffer(VolumeGrid.from_frame(frame), frame) is None
    seen = FrameMesh(frame).render_panorama(np.array(PROBE), height=16)
    assert seen.clipped is None
    assert seen.guessed is None


def test_the_mean_volume_gives_clipped_colour_no_weight():
    frames = [prepared(shown(e)) for e in (1, DARK)]
    grid = VolumeGrid.from_frame(frames[0], shape=(32, 30, 42))
    means = []
    for order in (frames, frames[::-1], [*frames, frames[0], frames[0]]):
        fused, mean = FusedVolume.fresh(grid.shape), np.empty((5, *grid.shape), np.float32)
        for frame in order:
            planes = clipping_buffer(grid, frame)
            volume = initial_volume(grid, frame, clipping=planes)
            fused.add(volume, planes)
        fused.write(mean)
        means.append(mean)
    true = initial_volume(grid, frames[1])
    surface = true[3] > 0.5
    lamp = surface & (true[:3].mean(axis=0) > 19.9 * true[3])
    assert lamp.sum() > 10
    for mean in means:
        np.testing.assert_allclose(mean[:3, lamp] / mean[3, lamp], TRUE, rtol=0.01)


def test_the_volumes_clipped_share_is_the_images():
    frame = prepared(shown(1))
    grid = VolumeGrid.from_frame(frame, shape=(32, 30, 42))
    planes = present(clipping_buffer(grid, frame))
    volume = initial_volume(grid, frame, clipping=planes)
    for plane, image in zip(planes, (frame.clipped, present(frame.guessed)), strict=True):
        grey = np.repeat(image.astype(np.float32)[..., None], 3, axis=2)
        wanted = initial_volume(grid, dataclasses.replace(frame, image=grey, guessed=None))
        np.testing.assert_allclose(plane, wanted[0], atol=1e-5)
    assert (planes[:, volume[3] == 0] == 0).all()


def test_a_texture_knows_its_lower_bound():
    frame = prepared(shown(1 / 4))
    texture = Texture.of(frame)
    np.testing.assert_allclose(texture.bound[frame.clipped], 4.0, rtol=1e-5)
    np.testing.assert_allclose(texture.bound[~frame.clipped], frame.image[~frame.clipped] @ LUMINANCE, rtol=1e-5)
    assert texture.peak == pytest.approx(4.0)
