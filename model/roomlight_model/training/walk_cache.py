"""A folder of prepared sequences for `video-blend`, whose 3D networks do not change: each is computed once.

Volumes, meshes, views and the 3D networks are most of that stage's work (`roomlight bench train`). Radiance is kept in
half precision; a sequence is rounded before its first use too, so that a resumed run repeats its curve.
"""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from roomlight.files import write_atomic
from roomlight_model.training.sequences import WalkBatch

_HALVES: Final = ("lights", "detail", "mask", "clipped", "guessed", "hdr")
"""Linear radiance is at most 60,000 (`training.examples`), half precision 65,504."""
_MOST: Final = 65_504.0


class WalkCache:
    """Sequences by number of the recording and number of the variant, one file each."""

    def __init__(self, folder: Path) -> None:
        """Use this folder; it is made when the first sequence is kept."""
        self._folder = folder

    def get(self, index: int, variant: int, make: Callable[[], WalkBatch]) -> WalkBatch:
        """Return a sequence, made and stored if it is not there.

        Raises:
            OutputError: The folder cannot be written.
        """
        path = self._folder / f"{index:06d}-{variant}.pt"
        if not path.exists():
            self._folder.mkdir(parents=True, exist_ok=True)
            fields = {name: value for name, value in vars(make()).items() if isinstance(value, Tensor)}
            small = {
                name: value.clamp(max=_MOST).half() if name in _HALVES else value for name, value in fields.items()
            }
            buffer = BytesIO()
            torch.save(small, buffer)
            write_atomic(path, buffer.getvalue())
        stored = torch.load(path, weights_only=True, map_location="cpu")
        return WalkBatch(**{name: value.float() if name in _HALVES else value for name, value in stored.items()})
