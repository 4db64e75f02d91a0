"""Networks that serve every model: what is refused, and several threads at once."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from part_models import write_part
from roomlight.engine.models.choosing import lighting_model
from roomlight.engine.models.network_volume import NetworkModel
from roomlight.engine.networks.clipping import shipped_clipping
from roomlight.engine.networks.graphs import SHIPPED, PartForm, load_graphs, load_part
from roomlight.engine.panorama.prior import COLUMNS, FILE, ROWS, PanoramaPrior
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ModelError
from rooms import BoxRoom, camera_at, saturated
from sessions import session_of

LAMP = BoxRoom(lamp=((0.5, 1.5, -2.5), 0.5))


def clipped_frames(count):
    poses = [camera_at((0.1 * i, 1.4, 1.0), yaw_degrees=3.0 * i) for i in range(count)]
    return [saturated(LAMP.frame(pose, index=index)) for index, pose in enumerate(poses)]


def test_other_folders_are_refused_with_the_reason(tmp_path):
    objects, untrained = (write_part(tmp_path / f"part-{steps}", "objects", steps=steps) for steps in (1, 0))
    graph = load_part(objects, "objects", provider="cpu")
    assert (graph.inputs, graph.outputs) == ({"panels": (1, 10, 60, 120)}, {"change": (1, 3, 60, 120)})
    refused: tuple[tuple[Path, PartForm, str], ...] = (
        (objects, "clipping", "networks of the form objects, not clipping"),
        (SHIPPED / "single", "objects", "of the form single, not objects"),
        (tmp_path / "nowhere", "clipping", r"nowhere/model\.json: cannot be read.*roomlight export"),
        (untrained, "objects", r"never trained.*roomlight train objects"),
    )
    for folder, form, message in refused:
        with pytest.raises(ModelError, match=message):
            load_part(folder, form, provider="cpu")
    with pytest.raises(ModelError, match=rf"objects, which no model runs by itself; use it with `parts` {tmp_path}$"):
        load_graphs(objects, provider="cpu")
    with pytest.raises(ModelError, match=r"holds clipping, objects, .*depth and no model; use it with `parts`"):
        load_graphs(SHIPPED)


def test_threads_share_the_network_and_get_the_same():
    model = shipped_clipping("cpu")
    frames = clipped_frames(8)
    alone = [model.restore(frame, frame.depth_m).image for frame in frames]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda frame: model.restore(frame, frame.depth_m).image, frames * 3))
    for index, image in enumerate(together):
        assert np.array_equal(image, alone[index % 8])


def test_sessions_take_their_parts_from_a_folder(tmp_path):
    digests = set[str]()
    for white, change in ((5.0, 0.5), (5.0, 0.25), (3.0, 0.25)):  # trained again, into the same folder
        for form in ("clipping", "objects"):
            shutil.rmtree(tmp_path / form, ignore_errors=True)
            write_part(tmp_path / form, form, constant=np.log(white) if form == "clipping" else change)
            (tmp_path / form / ".#notes").symlink_to("an-editor's-lock")
        session = session_of(clipped_frames(1), parts=tmp_path, provider="cpu", height=32)
        ((_, mesh),) = session.meshes
        assert mesh.texture.image.max() == pytest.approx(white, rel=1e-3)
        handle = session.track((0.3, 0.4, -1.0))
        state = session.panorama_state(handle)
        gain = np.log1p(session.light(handle).panorama) - np.log1p(state.radiance)
        np.testing.assert_allclose(gain[state.observed == 0], change, rtol=1e-4, atol=1e-5)
        digests.add(session.light(handle).digest())
    assert len(digests) == 3


def test_a_part_that_a_folder_lacks_is_the_packages(tmp_path):
    options = SessionOptions(parts=tmp_path, provider="cpu")
    with pytest.raises(ModelError, match="has none of the folders clipping, objects, prior"):
        Session(options)
    (tmp_path / "clipping").mkdir()
    with pytest.raises(ModelError, match=r"clipping/model\.json: cannot be read"):
        Session(options)
    (tmp_path / "clipping").rmdir()
    for mean in (2, 3):
        PanoramaPrior(np.full(ROWS, mean, np.float32), np.zeros((ROWS, ROWS, COLUMNS), np.float32)).save(
            tmp_path / "prior" / FILE
        )
        model = lighting_model(options)
        assert isinstance(model, NetworkModel)
        assert model.prior.mean[0] == mean
    assert Session(options).networks == Session(replace(options, parts=None)).networks
