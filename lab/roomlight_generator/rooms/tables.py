"""Tables of rooms: TOML files beside the modules that use them."""

import tomllib
from pathlib import Path
from typing import Any


def read_table(path: Path) -> dict[str, Any]:
    """Read a TOML file of the package; arrays become tuples, as frozen dataclasses want them."""
    return {name: _with_tuples(value) for name, value in tomllib.loads(path.read_text(encoding="utf-8")).items()}


def _with_tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_tuples(inner) for key, inner in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value
