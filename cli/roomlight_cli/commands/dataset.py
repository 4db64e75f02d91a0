"""`roomlight dataset`: make, look at, measure, check and open datasets of path-traced rooms.

`python -m roomlight_cli.commands.dataset` is the same without the rest of the client: it needs NumPy, numba,
OpenCV, embreex, OpenEXR, jaxtyping, typer and rich, which is little to bring to a machine that only generates.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roomlight.dataset.recording import Split
from roomlight.errors import DatasetError, FurnitureError
from roomlight_cli import console
from roomlight_cli.console import run, say
from roomlight_cli.dataset_check import check

if TYPE_CHECKING:
    from roomlight.dataset.loader import Dataset

app = typer.Typer(help="Make rooms to train and test on, and look at them.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(help="A dataset folder.")]
Only = Annotated[Split | None, typer.Option(help="Of this split only.")]


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="Dataset folder: new, or one to go on with.")],
    sequences: Annotated[int, typer.Option(min=1, help="How many there shall be in the end, earlier runs' included.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same rooms.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; a core each if not given.")] = None,
    split: Annotated[
        Split, typer.Option(help="train and test share no room, no furniture model and no texture.")
    ] = "train",
    furniture: Annotated[
        Path | None, typer.Option(help="A .sh3f library, or the cache of several, instead of the installed ones.")
    ] = None,
    shard_size: Annotated[int, typer.Option(min=1, help="Sequences a file; a worker makes one file at a time.")] = 16,
    sequences_per_room: Annotated[int, typer.Option(min=1, help="Walks through one room.")] = 4,
    frames: Annotated[int, typer.Option(min=1, help="Frames a walk; 1 makes single views, four times as fast.")] = 31,
) -> None:
    """Generate path-traced sequences with ground-truth probes. Stopped or killed, the same command goes on."""
    from roomlight_cli.dataset_progress import ProgressShown, costs, duration
    from roomlight_generator.generate import GenerateOptions
    from roomlight_generator.generate import generate as run_generator

    options = GenerateOptions(
        sequences=sequences,
        seed=seed,
        split=split,
        shard_size=shard_size,
        sequences_per_room=sequences_per_room,
        frames=frames,
        furniture=furniture,
    )
    with ProgressShown(console.err) as shown:
        try:
            report = run_generator(out, options, workers=workers, progress=shown)
        except KeyboardInterrupt:
            console.err.print(
                "stopped; what is finished stays, and the same command goes on from there", soft_wrap=True
            )
            raise typer.Exit(130) from None
    if not report.made:
        say(f"{out} has its {report.sequences} {split} sequences already")
        return
    say(
        f"{out}: {report.sequences} {split} sequences, {report.bytes / report.sequences / 1e6:.2f} MB each; "
        f"{report.made} made in {duration(report.elapsed_s)}, {3600 * report.made / report.elapsed_s:.0f} an hour, "
        f"{costs(report.core_s)}"
    )
    say(f"Look at them: roomlight dataset preview {out} --out preview")


@app.command()
def preview(
    folder: Folder,
    out: Annotated[Path, typer.Option(help="Folder for the sheets.")] = Path("preview"),
    rooms: Annotated[int, typer.Option(min=1, help="How many rooms, spread evenly; 8 a sheet.")] = 16,
    split: Only = None,
) -> None:
    """Contact sheets as PNG: frames, depth, surfaces, and probes as they are and under-exposed."""
    from roomlight_cli.dataset_preview import write_previews

    dataset = _open(folder, split)
    with console.err.status("drawing") as status:
        written = write_previews(
            dataset, out, rooms=rooms, progress=lambda done, of: status.update(f"drawing room {done} of {of}")
        )
    for path in written:
        say(str(path))


@app.command()
def stats(
    folder: Folder,
    sequences: Annotated[
        int | None, typer.Option(min=1, help="Measure so many, spread evenly, instead of all.")
    ] = None,
    split: Only = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """Motion, range, exposure, coverage, sizes, and what the rooms hold."""
    from roomlight.files import write_json
    from roomlight_cli.dataset_tables import print_stats
    from roomlight_generator.stats import collect

    dataset = _open(folder, split)
    with console.err.status("measuring") as status:
        found = collect(
            dataset, limit=sequences, progress=lambda done, of: status.update(f"measuring sequence {done} of {of}")
        )
    print_stats(console.out, found)
    if json_out:
        write_json(json_out, found.to_json())


@app.command()
def verify(
    folder: Folder,
    repair: Annotated[
        bool, typer.Option("--repair", help="Take damaged sequences out, so that generate makes them again.")
    ] = False,
) -> None:
    """Compare every sequence with its checksum."""
    from roomlight.dataset.verify import verify as check

    with console.err.status("verifying") as status:
        report = check(
            folder, repair=repair, progress=lambda done, of: status.update(f"verifying sequence {done} of {of}")
        )
    for message in report.damaged:
        say(message)
    if not report.damaged:
        say(f"{folder}: {report.whole} sequences, {report.bytes / 1e6:.0f} MB, all whole")
    elif repair:
        say(f"{folder}: {report.whole} sequences are whole; {len(report.damaged)} damaged ones were taken out")
        say("generate with the settings it was made with makes them again")
    else:
        raise DatasetError(f"{folder}: {len(report.damaged)} damaged, {report.whole} whole")


@app.command()
def extract(
    folder: Folder,
    name: Annotated[str, typer.Argument(help="The sequence, e.g. train-000012.")],
    out: Annotated[Path, typer.Option(help="Capture folder to write; it must not exist or be empty.")],
) -> None:
    """Write one sequence as a capture of its own, for replay and eval."""
    from roomlight.dataset.extract import extract as write

    write(_open(folder, None), name, out)
    say(f"written to {out}; try: roomlight replay {out} --probes-from-capture --out light")


app.command()(check)


@app.command()
def furniture(
    out: Annotated[Path, typer.Option(help="Cache file to write, for --furniture on another machine.")],
    library: Annotated[
        list[Path] | None, typer.Option(help="A .sh3f library or a folder of them; the installed ones if not given.")
    ] = None,
) -> None:
    """Make one compact file of furniture libraries: meshes, textures, who made them. About a minute and a half."""
    from roomlight_generator.rooms.furniture import build_cache
    from roomlight_generator.rooms.furniture.catalogue import installed_libraries, library_files

    sources = [file for given in library for file in library_files(given)] if library else installed_libraries()
    if not sources:
        raise FurnitureError("no furniture library is installed: apt install sweethome3d-furniture, or give --library")
    with console.err.status("reading") as status:
        build_cache(
            sources,
            out,
            warn=say,
            progress=lambda done, of: status.update(f"reading model {done} of {of}"),
        )
    say(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


@app.command()
def sample(
    out: Annotated[Path, typer.Option(help="Folder to write; it must not exist or be empty.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Another room than the one that is shipped.")] = None,
) -> None:
    """Make the sample capture again that the package ships, or another of its kind."""
    from roomlight_generator.sample import SEED, generate_sample

    with console.err.status("solving the room's light and filming"):
        generate_sample(out, seed=SEED if seed is None else seed)
    say(f"written to {out}; try: roomlight replay {out} --probes-from-capture --out light")


def _open(folder: Path, split: Split | None) -> Dataset:
    from roomlight.dataset.loader import Dataset

    return Dataset(folder, split)


if __name__ == "__main__":
    run(app)
