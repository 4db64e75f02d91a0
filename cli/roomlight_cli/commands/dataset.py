"""`roomlight dataset`: generate, view, measure and extract datasets of path-traced rooms."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from annotated_types import Ge
from jaxtyping import Float32

from roomlight.dataset.extract import extract as extract_sequence
from roomlight.dataset.folder import FRAMES
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.dataset.verify import verify as verify_dataset
from roomlight.errors import DatasetError, FurnitureError
from roomlight.files import check_writable, write_json
from roomlight_cli import console
from roomlight_cli.console import APP_OPTIONS, counted, say, stopped_by_signals
from roomlight_cli.generation import cost_text, show_generation
from roomlight_cli.options import Flag, Without, add_command
from roomlight_cli.progress import Progress, duration
from roomlight_generator.blender.scene import require_blender
from roomlight_generator.generate import GenerateOptions
from roomlight_generator.generate import generate as run_generator
from roomlight_generator.light_stats import compare_light
from roomlight_generator.panoramas.library import panorama_files, split_of
from roomlight_generator.reports.preview import write_previews
from roomlight_generator.reports.tables import print_light
from roomlight_generator.rooms.furniture import build_cache
from roomlight_generator.rooms.furniture.catalogue import installed_libraries, library_files

DatasetFolder = Annotated[Path, Flag(text="A dataset folder.")]
OnlySplit = Annotated[Split | None, Flag(text="Use this split only.")]


def generate(
    options: Annotated[GenerateOptions, Without("renderer", "scenes", "samples")],
    *,
    out: Path,
    workers: Annotated[int, Ge(1)] | None = None,
) -> None:
    """Generate path-traced sequences with ground-truth probes. Stopped or killed, the same command continues.

    Args:
        options: What to generate.
        out: Dataset folder: a new one, or one to continue.
        workers: Processes; default: one per core.
    """
    if options.panoramas is not None:
        _say_split(options.panoramas, options.split)
    _generate(out, options, workers)


def render(
    scenes: Annotated[tuple[Path, ...], Flag(text="Blender files (.blend), a room each.")],
    *,
    out: Path,
    walks: Annotated[int, Ge(1)] = 1,
    frames: Annotated[int, Ge(1)] = FRAMES,
    samples: Annotated[int, Ge(1)] = 64,
    seed: Annotated[int, Ge(0)] = 0,
    split: Split = "train",
    workers: Annotated[int, Ge(1)] | None = None,
) -> None:
    """Render Blender scenes as sequences with ground-truth probes. Stopped or killed, the same command continues.

    Walks go through the room in which the scene's camera stands. Cycles renders; it needs the extra `blender`.

    Args:
        out: Dataset folder: a new one, or one to continue.
        walks: Walks through each scene.
        frames: Frames of a walk.
        samples: Paths a pixel of frames, which are denoised; probes have four times as many.
        seed: Seed of walks, phones and exposures.
        split: Split of these rooms.
        workers: Processes; default: one per core.
    """
    require_blender()
    for path in scenes:
        if not path.is_file():
            raise DatasetError(f"{path}: is not a file; give Blender scenes (.blend)")
    options = GenerateOptions(
        sequences=walks * len(scenes),
        seed=seed,
        split=split,
        shard_size=walks,
        sequences_per_room=walks,
        frames=frames,
        scenes=scenes,
        samples=samples,
    )
    _generate(out, options, workers)


def _generate(out: Path, options: GenerateOptions, workers: int | None) -> None:
    kept = "finished sequences are kept, and the same command continues"
    with stopped_by_signals(lambda: kept), Progress("generating") as progress:
        report = run_generator(out, options, workers=workers, progress=show_generation(progress))
    sequences = counted(report.sequences, f"{options.split} sequence")
    if report.sequences < report.asked:
        sequences += f" of the {report.asked} asked for earlier"
    if not report.made:
        say(f"{out} already has {sequences}")
        return
    say(
        f"{out}: {sequences}, {report.bytes / report.sequences / 1e6:.2f} MB each; "
        f"{report.made} made in {duration(report.elapsed_s)}, {3600 * report.made / report.elapsed_s:.0f} per hour, "
        f"{cost_text(report.core_s)}"
    )
    say(f"View them: roomlight dataset preview {out} --out preview")


def _say_split(panoramas: Path, split: Split) -> None:
    files = panorama_files(panoramas)
    used = [path.stem for path in files if split_of(path) == split]
    kept = [path.stem for path in files if split_of(path) != split]
    say(f"{panoramas}: {len(used)} of {len(files)} panoramas light the {split} rooms: {', '.join(used) or 'none'}")
    say(f"kept for the other split, whole buildings each: {', '.join(kept) or 'none'}")


def preview(
    folder: DatasetFolder,
    *,
    out: Path = Path("preview"),
    rooms: Annotated[int, Ge(1)] = 16,
    split: OnlySplit = None,
) -> None:
    """Write contact sheets as PNG: frames, depth, surfaces, and probes in normal and low exposure.

    Args:
        out: Folder for the pictures.
        rooms: Rooms to show, evenly spread; 8 per picture.
    """
    dataset = _not_empty(folder, split)
    with Progress("drawing rooms") as progress:
        written = write_previews(dataset, out, rooms=rooms, progress=progress.count)
    for path in written:
        say(str(path))


def stats(
    folder: DatasetFolder,
    *,
    against: Path,
    sequences: Annotated[int, Ge(1)] | None = None,
    split: OnlySplit = None,
    json: Path | None = None,
) -> None:
    """Print figures of the light of first frames and probes, beside those of real HDR panoramas.

    Args:
        against: A folder of real HDR panoramas (.exr, .hdr).
        sequences: Measure this many, evenly spread; default: all.
        json: Also write the figures as JSON.
    """
    with Progress("measuring") as progress:
        figures = compare_light(_not_empty(folder, split), against, limit=sequences, progress=progress.count)
    if json:  # first: a reader of the tables may leave
        write_json(json, figures.to_json())
    print_light(console.out, figures)


def verify(folder: DatasetFolder, *, repair: bool = False) -> None:
    """Compare every sequence with its checksum.

    Args:
        repair: Remove damaged sequences, so that `generate` makes them again.
    """
    with Progress("verifying sequences") as progress:
        report = verify_dataset(folder, repair=repair, progress=progress.count)
    for message in report.damaged:
        say(message)
    if report.damaged and not repair:
        raise DatasetError(f"{folder}: {len(report.damaged)} damaged, {report.whole} intact; --repair removes them")
    if report.damaged:
        say(f"{folder}: {report.whole} sequences are intact; {len(report.damaged)} damaged ones were removed")
        say("`roomlight dataset generate` with the dataset's settings makes them again")
    elif report.missing:
        raise DatasetError(
            f"{folder}: {report.whole} sequences are intact, but {report.missing} more that dataset.json asks for are "
            "in no index; `roomlight dataset generate` with the dataset's settings makes them"
        )
    else:
        say(f"{folder}: {report.whole} sequences, {report.bytes / 1e6:.0f} MB, all intact")


def extract(folder: DatasetFolder, name: str, *, out: Path) -> None:
    """Write one sequence as a capture, for replay and eval.

    Args:
        name: The sequence, e.g. train-000012.
        out: Capture folder to write: a new or an empty one.
    """
    extract_sequence(Dataset(folder, None), name, out)
    say(f"Written to {out}; try: roomlight replay {out} --probes-from-capture --out light")


def furniture(*, out: Path, library: tuple[Path, ...] = ()) -> None:
    """Pack furniture libraries into one compact file: meshes, textures, authors. It takes about 90 seconds.

    Args:
        out: Cache file to write, for `generate --furniture` on another machine.
        library: A .sh3f library or a folder of them; default: the installed ones. Repeatable.
    """
    sources = [file for path in library for file in library_files(path)] if library else installed_libraries()
    if not sources:
        raise FurnitureError("no furniture library is installed: apt install sweethome3d-furniture, or give --library")
    check_writable(out)
    with Progress("reading models") as progress:
        build_cache(sources, out, warn=say, progress=progress.count)
    say(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


def prior(
    folders: Annotated[tuple[Path, ...], Flag(text="Dataset folders.")], *, out: Path, split: Split = "train"
) -> None:
    """Fit the prior over panoramas, which fills what no frame has shown, to the true panoramas of datasets.

    Args:
        out: Folder for --parts of other commands: its folder `prior` gets the prior, and a card that says what it was
            fitted to.
        split: Use the rooms of this split.
    """
    from roomlight.engine.networks.graphs import DESCRIPTION  # onnxruntime, which generating does without
    from roomlight.engine.panorama.prior import FILE, PanoramaPrior

    datasets = [_not_empty(folder, split) for folder in folders]
    check_writable(out / "prior" / FILE)
    total, count = sum(map(len, datasets)), 0

    def panoramas(progress: Progress) -> Iterator[Float32[np.ndarray, "h w 3"]]:
        nonlocal count
        places = ((dataset, number) for dataset in datasets for number in range(len(dataset)))
        for done, (dataset, number) in enumerate(places, 1):
            for panorama in dataset.read(number, frames=(0,)).true_panoramas():
                count += 1
                yield panorama
            progress.count(done, total)
        if not count:
            names = ", ".join(map(str, folders))
            raise DatasetError(f"{names}: no sequence has probes to fit to; generate walks, without --any-view")

    with Progress("fitting") as progress:
        fitted = PanoramaPrior.fit(panoramas(progress))
    fitted.save(out / "prior" / FILE)
    card = {"panoramas": count, "sequences": total, "split": split, "command": "roomlight dataset prior"}
    write_json(out / "prior" / DESCRIPTION, {"form": "prior", "card": card})
    say(f"{out}: fitted to {count} panoramas of {total} sequences; use it with --parts {out}")


def _not_empty(folder: Path, split: Split | None) -> Dataset:
    """Open a dataset. Raises DatasetError if it has no sequence, or none of the split."""
    dataset = Dataset(folder, split)
    if not len(dataset):
        missing = f" of the split {split}; give another --split, or" if split else ";"
        raise DatasetError(f"{folder}: has no sequence{missing} make some with `roomlight dataset generate`")
    return dataset


app = typer.Typer(
    help="Generate, view, measure and extract datasets of path-traced rooms.", no_args_is_help=True, **APP_OPTIONS
)
for _command in (generate, render, preview, stats, verify, extract, furniture, prior):
    add_command(app, _command)
