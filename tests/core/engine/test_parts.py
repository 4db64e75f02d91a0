"""Networks that serve every model: what is refused, several threads at once, and no PyTorch."""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from part_models import write_part
from roomlight.engine.models.choosing import lighting_model
from roomlight.engine.models.network_volume import NetworkModel
from roomlight.engine.networks.clipping import ClippingModel, shipped_clipping
from roomlight.engine.networks.graphs import SHIPPED, PartForm, load_graphs, load_part
from roomlight.engine.panorama.prior import COLUMNS, FILE, ROWS, PanoramaPrior
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ModelError, ProbeError
from rooms import BoxRoom, camera_at

LAMP = BoxRoom(lamp=((0.5, 1.5, -2.5), 0.5))


def clipped_frames(count):
    frames = [LAMP.frame(camera_at((0.1 * i, 1.4, 1.0), yaw_degrees=3.0 * i), index=i) for i in range(count)]
    return [replace(frame, image=np.minimum(frame.image, 1), clipped=frame.image.max(-1) >= 1) for frame in frames]


def test_a_complete_folder_loads(tmp_path):
    graph = load_part(write_part(tmp_path / "part", "objects"), "objects", provider="cpu")
    assert graph.inputs == {"panels": (1, 10, 60, 120)}
    assert graph.outputs == {"change": (1, 3, 60, 120)}


def test_other_folders_are_refused_with_the_reason(tmp_path):
    objects, untrained = (write_part(tmp_path / f"part-{steps}", "objects", steps=steps) for steps in (1, 0))
    refused: tuple[tuple[Path, PartForm, str], ...] = (
        (objects, "clipping", "networks of the form objects, not clipping"),
        (SHIPPED / "single", "objects", "of the form single, not objects"),
        (tmp_path / "nowhere", "clipping", r"nowhere/model\.json: cannot be read.*roomlight export"),
        (untrained, "objects", r"never trained.*roomlight train objects"),
    )
    for folder, form, message in refused:
        with pytest.raises(ModelError, match=message):
            load_part(folder, form, provider="cpu")
    with pytest.raises(ModelError, match="the form objects, which no model runs by itself"):
        load_graphs(objects, provider="cpu")


def test_a_graph_of_another_size_is_refused_when_it_runs(tmp_path):
    folder = write_part(tmp_path / "part", "objects")
    described = json.loads((folder / "model.json").read_text())
    described["form"], described["graphs"] = "clipping", {"clipping": described["graphs"]["objects"]}
    (folder / "model.json").write_text(json.dumps(described))
    (folder / "objects.onnx").rename(folder / "clipping.onnx")
    model = ClippingModel(load_part(folder, "clipping", provider="cpu"))
    (frame,) = clipped_frames(1)
    with pytest.raises(ModelError, match=r"graph clipping has \['panels'\], the engine gives \['planes'\]"):
        model.restore(frame, frame.depth_m)


def test_threads_share_the_network_and_get_the_same():
    model = shipped_clipping("cpu")
    frames = clipped_frames(8)
    alone = [model.restore(frame, frame.depth_m).image for frame in frames]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda frame: model.restore(frame, frame.depth_m).image, frames * 3))
    for index, image in enumerate(together):
        assert np.array_equal(image, alone[index % 8])


def test_sessions_take_their_parts_from_a_folder(tmp_path):
    write_part(tmp_path / "clipping", "clipping", constant=np.log(5.0))
    options = SessionOptions(model="classical", parts=tmp_path, provider="cpu", height=32)
    session = Session(options)
    (frame,) = clipped_frames(1)
    session.push(frame)
    ((_, mesh),) = session.meshes
    assert mesh.texture.image.max() == pytest.approx(5.0, rel=1e-3)


def test_a_part_that_a_folder_lacks_is_the_packages(tmp_path):
    options = SessionOptions(parts=tmp_path, provider="cpu")
    with pytest.raises(ModelError, match="has none of the folders clipping, objects, prior"):
        Session(options)
    (tmp_path / "clipping").mkdir()
    with pytest.raises(ModelError, match=r"clipping/model\.json: cannot be read"):
        Session(options)
    (tmp_path / "clipping").rmdir()
    PanoramaPrior(np.full(ROWS, 2, np.float32), np.zeros((ROWS, ROWS, COLUMNS), np.float32)).save(
        tmp_path / "prior" / FILE
    )
    model = lighting_model(options)
    assert isinstance(model, NetworkModel)
    assert model.prior.mean[0] == 2
    assert Session(options).networks == Session(replace(options, parts=None)).networks


def test_a_panorama_needs_a_frame_and_a_handle():
    session = Session(SessionOptions(height=32))
    handle = session.track((0.0, 1.2, 0.0))
    with pytest.raises(ProbeError, match="no panorama for tracked probe 0: no frame has been pushed yet"):
        session.panorama_state(handle)
    session.push(clipped_frames(1)[0])
    assert session.panorama_state(handle).radiance.shape == (32, 64, 3)
    with pytest.raises(ProbeError, match="no panorama for tracked probe 7: this session tracks 1"):
        session.panorama_state(7)


@pytest.mark.slow
def test_learned_parts_run_without_torch(tmp_path):
    write_part(tmp_path / "clipping", "clipping", constant=1.0)
    write_part(tmp_path / "objects", "objects", constant=0.1)
    code = (
        "import sys; sys.modules['torch'] = None; sys.modules['onnx'] = None\n"
        "import numpy as np; from pathlib import Path\n"
        "from roomlight.camera import Intrinsics; from roomlight.frame import Frame\n"
        "from roomlight.engine.session import Session, SessionOptions\n"
        f"parts = Path({str(tmp_path)!r})\n"
        "frame = Frame(0, np.ones((24, 32, 3), np.float32), np.ones((24, 32), bool), np.ones((24, 32), np.float32),\n"
        "              Intrinsics(30.0, 30.0, 16.0, 12.0, 32, 24), np.eye(4))\n"
        "for options in (SessionOptions(), SessionOptions(parts=parts)):\n"
        "    session = Session(options); session.push(frame)\n"
        "    print(session.model, np.isfinite(session.light_at((0.0, 0.0, -0.5)).panorama).all())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["single True", "single True"]
