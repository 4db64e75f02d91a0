"""A dataset's bytes depend on its settings alone, not on interruptions or the number of workers."""

import json
import os
import resource
import signal
import subprocess
import sys

import pytest

import stub_rooms
from roomlight.dataset.folder import LOCK, MANIFEST, locked, read_manifest
from roomlight.dataset.loader import Dataset
from roomlight.dataset.shards import index_path, read_index
from roomlight.dataset.verify import verify
from roomlight.errors import DatasetError, OptionError, OutputError
from roomlight_generator.generate import GenerateOptions, generate


def options(sequences=12, **changes):
    given = {"seed": 7, "shard_size": 4, "sequences_per_room": 2, "frames": 4, "renderer": stub_rooms.NAME}
    return GenerateOptions(sequences=sequences, **{**given, **changes})


def bytes_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """12 sequences by one worker without interruption: the bytes that every other run must give."""
    folder = tmp_path_factory.mktemp("undisturbed")
    report = generate(folder, options(), workers=1)
    assert (report.sequences, report.made, len(report.core_s)) == (12, 12, 12)
    return folder


@pytest.fixture
def steer(tmp_path, monkeypatch):
    """Sets what the stand-in renderer does."""
    folder = tmp_path / "steering"
    folder.mkdir()
    monkeypatch.setenv("STUB_ROOMS", str(folder))

    def write(**what):
        (folder / "steer.json").write_text(json.dumps(what))
        return folder

    return write


def test_a_dataset_has_the_requested_sequences(undisturbed):
    dataset = Dataset(undisturbed)
    assert dataset.names == [f"train-{number:06d}" for number in range(12)]
    manifest = read_manifest(undisturbed)
    assert (manifest.settings.seed, manifest.sequences) == (7, {"train": 12})
    assert sorted(path.name for path in undisturbed.glob("*.tar")) == [f"train-{number:05d}.tar" for number in range(3)]
    assert verify(undisturbed).whole == 12
    for number, recording in enumerate(dataset):
        made = recording.facts["made"]
        place = {"room": number // 2, "walk": number % 2}
        assert made == {"seed": 7, "split": "train", "attempt": 0, "room_seed": 7} | place
        assert recording.facts["room_type"] == stub_rooms.TYPES[number // 2 % 3]


def test_a_worker_has_one_thread_and_imports_no_other_package(undisturbed):
    facts = Dataset(undisturbed).read(0).facts
    assert (facts["foreign"], facts["threads"]) == ([], "1")


@pytest.mark.slow
def test_two_workers_grow_a_dataset_in_steps_to_the_same_bytes(undisturbed, tmp_path):
    folder, reports = tmp_path / "steps", []
    for sequences in (1, 5, 12):
        assert generate(folder, options(sequences), workers=2, progress=reports.append).sequences == sequences
    assert bytes_of(folder) == bytes_of(undisturbed)
    assert [report.finished for report in reports] == [*range(2), *range(1, 6), *range(5, 13)]
    assert reports[0].per_hour is None
    assert reports[-1].left_s == 0
    assert reports[-1].bytes == sum(
        entry.length for tar in undisturbed.glob("*.tar") for entry in read_index(tar).entries
    )
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*.*") if path.name != LOCK}
    assert generate(folder, options(12), workers=2).made == 0
    assert generate(folder, options(3), workers=2).made == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before


RUN = """
import json, sys
from pathlib import Path
from roomlight_generator.generate import GenerateOptions, generate
generate(Path(sys.argv[1]), GenerateOptions(**json.loads(sys.argv[2])), workers=int(sys.argv[3]))
"""


def start(folder, workers):
    path = os.pathsep.join(sys.path)
    return subprocess.Popen(
        [sys.executable, "-c", RUN, str(folder), json.dumps(vars(options())), str(workers)],
        env={**os.environ, "PYTHONPATH": path},
    )


@pytest.mark.slow
@pytest.mark.parametrize("gate", [[2, 1], [0, 0], [5, 1]], ids=["within a shard", "first", "last"])
def test_a_killed_run_continues_to_the_same_bytes(gate, undisturbed, tmp_path, steer):
    out = tmp_path / "killed"
    pipes = steer(gate=gate)
    for name in ("reached", "go"):
        os.mkfifo(pipes / name)
    process = start(out, 1)
    with process, (pipes / "reached").open() as reached:
        assert reached.readline() == "here\n"
        with pytest.raises(OutputError, match=f"process {process.pid} "):
            generate(out, options())
        process.send_signal(signal.SIGKILL)
    whole = 2 * gate[0] + gate[1]
    assert Dataset(out).names == [f"train-{number:06d}" for number in range(whole)]
    assert verify(out).whole == whole
    steer()
    # the worker notices that its parent died and releases its shard: the next one waits for that
    report = generate(out, options(), workers=2)
    assert (report.sequences, report.made) == (12, 12 - whole)
    assert bytes_of(out) == bytes_of(undisturbed)


@pytest.mark.slow
def test_a_failed_room_is_retried_the_same_way_each_time(tmp_path, steer):
    steer(fails={"1": 1})
    reports = []
    generate(tmp_path / "one", options(4), workers=1, progress=reports.append)
    notes = [report.note for report in reports if report.note]
    says = "room 1 of train, seed 7, attempt 1 of 3: ArithmeticError: no light reaches room 1 (stub_rooms.py"
    assert len(notes) == 1
    assert notes[0].startswith(says)
    made = [recording.facts["made"] for recording in Dataset(tmp_path / "one")]
    assert [attempt["attempt"] for attempt in made] == [0, 0, 0, 1]
    assert made[3]["room_seed"] > 1000
    for sequences in (3, 4):
        generate(tmp_path / "other", options(sequences), workers=1)
    assert bytes_of(tmp_path / "other") == bytes_of(tmp_path / "one")


@pytest.mark.usefixtures("no_workers")
@pytest.mark.parametrize(
    ("scenes", "advice"), [((), "another `seed`"), (("hall.blend", "bath.blend"), r"leave bath\.blend out")]
)
def test_a_room_that_always_fails_is_an_error(tmp_path, steer, scenes, advice):
    paths = tuple(tmp_path / scene for scene in scenes)
    for path in paths:
        path.write_bytes(b"")
    steer(hopeless=1)
    says = f"room 1 of train with seed 7 cannot be made; all 3 attempts failed.* no light reaches room 1.*{advice}"
    with pytest.raises(DatasetError, match=says):
        generate(tmp_path / "out", options(scenes=paths))
    assert Dataset(tmp_path / "out").names == ["train-000000", "train-000001"]


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced(undisturbed, tmp_path, steer):
    steer(dies={"2": 2, "4": 1})
    reports = []
    report = generate(tmp_path / "out", options(), workers=2, progress=reports.append)
    assert bytes_of(tmp_path / "out") == bytes_of(undisturbed)
    assert report.sequences == 12
    notes = [update.note for update in reports if update.note]
    assert len(notes) == 3
    assert all("a worker died (signal 9)" in note for note in notes)


@pytest.mark.slow
def test_workers_that_keep_dying_are_an_error(tmp_path, steer):
    steer(dies={"2": 3})
    with pytest.raises(DatasetError, match=r"train-00001\.tar: 3 workers in a row died .* signal 9.* fewer `workers`"):
        generate(tmp_path / "out", options(), workers=1)
    assert len(Dataset(tmp_path / "out")) == 4


@pytest.mark.slow
def test_a_full_disk_is_an_error_and_the_run_can_continue(undisturbed, tmp_path, steer):
    first = index_path(next(iter(sorted(undisturbed.glob("*.tar"))))).read_text().splitlines()[2]
    steer(limit=json.loads(first)["offset"] + 1000)  # within the third sequence
    out = tmp_path / "out"
    with pytest.raises(
        OutputError, match=r"train-00000\.tar: cannot be written \(File too large\); finished sequences are kept"
    ):
        generate(out, options(), workers=1)
    assert Dataset(out).names == ["train-000000", "train-000001"]
    steer()
    generate(out, options(), workers=1)
    assert bytes_of(out) == bytes_of(undisturbed)
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 1000


@pytest.mark.usefixtures("no_workers")
def test_splits_share_a_folder_and_no_room(undisturbed, tmp_path):
    for split in ("train", "test"):
        generate(tmp_path / "both", options(4, split=split))
    assert read_manifest(tmp_path / "both").sequences == {"test": 4, "train": 4}
    train, test = Dataset(tmp_path / "both", "train"), Dataset(tmp_path / "both", "test")
    assert (len(train), len(test), len(Dataset(tmp_path / "both"))) == (4, 4, 8)
    assert train.read(0).facts["made"]["split"] != test.read(0).facts["made"]["split"]
    assert (train.read(0).depth_mm != test.read(0).depth_mm).any()
    assert bytes(train.files(0)["colour/000000.jpg"]) == bytes(Dataset(undisturbed).files(0)["colour/000000.jpg"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": 8}, "seed 7, not 8"),
        ({"shard_size": 8}, "shard size 4, not 8"),
        ({"sequences_per_room": 4}, "sequences per room 2, not 4"),
        ({"frames": 1}, "frames 4, not 1"),
        ({"renderer": "other:one"}, "renderer stub_rooms:render_room, not other:one"),
        ({"seed": 0, "shard_size": 2}, "seed 7, not 0; shard size 4, not 2"),
    ],
)
def test_other_settings_are_named_and_nothing_changes(change, says, undisturbed):
    before = bytes_of(undisturbed)
    with pytest.raises(DatasetError, match=f"was generated with {says}; use the same settings"):
        generate(undisturbed, options(**change))
    assert bytes_of(undisturbed) == before


@pytest.mark.usefixtures("no_workers")
def test_other_scenes_are_named(tmp_path):
    for name in ("hall", "bath"):
        (tmp_path / name).write_bytes(b"")
    generate(tmp_path / "out", options(2, scenes=(tmp_path / "hall", tmp_path / "bath")))
    with pytest.raises(DatasetError, match=r"scenes hall \w{12}, bath \w{12}, not hall \w{12};"):
        generate(tmp_path / "out", options(2, scenes=(tmp_path / "hall",)))


@pytest.mark.usefixtures("no_workers")
def test_the_settings_include_the_furniture_by_its_content(tmp_path):
    library = tmp_path / "chairs.sh3f"
    library.write_bytes(b"chairs")
    out = tmp_path / "out"
    generate(out, options(2, furniture=library))
    assert Dataset(out).read(0).facts["furniture_file"] == "chairs.sh3f"
    moved = tmp_path / "moved.sh3f"
    library.rename(moved)
    assert generate(out, options(2, furniture=moved)).made == 0
    with pytest.raises(DatasetError, match=r"was generated with furniture \w+, not"):
        generate(out, options(2))
    moved.write_bytes(b"tables")
    with pytest.raises(DatasetError, match="furniture"):
        generate(out, options(2, furniture=moved))
    with pytest.raises(DatasetError, match="no such file"):
        generate(tmp_path / "new", options(2, furniture=library))
    many = tmp_path / "many"
    (many / "a").mkdir(parents=True)
    (many / "a" / "one.sh3f").write_bytes(b"lamps")
    assert generate(tmp_path / "third", options(2, furniture=many)).made == 2


def test_a_folder_with_other_files_is_refused_and_unchanged(tmp_path):
    (tmp_path / "letters.txt").write_text("dear")
    with pytest.raises(OutputError, match=r"holds 'letters.txt' but no dataset.json"):
        generate(tmp_path, options())
    assert bytes_of(tmp_path) == {"letters.txt": b"dear"}


def test_a_place_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="is a file"):
        generate(tmp_path / "file", options())
    with pytest.raises(OutputError, match="cannot be written"):
        generate(tmp_path / "file" / "below", options())


@pytest.mark.parametrize(
    "manifest",
    [
        b"",
        b"{}",
        b"[1]",
        b'{"format": "roomlight-dataset", "version": 2}',
        b'{"format": "roomlight-dataset", "version": 1, "sequences": {"train": 1}}',
    ],
)
def test_a_damaged_manifest_is_an_error(manifest, tmp_path):
    (tmp_path / MANIFEST).write_bytes(manifest)
    with pytest.raises(DatasetError, match=r"dataset\.json"):
        generate(tmp_path, options())
    with pytest.raises(DatasetError, match=r"dataset\.json"):
        Dataset(tmp_path)


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"sequences": 0}, OptionError, "sequences is 0; it must be 1 or more"),
        ({"seed": -1}, OptionError, "seed is -1; it must be "),
        ({"sequences_per_room": 3}, DatasetError, "whole rooms of 3"),
    ],
)
def test_options_out_of_range_are_refused(change, error, says):
    with pytest.raises(error, match=says):
        options(**change)


@pytest.mark.slow
def test_an_unexpected_error_of_a_worker_shows_its_traceback(tmp_path):
    with pytest.raises(RuntimeError, match="no_such_module"):
        generate(tmp_path / "out", options(renderer="no_such_module:render"), workers=1)


# damage in a dataset


@pytest.fixture
def damaged(undisturbed, tmp_path):
    """A copy with a flipped byte in sequence 5 of 12, which is in the middle of a finished shard."""
    out = tmp_path / "damaged"
    out.mkdir()
    for name, data in bytes_of(undisturbed).items():
        (out / name).write_bytes(data)
    entry = json.loads((out / "train-00001.jsonl").read_text().splitlines()[1])
    tar = out / "train-00001.tar"
    broken = bytearray(tar.read_bytes())
    broken[entry["offset"] + entry["length"] // 2] ^= 1
    tar.write_bytes(broken)
    return out


def test_damage_is_found_removed_and_made_again(damaged, undisturbed):
    report = verify(damaged)
    assert (report.whole, len(report.damaged)) == (11, 1)
    assert "train-000005" in report.damaged[0]
    assert generate(damaged, options(), workers=1).made == 0  # a finished shard is not read again
    assert verify(damaged, repair=True).whole == 11
    assert verify(damaged).damaged == ()
    assert len(Dataset(damaged)) == 11
    listing = subprocess.run(
        ["tar", "tf", str(damaged / "train-00001.tar")], capture_output=True, text=True, check=True
    )
    assert listing.stderr == ""
    assert [name for name in listing.stdout.split() if name.startswith(".damaged")] == [
        f".damaged-train-00001-{json.loads((undisturbed / 'train-00001.jsonl').read_text().splitlines()[1])['offset']}"
    ]
    assert generate(damaged, options(), workers=1).made == 1
    after, before = Dataset(damaged), Dataset(undisturbed)
    assert after.names == before.names
    for number in range(12):
        assert after.files(number) == before.files(number)
    assert verify(damaged, repair=True).damaged == ()
    for name in ("train-00000.tar", "train-00002.tar", MANIFEST):
        assert (damaged / name).read_bytes() == (undisturbed / name).read_bytes()


@pytest.mark.slow
def test_a_lost_line_of_the_index_is_repaired_too(damaged, undisturbed):
    index = damaged / "train-00000.jsonl"
    lines = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(lines[0] + b"?" + lines[1] + b"".join(lines[2:]))
    with pytest.raises(DatasetError, match="line 2 is damaged"):
        generate(damaged, options(), workers=1)
    assert len(verify(damaged, repair=True).damaged) == 2
    assert generate(damaged, options(), workers=1).made == 2
    assert verify(damaged).whole == 12
    assert Dataset(damaged).files(1) == Dataset(undisturbed).files(1)


def test_nothing_is_repaired_while_another_process_writes(damaged):
    before = bytes_of(damaged)
    with locked(damaged), pytest.raises(OutputError, match="is writing"):
        verify(damaged, repair=True)
    assert {**bytes_of(damaged), LOCK: b""} == {**before, LOCK: b""}
