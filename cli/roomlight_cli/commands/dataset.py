"""`roomlight dataset`: generate, view, measure, check and extract datasets of path-traced rooms.

`python -m roomlight_cli.commands.dataset` runs the same commands on a machine that only generates. It needs NumPy,
numba, OpenCV, Pillow, embreex, OpenEXR, jaxtyping, typer and rich, and none of onnxruntime, PyAV, FastAPI and PyTorch.
"""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.dataset.extract import extract as extract_sequence
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.dataset.verify import verify as verify_dataset
from roomlight.errors import DatasetError, FurnitureError, OutputError
from roomlight.files import write_json
from roomlight_cli import console
from roomlight_cli.console import run, say
from roomlight_cli.datasets.check import check
from roomlight_cli.datasets.preview import write_previews
from roomlight_cli.datasets.progress import ProgressDisplay, cost_text, duration
from roomlight_cli.datasets.tables import print_light, print_stats
from roomlight_cli.lazy import APP_OPTIONS
from roomlight_generator.generate import GenerateOptions
from roomlight_generator.generate import generate as run_generator
from roomlight_generator.light_stats import LightComparison, compare_light
from roomlight_generator.panoramas.library import panorama_files, split_of
from roomlight_generator.rooms.furniture import build_cache
from roomlight_generator.rooms.furniture.catalogue import installed_libraries, library_files
from roomlight_generator.sample import SEED, generate_sample
from roomlight_generator.stats import collect

app = typer.Typer(
    help="Generate, view, measure and check datasets of path-traced rooms.", no_args_is_help=True, **APP_OPTIONS
)

DatasetFolder = Annotated[Path, typer.Argument(help="A dataset folder.")]
OnlySplit = Annotated[Split | None, typer.Option(help="Use this split only.")]


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="Dataset folder: a new one, or one to continue.")],
    sequences: Annotated[
        int, typer.Option(min=1, help="Sequences that the folder has in the end; those of earlier runs count.")
    ],
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same rooms.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    split: Annotated[
        Split, typer.Option(help="train and test have no room, no furniture model and no texture in common.")
    ] = "train",
    furniture: Annotated[
        Path | None,
        typer.Option(help="A .sh3f library, or a cache of several; default: the installed libraries."),
    ] = None,
    shard_size: Annotated[int, typer.Option(min=1, help="Sequences per file; a worker makes one file at a time.")] = 16,
    sequences_per_room: Annotated[int, typer.Option(min=1, help="Walks through each room.")] = 4,
    frames: Annotated[
        int, typer.Option(min=1, help="Frames per walk; 1 makes single views and is four times as fast.")
    ] = 31,
    panoramas: Annotated[
        Path | None,
        typer.Option(help="Folder of equirectangular HDR panoramas (.exr, .hdr) that light the rooms: real light."),
    ] = None,
    furniture_share: Annotated[
        float, typer.Option(min=0, max=1, help="Share of the rooms lit by panoramas that have furniture.")
    ] = 0.7,
) -> None:
    """Generate path-traced sequences with ground-truth probes. Stopped or killed, the same command continues."""
    options = GenerateOptions(
        sequences=sequences,
        seed=seed,
        split=split,
        shard_size=shard_size,
        sequences_per_room=sequences_per_room,
        frames=frames,
        furniture=furniture,
        panoramas=panoramas,
        furniture_share=furniture_share,
    )
    if panoramas is not None:
        _say_split(panoramas, split)
    with ProgressDisplay(console.err) as display:
        try:
            report = run_generator(out, options, workers=workers, progress=display)
        except KeyboardInterrupt:
            console.err.print("stopped; finished sequences are kept, and the same command continues", soft_wrap=True)
            raise typer.Exit(130) from None
    if not report.made:
        say(f"{out} already has its {report.sequences} {split} sequences")
        return
    say(
        f"{out}: {report.sequences} {split} sequences, {report.bytes / report.sequences / 1e6:.2f} MB each; "
        f"{report.made} made in {duration(report.elapsed_s)}, {3600 * report.made / report.elapsed_s:.0f} per hour, "
        f"{cost_text(report.core_s)}"
    )
    say(f"View them: roomlight dataset preview {out} --out preview")


def _say_split(panoramas: Path, split: Split) -> None:
    """Print which panoramas light the rooms of this split, and which are kept for the other."""
    files = panorama_files(panoramas)
    used = [path.stem for path in files if split_of(path) == split]
    kept = [path.stem for path in files if split_of(path) != split]
    say(f"{panoramas}: {len(used)} of {len(files)} panoramas light the {split} rooms: {', '.join(used) or 'none'}")
    say(f"kept for the other split, whole buildings each: {', '.join(kept) or 'none'}")


@app.command()
def preview(
    folder: DatasetFolder,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("preview"),
    rooms: Annotated[int, typer.Option(min=1, help="Rooms to show, evenly spread; 8 per picture.")] = 16,
    split: OnlySplit = None,
) -> None:
    """Write contact sheets as PNG: frames, depth, surfaces, and probes in normal and low exposure."""
    dataset = Dataset(folder, split)
    with console.err.status("drawing") as status:
        written = write_previews(
            dataset, out, rooms=rooms, progress=lambda done, total: status.update(f"drawing room {done} of {total}")
        )
    for path in written:
        say(str(path))


@app.command()
def stats(
    folder: DatasetFolder,
    sequences: Annotated[
        int | None, typer.Option(min=1, help="Measure this many, evenly spread; default: all.")
    ] = None,
    split: OnlySplit = None,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Compare the light of first frames and probes with the real HDR panoramas (.exr, .hdr) of this folder."
        ),
    ] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """Print figures of motion, range, exposure, coverage, sizes and room contents; or of light, beside real rooms'."""
    dataset = Dataset(folder, split)
    with console.err.status("measuring") as status:

        def progress(done: int, total: int) -> None:
            status.update(f"measuring {done} of {total}")

        if against is None:
            figures = collect(dataset, limit=sequences, progress=progress)
        else:
            figures = compare_light(dataset, against, limit=sequences, progress=progress)
    if isinstance(figures, LightComparison):
        print_light(console.out, figures)
    else:
        print_stats(console.out, figures)
    if json_out:
        write_json(json_out, figures.to_json())


@app.command()
def verify(
    folder: DatasetFolder,
    repair: Annotated[
        bool, typer.Option("--repair", help="Remove damaged sequences, so that `generate` makes them again.")
    ] = False,
) -> None:
    """Compare every sequence with its checksum."""
    with console.err.status("verifying") as status:
        report = verify_dataset(
            folder,
            repair=repair,
            progress=lambda done, total: status.update(f"verifying sequence {done} of {total}"),
        )
    for message in report.damaged:
        say(message)
    if not report.damaged:
        say(f"{folder}: {report.whole} sequences, {report.bytes / 1e6:.0f} MB, all intact")
    elif repair:
        say(f"{folder}: {report.whole} sequences are intact; {len(report.damaged)} damaged ones were removed")
        say("`roomlight dataset generate` with the dataset's settings makes them again")
    else:
        raise DatasetError(f"{folder}: {len(report.damaged)} damaged, {report.whole} intact; --repair removes them")


@app.command()
def extract(
    folder: DatasetFolder,
    name: Annotated[str, typer.Argument(help="The sequence, e.g. train-000012.")],
    out: Annotated[Path, typer.Option(help="Capture folder to write: a new or an empty one.")],
) -> None:
    """Write one sequence as a capture, for replay and eval."""
    extract_sequence(Dataset(folder, None), name, out)
    say(f"Written to {out}; try: roomlight replay {out} --probes-from-capture --out light")


app.command()(check)


@app.command()
def furniture(
    out: Annotated[Path, typer.Option(help="Cache file to write, for `generate --furniture` on another machine.")],
    library: Annotated[
        list[Path] | None,
        typer.Option(help="A .sh3f library or a folder of them; default: the installed ones. Repeatable."),
    ] = None,
) -> None:
    """Pack furniture libraries into one compact file: meshes, textures, authors. It takes about 90 seconds."""
    sources = [file for path in library for file in library_files(path)] if library else installed_libraries()
    if not sources:
        raise FurnitureError("no furniture library is installed: apt install sweethome3d-furniture, or give --library")
    with console.err.status("reading") as status:
        build_cache(
            sources,
            out,
            warn=say,
            progress=lambda done, total: status.update(f"reading model {done} of {total}"),
        )
    say(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


@app.command()
def sample(
    out: Annotated[Path, typer.Option(help="Capture folder to write: a new or an empty one.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the room.")] = None,
) -> None:
    """Generate a sample capture such as the one in the package: a walk through one room, with true light."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):  # said now, not after a minute of rendering
        raise OutputError(f"{out}: exists already; choose another folder or delete it")
    with console.err.status("solving the room's light and rendering the frames"):
        generate_sample(out, seed=SEED if seed is None else seed)
    say(f"Written to {out}; try: roomlight replay {out} --probes-from-capture --out light")


if __name__ == "__main__":
    run(app)
