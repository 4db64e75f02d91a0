"""Names of the product's code: words that could name anything are nobody's name; the glossary has the thing's own."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
WORDS = {"one", "found", "held", "each", "casting", "standing", "placing"}
CANDIDATE = re.compile(rf"\b_*(?:{'|'.join(WORDS)})_*\b *(?:[=.,:)\[\]]|in\b)")  # parsing only these files is faster


def identifier(node: ast.AST) -> str:
    """The name that a node defines or uses; empty for nodes without a name."""
    values = (getattr(node, key, None) for key in ("id", "attr", "arg", "name"))
    return next((value.strip("_").lower() for value in values if isinstance(value, str)), "")


def test_no_name_could_name_anything() -> None:
    vague: list[str] = []
    for package in ("cli", "client", "core", "export", "lab", "model", "server"):
        for path in (ROOT / package).rglob("*.py"):
            if CANDIDATE.search(source := path.read_text(encoding="utf-8")) is None:
                continue
            words = WORDS - {"one"} if path.parent.name == "kernels" else WORDS  # there `one` is the number
            nodes = (node for node in ast.walk(ast.parse(source)) if identifier(node) in words)
            vague += [f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', '?')}: {identifier(node)}" for node in nodes]
    assert not vague
