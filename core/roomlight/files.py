"""What commands write besides pictures: JSON, whole or not at all."""

import json
from pathlib import Path
from typing import Any

from roomlight.images import write_atomic


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write plain JSON values, indented; OutputError if the file cannot be written."""
    write_atomic(path, (json.dumps(values, indent=1) + "\n").encode())
