"""A camera that walks from a room into the next one, and back."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from present import present
from roomlight.engine.room import LEFT_KEYFRAMES, MOST_LEFT
from roomlight.metrics import log_l2
from rooms import BoxRoom, camera_at, saturated
from sessions import session_from, session_of, state_of

HEIGHT = 48
PROBE = (0.3, 1.0, -0.5)
DEEP_M = 5.0
DIM = 0.6
"""The second room is this much darker, and its colours are others."""
FIRST = ((0.3, 1.0, 0.5), (-0.8, 1.2, -1.0))
SECOND = ((0.3, 1.0, -5.5), (-0.8, 1.2, -4.5), (1.5, 0.8, -6.2))


@dataclass(frozen=True)
class TwoRooms(BoxRoom):
    """A box room around the origin, and another one behind a doorway in its wall at -z."""

    def cast(self, origins, directions):
        origins, directions = np.broadcast_arrays(np.asarray(origins, np.float64), np.asarray(directions, np.float64))
        second = origins[..., 2] < -DEEP_M / 2
        radiance, distance = self._inside(origins, directions, second)
        points = origins + distance[..., None] * directions
        through = abs(points[..., 2] + DEEP_M / 2) < 1e-3
        through &= (abs(points[..., 0]) < 0.5) & (points[..., 1] < 2.1)
        points = np.where(through[..., None], points, origins)
        behind, farther = self._inside(points, directions, second ^ through)
        distance = np.where(through, distance + farther, distance)
        return np.where(through[..., None], behind, radiance), distance.astype(np.float32)

    def _inside(self, origins, directions, second):
        shift = np.array([0.0, 0.0, DEEP_M])
        radiance, distance = BoxRoom(lamp=((0.3, 1.6, 2.5), 0.35)).cast(origins, directions)
        other = BoxRoom(lamp=((1.0, 2.2, -2.5), 0.3), lamp_radiance=12).cast(origins + shift, directions)
        radiance = np.where(second[..., None], DIM * other[0][..., [2, 0, 1]], radiance)
        return radiance, np.where(second, other[1], distance)


ROOMS = TwoRooms()


def _walk(shares, start=0):
    """A turn in the first room, through the doorway, a turn in the second one: shares of the way, from 0 to 1."""
    frames = []
    for index, share in enumerate(shares, start):
        z = np.interp(share, [0, 0.35, 0.6, 1], [1.2, 0.5, -4.2, -5.6])
        yaw = np.interp(share, [0, 0.35, 0.6, 1], [-180, 0, 0, 360])
        frames.append(saturated(ROOMS.frame(camera_at((0.1, 1.4, z), yaw, -5), index=index)))
    return frames


@pytest.fixture(scope="module")
def walk():
    return _walk(np.linspace(0, 1, 24))


def _error(session, handles, probes):
    truth = [ROOMS.panorama(probe, HEIGHT)[0] for probe in probes]
    lights = [session.light(handle).reflection for handle in handles]
    return float(np.mean([log_l2(light, true) for light, true in zip(lights, truth, strict=True)]))


@pytest.fixture(scope="module")
def walked(walk):
    """A session at the end of the walk, its errors in the second room, and those of a session begun there."""
    whole, begun = session_of(probes=FIRST, height=HEIGHT), session_of(height=HEIGHT)
    enters = next(frame.index for frame in walk if frame.camera_to_world[2, 3] < -DEEP_M / 2)
    handles, begun_handles, errors = list[int](), list[int](), []
    for frame in walk:
        whole.push(frame)
        if frame.index == enters:
            handles = [whole.track(probe) for probe in SECOND]
            begun_handles = [begun.track(probe) for probe in SECOND]
        if frame.index >= enters:
            begun.push(frame)
            errors.append((_error(whole, handles, SECOND), _error(begun, begun_handles, SECOND)))
    return whole, np.array(errors)


def test_the_second_room_is_as_for_a_session_begun_there(walked):
    whole, errors = walked
    assert whole.rooms_left == 1
    assert errors[:, 0].mean() <= 1.1 * errors[:, 1].mean()
    assert errors[-1, 0] <= 1.1 * errors[-1, 1]


def test_the_first_room_is_remembered(walked, walk):
    whole, _ = walked
    there = session_of(walk[:7], probes=FIRST, height=HEIGHT)
    late = [log_l2(whole.light_at(probe).reflection, there.light_at(probe).reflection) for probe in FIRST]
    assert max(late) < 0.02
    assert len(whole.snapshot().left[0].frames) <= LEFT_KEYFRAMES


def _far(number, index):
    """A view in a room of its own, 20 m from the one before."""
    frame = BoxRoom().frame(camera_at((0.3, 1.4, 0.2)), index=index)
    pose = frame.camera_to_world.copy()
    pose[0, 3] += 20 * number
    return replace(frame, camera_to_world=pose)


def test_the_way_back_ends_in_the_first_rooms_volume():
    session, handle = session_of([_far(0, 0)], probes=[PROBE], height=HEIGHT), 0
    first, seen = present(session.grid), session.light(handle)
    session.push(_far(1, 1))
    assert present(session.grid).volume_to_world[0, 3] == pytest.approx(first.volume_to_world[0, 3] + 20)
    session.push(_far(0, 2))
    np.testing.assert_array_equal(present(session.grid).volume_to_world, first.volume_to_world)
    assert session.rooms_left == 1
    truth, _ = BoxRoom().panorama(PROBE, HEIGHT)
    assert log_l2(session.light(handle).reflection, truth) <= 1.05 * log_l2(seen.reflection, truth)


def test_rooms_beyond_the_limit_are_forgotten_and_their_probes_keep_what_was_seen():
    session, handle = session_of([_far(0, 0)], probes=[PROBE], height=HEIGHT), 0
    seen = session.light(handle)
    for number in range(1, MOST_LEFT + 2):
        session.push(_far(number, number))
        assert session.rooms_left == min(number, MOST_LEFT)
    (probe,) = session.snapshot().probes
    assert probe.forgotten
    assert probe.room == MOST_LEFT
    light = session.light(handle)
    sure = seen.observed > 0.9
    assert sure.any()
    np.testing.assert_allclose(light.reflection[sure], seen.reflection[sure], rtol=0.02, atol=0.01)
    loaded = session_from(state_of(session))
    for same in (session, loaded):
        same.push(_far(0, 9))
    assert state_of(loaded) == state_of(session)


def test_a_room_is_remembered_though_a_lowered_phone_passed_floors_since():
    floors = [_wall(number, 1.0, z=-6.0 - 2.5 * number) for number in range(1, 2 * MOST_LEFT + 2)]
    session = session_of([_far(0, 0), *floors], probes=[PROBE], height=HEIGHT)
    assert session.rooms_left == MOST_LEFT
    (probe,) = session.snapshot().probes
    assert not probe.forgotten
    assert session.light_at(PROBE).coverage > 0


def test_a_place_that_lay_in_no_volume_is_not_forgotten_when_the_camera_goes_to_another_room():
    below = (0.3, -30.0, 0.2)
    session = session_of([_far(0, 0), _far(1, 1)], probes=[below], height=HEIGHT)
    (probe,) = session.snapshot().probes
    assert not probe.forgotten


def test_the_room_that_was_just_left_is_remembered_though_it_is_small():
    session = session_of([_far(0, 0), _far(1, 1), _wall(2, 1.0, z=-20), _wall(3, 1.0, z=-40)], height=HEIGHT)
    assert session.rooms_left == MOST_LEFT
    assert session.light_at((0.0, 0.0, -20.5)).coverage > 0.05


def test_a_room_that_was_left_is_one_with_a_later_one_around_it():
    """The light has changed since: what was kept of the room would show it as it was."""
    before = [_wall(0, 2.0), _wall(1, 2.0, z=-8)]
    around = [_wall(2 + n, 30.0, z=-16, yaw=180, light=0.9) for n in (0, 1)]
    session = session_of([*before, *around], height=16)
    assert session.rooms_left == 1


def test_a_frame_without_depth_begins_no_room():
    blind = replace(_far(1, 1), depth_m=np.zeros((120, 160), np.float32))
    session = session_of([_far(0, 0), blind], height=HEIGHT)
    assert session.rooms_left == 0
    session.push(_far(2, 2))
    assert session.rooms_left == 1


def _wall(index, depth_m, *, z=0.0, yaw=0.0, light=0.3):
    """A grey wall at one depth."""
    frame = replace(_far(0, index), camera_to_world=camera_at((0, 0, z), yaw))
    return replace(frame, image=np.full_like(frame.image, light), depth_m=np.full_like(frame.depth_m, depth_m))


def test_a_wall_beyond_a_close_ups_volume_is_seen_again_from_the_rooms_own():
    frames = [
        _wall(0, 1.6, yaw=180),
        _wall(1, 4.0),
        _wall(2, 3.0, z=-1),
        *(_wall(3 + n, 3, z=-1, light=0.9) for n in (0, 1)),
    ]
    session = session_of(frames, probes=[(0.0, 0.0, -0.9)], height=16)
    assert session.rooms_left == 1
    state = session.panorama_state(0)
    assert (state.radiance[8, 8, 0], state.depth_m[8, 8]) == pytest.approx((0.9, 3.1), rel=0.01)


@pytest.mark.parametrize(
    ("first_m", "columns", "rest_m", "depth_max_m"),
    [(0.4, 160, 0.4, 4.0), (0.4, 64, 0.4, 0.5), (0.4, 64, 0.0, 0.5), (1.6, 160, 1.6, 1.6)],
    ids=["room", "view through a door", "little depth", "look out of a room"],
)
def test_a_close_ups_volume_gives_way_to_the_rooms_own_though_the_camera_stays(first_m, columns, rest_m, depth_max_m):
    turned = _wall(1, 4.0 if first_m < 1 else 30.0, yaw=90)
    turned.depth_m[:, columns:] = rest_m
    options = {"probes": [PROBE], "height": 16, "unknown_depth": "drop"}
    session = session_of([_wall(0, first_m), turned], **options)
    assert present(session.grid).depth_max_m == pytest.approx(depth_max_m)
    assert session.rooms_left == 0
    loaded = session_from(state_of(session))
    for same in (session, loaded):
        same.push(_wall(2, 4.0, yaw=180))
    assert state_of(loaded) == state_of(session)


def test_a_room_that_was_left_without_a_keyframe_has_light_without_coverage():
    sparse = BoxRoom().frame(camera_at((0.3, 1.4, 0.2)), width=320, height=240)
    sparse.depth_m[1::2] = 0  # of which a mesh takes every second row
    session = session_of([sparse, _far(1, 1)], height=16, unknown_depth="drop")
    assert session.rooms_left == 1
    assert session.light_at(PROBE).coverage == 0


@pytest.mark.parametrize("model", ["classical", "video"])
def test_a_saved_walk_goes_on_with_the_same_bits(model, tiny_video, walk):
    weights = tiny_video if model != "classical" else None
    walk = walk[::2]
    options = {"model": model, "provider": "cpu", "height": 24, "weights": weights}
    whole = session_of(walk[:9], probes=(FIRST[0], SECOND[0]), **options)
    assert whole.rooms_left == 1
    loaded = session_from(state_of(whole))
    assert state_of(loaded) == state_of(whole)
    for session in (whole, loaded):
        for frame in walk[9:]:
            session.push(frame)
    assert state_of(loaded) == state_of(whole)
    for position in (*FIRST, *SECOND):
        assert (loaded.light_at(position).reflection == whole.light_at(position).reflection).all()
