"""`roomlight bench`: the benchmarks of the repository, each a command of its own."""

from typing import Final

from roomlight_cli.lazy import CommandEntry, lazy_app

_COMMANDS: Final = "roomlight_cli.commands.bench"

BENCHMARKS: Final = (
    CommandEntry(
        "stages",
        f"{_COMMANDS}.engine:stages",
        "Time each stage beside its reference and plain PyTorch; networks also against this machine's peak.",
    ),
    CommandEntry(
        "server",
        f"{_COMMANDS}.server:server",
        "Load a server on this machine with streaming phones, beside direct engine calls (2 minutes).",
    ),
    CommandEntry(
        "hostile",
        f"{_COMMANDS}.server:hostile",
        "Attack a server on this machine while a neighbour streams: frames that it keeps, latency, memory.",
    ),
    CommandEntry(
        "composite",
        f"{_COMMANDS}.engine:composite",
        "Measure what virtual objects in a frame cost by part.",
    ),
)

app = lazy_app(BENCHMARKS, help_text="Measure speed: every figure as a ratio within one run.")
