"""`roomlight light`: one photograph with depth in, panoramas and the main light out; every error says what to do."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import SessionOptions
from roomlight.errors import FrameError, ImageError, ModelError, RoomLightError
from roomlight.images import read_panorama, write_exr
from roomlight_cli.main import app
from roomlight_cli.photo import light_photo, read_photo
from rooms import BoxRoom, camera_at

CLASSICAL = SessionOptions(model="classical")


@pytest.fixture
def room(tmp_path):
    """A photograph of a box room taken level from its middle, a lamp in the ceiling ahead, and its depth."""
    shot = BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, -0.6), 0.4)).frame(
        camera_at((0.0, 1.4, 1.2)), width=64, height=48
    )
    cv2.imwrite(str(tmp_path / "photo.png"), linear_to_srgb8(np.clip(shot.image, 0, 1))[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), np.rint(shot.depth_m * 1000).astype(np.uint16))
    fov = float(np.degrees(2 * np.arctan(0.5 * 64 / shot.intrinsics.fx)))
    return tmp_path, shot, fov


def run(*arguments):
    return CliRunner().invoke(app, ["light", *map(str, arguments)])


def test_a_photograph_gives_panoramas_balls_and_the_main_light(room):
    folder, _, fov = room
    result = run(
        folder / "photo.png", "--depth", folder / "depth.png", "--fov", fov, "--probe", "0,-0.2,-1.5",
        "--probe", "0,-0.2,-50", "--out", folder / "out", "--model", "classical",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "of the sphere is in the photograph" in result.output
    assert "outside the lighting volume" in result.output.splitlines()[2]
    report = json.loads((folder / "out" / "light.json").read_text())
    assert report["model"] == "classical"
    assert [probe["inside_volume"] for probe in report["probes"]] == [True, False]
    for probe in report["probes"]:
        assert all((folder / "out" / name).is_file() for name in probe["files"].values())
    assert read_panorama(folder / "out" / "probe-00.exr").shape == (120, 240, 3)


def test_it_is_the_sessions_light(room):
    """Png and exr hold what the engine gave, to a half float."""
    folder, _, fov = room
    frame = read_photo(folder / "photo.png", folder / "depth.png", fov_deg=fov)
    (one,) = light_photo(frame, [(0.0, 0.0, -1.5)], folder / "out", options=CLASSICAL)
    written = read_panorama(folder / "out" / one.files[0])
    np.testing.assert_allclose(written, one.light.panorama, rtol=1e-3, atol=1e-4)


def test_the_field_of_view_is_horizontal(room):
    folder, shot, fov = room
    frame = read_photo(folder / "photo.png", folder / "depth.png", fov_deg=fov)
    assert frame.intrinsics.fx == pytest.approx(shot.intrinsics.fx)
    assert frame.intrinsics.cx == 32
    assert frame.camera_to_world.tolist() == np.eye(4).tolist()


@pytest.mark.parametrize("kind", ["mm.npy", "m.npy", "exr", "unit"])
def test_every_form_of_depth_is_the_same_depth(room, kind):
    folder, shot, fov = room
    unit = None
    path = folder / f"depth.{kind}"
    if kind == "mm.npy":
        np.save(path, np.rint(shot.depth_m * 1000).astype(np.uint16))
    elif kind == "m.npy":
        np.save(path, shot.depth_m.astype(np.float32))
    elif kind == "exr":
        write_exr(path, np.repeat(shot.depth_m[..., None], 3, axis=-1))
    else:
        path, unit = folder / "centimetres.png", 0.01
        cv2.imwrite(str(path), np.rint(shot.depth_m * 100).astype(np.uint16))
    frame = read_photo(folder / "photo.png", path, fov_deg=fov, depth_unit_m=unit)
    np.testing.assert_allclose(frame.depth_m, shot.depth_m, rtol=0.01)


def test_the_main_light_is_told_as_seen_from_the_camera(room):
    """A lamp ahead in the ceiling: above the horizon, in the view's half of the room."""
    folder, _, fov = room
    frame = read_photo(folder / "photo.png", folder / "depth.png", fov_deg=fov)
    (one,) = light_photo(frame, [(0.0, -0.5, -1.0)], folder / "out", options=CLASSICAL)
    elevation, azimuth = one.heading
    assert elevation > 20
    assert abs(azimuth) < 90


def test_a_depth_in_another_unit_is_caught(room):
    folder, shot, fov = room
    np.save(folder / "depth.npy", (shot.depth_m * 1000).astype(np.float32))  # floats, but millimetres
    with pytest.raises(FrameError, match=r"median depth would be .* --depth-unit"):
        read_photo(folder / "photo.png", folder / "depth.npy", fov_deg=fov)


def test_no_depth_at_all_is_said(room):
    folder, _, fov = room
    cv2.imwrite(str(folder / "none.png"), np.zeros((48, 64), np.uint16))
    with pytest.raises(FrameError, match=r"none\.png: no pixel has a depth"):
        read_photo(folder / "photo.png", folder / "none.png", fov_deg=fov)


def test_depth_of_another_shape_is_refused(room):
    folder, _, fov = room
    cv2.imwrite(str(folder / "square.png"), np.full((48, 48), 2000, np.uint16))
    with pytest.raises(FrameError, match="another aspect"):
        read_photo(folder / "photo.png", folder / "square.png", fov_deg=fov)


def test_an_image_for_depth_is_refused(room):
    folder, _, fov = room
    with pytest.raises(ImageError, match=r"photo\.png: depth must be a 16-bit grey PNG"):
        read_photo(folder / "photo.png", folder / "photo.png", fov_deg=fov)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--probe", "1,2"], "a position is X,Y,Z"),
        (["--probe", "0,0,-1", "--fov", "170"], "150"),
        ([], "--probe"),
    ],
)
def test_usage_errors(room, arguments, message):
    folder, _, _ = room
    result = run(folder / "photo.png", "--depth", folder / "depth.png", "--out", folder / "out", *arguments)
    assert result.exit_code == 2
    assert message in result.output


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"probe": "0,0,9999"}, RoomLightError),
        ({"photo": "missing.png"}, ImageError),
        ({"weights": "nowhere"}, ModelError),
    ],
)
def test_what_cannot_be_used_is_an_error_of_roomlight(room, changed, error):
    folder, _, _ = room
    arguments = [
        folder / changed.get("photo", "photo.png"), "--depth", folder / "depth.png", "--out", folder / "out",
        "--probe", changed.get("probe", "0,0,-1"),
    ]  # fmt: skip
    if "weights" in changed:
        arguments += ["--weights", folder / changed["weights"]]
    assert isinstance(run(*arguments).exception, error)
