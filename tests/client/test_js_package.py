"""The npm package: its contents, source maps, and an app that has one copy of three.js."""

import json
import shutil
import tarfile
from pathlib import Path, PurePosixPath

import pytest
from js_package import PACKAGE, run

ROOT = PACKAGE.parents[1]
DESCRIPTION = json.loads((PACKAGE / "package.json").read_text())
OFFLINE = ("--offline", "--ignore-scripts", "--no-audit", "--no-fund", "--silent")
APP = """\
import { RoomLight } from "roomlight";
import { applyToScene } from "roomlight/three";
import { Scene } from "three";
console.log(new RoomLight("http://localhost:8090"), applyToScene, new Scene());
"""


def test_the_lock_file_has_no_hosts_and_nothing_is_required():
    assert "resolved" not in (PACKAGE / "package-lock.json").read_text()
    assert "dependencies" not in DESCRIPTION
    assert DESCRIPTION["peerDependenciesMeta"] == {"three": {"optional": True}}
    assert DESCRIPTION["scripts"].keys().isdisjoint({"prepare", "preinstall", "install", "postinstall"})


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of client/js, so that tests in other processes keep its build."""
    copy = tmp_path_factory.mktemp("repository") / "client/js"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("node_modules", "dist", "build", "test"))
    (copy / "node_modules").symlink_to(PACKAGE / "node_modules")
    shutil.copy(ROOT / "LICENSE", copy.parents[1])
    return copy


@pytest.fixture(scope="module")
def tarball(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tarball")
    run(["npm", "pack", "--silent", "--pack-destination", folder], folder=package)
    (tarball,) = folder.glob("*.tgz")
    return tarball


@pytest.mark.js
def test_the_tarball_has_licence_and_resolvable_source_maps(package, tarball):
    with tarfile.open(tarball) as archive:
        files = {
            member.name: stream.read() for member in archive.getmembers() if (stream := archive.extractfile(member))
        }
    assert files["package/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert not (package / "LICENSE").exists()
    maps = [name for name in files if name.endswith(".map")]
    assert {"package/dist/index.js.map", "package/dist/three.d.ts.map"} <= set(maps)
    for name in maps:
        for source in json.loads(files[name])["sources"]:
            assert resolved(PurePosixPath(name).parent, source) in files, f"{name}: {source}"
    for target in DESCRIPTION["exports"].values():
        assert {resolved(PurePosixPath("package"), path) for path in target.values()} <= files.keys()
    assert not [name for name in files if "node_modules" in name or "test" in name]


def resolved(folder: PurePosixPath, path: str) -> str:
    parts: list[str] = []
    for part in (folder / path).parts:
        parts = parts[:-1] if part == ".." else [*parts, part]
    return "/".join(parts)


@pytest.mark.js
def test_an_app_with_the_tarball_bundles_one_three(package, tarball, tmp_path):
    """The same app with a link to the folder, which `npm install FOLDER` makes, bundles two copies."""
    (tmp_path / "package.json").write_text('{"name": "app", "version": "1.0.0", "type": "module"}')
    (tmp_path / "app.js").write_text(APP)
    run(["npm", "install", *OFFLINE, tarball], folder=tmp_path)
    three = shutil.ignore_patterns("examples", "src")  # only what bundlers read
    shutil.copytree(PACKAGE / "node_modules/three", tmp_path / "node_modules/three", ignore=three)
    assert copies_of_three(tmp_path) == 1

    installed = tmp_path / "node_modules/roomlight"
    installed.rename(tmp_path / "unlinked")
    installed.symlink_to(package)
    assert copies_of_three(tmp_path) == 2


def copies_of_three(app: Path) -> int:
    bundle = ["--bundle", "--format=esm", "--outfile=out.js", "--metafile=meta.json", "--log-level=error"]
    run([PACKAGE / "node_modules/.bin/esbuild", "app.js", *bundle], folder=app)
    inputs = json.loads((app / "meta.json").read_text())["inputs"]
    return sum(path.endswith("three/build/three.module.js") for path in inputs)
