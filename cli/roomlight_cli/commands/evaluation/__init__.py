"""`roomlight eval`: light against ground truth, each kind of score a command of its own."""

from typing import Final

from roomlight_cli.lazy import CommandEntry, lazy_app

_COMMANDS: Final = "roomlight_cli.commands.evaluation"

EVALUATIONS: Final = (
    CommandEntry(
        "captures", f"{_COMMANDS}.captures:captures", "Score light against the ground-truth probes of recordings."
    ),
    CommandEntry(
        "depth",
        f"{_COMMANDS}.captures:depth",
        "Score estimated depth on recordings whose own depth is hidden from it, and the light that follows.",
    ),
    CommandEntry(
        "poses",
        f"{_COMMANDS}.captures:poses",
        "Score estimated camera poses on recordings whose pictures become a video without anything else.",
    ),
    CommandEntry(
        "walks",
        f"{_COMMANDS}.rooms:walks",
        "Score the networks on walks through rooms that no network was trained on.",
    ),
    CommandEntry(
        "benchmark",
        f"{_COMMANDS}.rooms:benchmark",
        "Generate test rooms by their seed, and score spheres in their light after one image and after a walk.",
    ),
    CommandEntry(
        "composite",
        f"{_COMMANDS}.objects:composite",
        "Compare virtual objects in pictures with the same rooms with the object really in them.",
    ),
    CommandEntry(
        "objects",
        f"{_COMMANDS}.objects:objects",
        "Score spheres and a sphere's shadow in the light after a few frames, in many rooms with ground truth.",
    ),
)

app = lazy_app(EVALUATIONS, help_text="Score light against ground truth.")
