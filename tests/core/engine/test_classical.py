"""The classical model: a mean over the frames that observed a voxel, and light in every direction."""

import numpy as np
import pytest

from roomlight.engine.models.classical import ClassicalProbe, ClassicalVolume
from roomlight.engine.models.interface import Rendered
from roomlight.engine.panorama.blend import PanoramaState, PartialPanorama, accumulate, unseen_depth_m
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid, initial_volume
from roomlight.engine.volume.sglv import render_panorama
from rooms import BoxRoom, camera_at

ROOM = BoxRoom()
FRAME = ROOM.frame(camera_at((0.3, 1.4, 0.2)), width=80, height=60)
GRID = VolumeGrid.from_frame(FRAME, shape=(16, 15, 21))


def _updated(classical):
    classical.update()
    return classical.sglv


def test_one_frame_is_its_own_volume():
    classical = ClassicalVolume(GRID)
    volume = initial_volume(GRID, FRAME, out=classical.volume).copy()
    sglv = _updated(classical)
    np.testing.assert_allclose(sglv.alpha, volume[3], atol=1e-6)
    np.testing.assert_allclose(np.moveaxis(sglv.lobes[..., :3], -1, 0) * volume[3], volume[:3], atol=1e-5)
    assert (sglv.lobes[..., 3:] == 0).all()


def _estimate(classical, state, partial, position):
    rendered = Rendered(*render_panorama(_updated(classical), position, height=32, far=classical.far))
    return ClassicalProbe().estimate(state, rendered, partial, depth_max_m=GRID.depth_max_m)


def test_hdr_is_complete_and_details_have_weight_one_where_seen():
    classical = ClassicalVolume(GRID)
    initial_volume(GRID, FRAME, out=classical.volume)
    position = (0.1, 1.2, -0.8)
    partial = FrameMesh(FRAME).render_panorama(np.array(position), height=32)
    estimate = _estimate(classical, PanoramaState.fresh(32, GRID.depth_max_m), partial, position)
    assert (estimate.weight == partial.mask).all()
    assert estimate.hdr.min() > 0
    # the fill is a convex combination of observed values: no value leaves their range
    assert estimate.hdr.max() <= FRAME.image.max() * 1.01
    np.testing.assert_allclose(estimate.hdr[partial.mask], partial.radiance[partial.mask], rtol=1e-3, atol=1e-3)


def test_a_uniform_room_gives_uniform_light():
    grey = ROOM.frame(camera_at((0.3, 1.4, 0.2)), width=80, height=60)
    grey.image[:] = 0.4
    classical = ClassicalVolume(GRID)
    initial_volume(GRID, grey, out=classical.volume)
    position = (0.1, 1.2, -0.8)
    partial = FrameMesh(grey).render_panorama(np.array(position), height=32)
    state = PanoramaState.fresh(32, GRID.depth_max_m)
    estimate = _estimate(classical, state, partial, position)
    # Colour and opacity are interpolated separately (equation 1), so that the volume darkens where opaque voxels
    # meet empty black ones; with a weight of a tenth, 2.2 % remain in the fill.
    np.testing.assert_allclose(estimate.hdr, 0.4, rtol=0.03)
    unseen_m = unseen_depth_m(GRID.depth_max_m)
    accumulate(state, partial, hdr=estimate.hdr, weight=estimate.weight, unseen_m=unseen_m)
    np.testing.assert_allclose(state.radiance, 0.4, rtol=0.03)
    np.testing.assert_allclose(state.radiance[partial.mask], 0.4, rtol=1e-5)


def test_nothing_observed_gives_no_light_and_no_error():
    classical = ClassicalVolume(GRID)
    frame = ROOM.frame(camera_at((0.3, 1.4, 0.2)), width=80, height=60)
    frame.depth_m[:] = 0
    partial = FrameMesh(frame).render_panorama(np.zeros(3), height=32)
    estimate = _estimate(classical, PanoramaState.fresh(32, GRID.depth_max_m), partial, (0.0, 1.0, 0.0))
    assert (estimate.hdr == 0).all()
    assert (estimate.weight == 0).all()


def test_unobserved_light_does_not_jump():
    """The fill of the first frame is taken fully, that of a later frame by half."""
    state, probe = PanoramaState.fresh(16, 3.0), ClassicalProbe()
    rendered = Rendered(np.zeros((16, 32, 3), np.float32), np.ones((16, 32), np.float32))
    mask = np.zeros((16, 32), bool)
    mask[4:8, 4:8] = True

    def blend_frame(value):
        seen = mask.astype(np.float32)
        partial = PartialPanorama(np.float32(value) * np.dstack([seen] * 3), mask, seen)
        estimate = probe.estimate(state, rendered, partial, depth_max_m=3.0)
        accumulate(state, partial, hdr=estimate.hdr, weight=estimate.weight, unseen_m=unseen_depth_m(3.0))
        return estimate.hdr[12, 20, 0]

    assert blend_frame(0.8) == pytest.approx(0.8, rel=1e-5)
    state.radiance[~mask] = 0.2  # as after an earlier, darker fill
    assert blend_frame(0.8) == pytest.approx(0.5, rel=1e-5)
