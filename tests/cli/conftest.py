"""What the tests of the command line share."""

import sys
from pathlib import Path

import pytest
from command_runner import Finished, RunCommand

from roomlight_cli.main import main
from roomlight_cli.replays.pictures import PicturesState, ReplayPictures
from rooms import BoxRoom, pan
from written_captures import write_capture


@pytest.fixture
def roomlight(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> RunCommand:
    """`roomlight("replay", capture, "--out", out, cwd=folder)`: the command in this process."""

    def run(*arguments: object, cwd: Path | None = None) -> Finished:
        if cwd is not None:
            monkeypatch.chdir(cwd)
        monkeypatch.setattr("roomlight_cli.progress.LINE_EVERY_S", 1e6)  # a busy machine prints no line either
        monkeypatch.setattr(sys, "argv", ["roomlight", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        code = ended.value.code or 0
        assert isinstance(code, int)
        printed = capsys.readouterr()
        return Finished(code, printed.out, printed.err)

    return run


class NoPictures:
    """Video and sheet are compared in one test; elsewhere their spheres would take most of the time."""

    def __init__(self, _: Path, __: object, state: PicturesState, **___: object) -> None:
        self.state = state

    def end_part(self) -> PicturesState:
        return self.state

    def add(self, *_: object, **__: object) -> None:
        pass

    def close(self, _: object = None) -> None:
        pass

    def abandon(self, _: object) -> None:
        pass


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures with small frames and spheres: the tables of large spheres take seconds."""
    monkeypatch.setattr("roomlight_cli.replays.video._FRAME_ROWS", 96)
    monkeypatch.setattr("roomlight_cli.replays.video._PANORAMA_ROWS", (28, 60))
    monkeypatch.setattr("roomlight_cli.replays.sheet.PANORAMA_COLUMNS", (192, 144))
    monkeypatch.setattr("roomlight_cli.replays.inserted_spheres._COLUMNS", 64)
    monkeypatch.setattr("roomlight_cli.photo._SPHERE", 64)


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roomlight_cli.replays.replay.ReplayPictures", NoPictures)


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Pictures nevertheless, in a module that has none."""
    request.getfixturevalue("no_pictures")
    monkeypatch.setattr("roomlight_cli.replays.replay.ReplayPictures", ReplayPictures)


@pytest.fixture(scope="session")
def small_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of a box room and the truth at a point ahead."""
    room, point = BoxRoom(), (0.4, 1.2, -0.3)
    frames = pan(room, 6, width=64, height=48)
    probes = [(point, room.panorama(point, height=16)[0])]
    return write_capture(tmp_path_factory.mktemp("small") / "box", frames, probes=probes)
