"""How a run does on rooms it does not train on: the paper's losses beside the mean colour's, and pictures.

For the curve of a run only; what is reported of a model is `roomlight eval`, by the serving engine.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OutputError
from roomlight_model.networks import SingleModel
from roomlight_model.training.examples import Batch, Recordings, collate, example_of
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.stages import predicted_panoramas

HEIGHT: Final = 60
_DARK_EV: Final = -4.0
"""A second copy of every panorama this much darker shows the sources."""


class Validation:
    """The first frames of some sequences, collated once; exact depth."""

    def __init__(self, recordings: Recordings, numbers: Sequence[int], options: TrainOptions) -> None:
        """`numbers` says which sequences."""
        rng = np.random.default_rng(0)
        self.images: list[UInt8[np.ndarray, "h w 3"]] = []
        self._batches: list[Batch] = []
        self._means: list[Tensor] = []
        for number in numbers:
            example = example_of(recordings.read(number, frames=[0]), 0, rng, depth="exact")
            self.images.append(linear_to_srgb8(example.frame.image))
            self._batches.append(collate([example], volume_shape=options.volume_shape, panorama_height=HEIGHT))
            self._means.append(torch.from_numpy(example.frame.image.mean((0, 1), dtype=np.float64)).float())

    def scores(self, model: SingleModel, *, device: torch.device) -> dict[str, float]:
        """Mean log-L2 of the volume alone, of the blended panoramas, and of the frame's mean colour everywhere."""
        errors: dict[str, list[float]] = {"sglv": [], "blended": [], "mean_colour": []}
        for batch, mean in zip(self._batches, self._means, strict=True):
            hdr, blended = self._predict(model, batch, device)
            flat = mean[:, None, None].expand_as(batch.truth)
            for name, panoramas in (("sglv", hdr), ("blended", blended), ("mean_colour", flat)):
                difference = torch.log1p(panoramas.clamp(min=0)) - torch.log1p(batch.truth)
                errors[name].append(float(difference.square().mean()))
        return {f"log_l2_{name}": float(np.mean(values)) for name, values in errors.items()}

    def draw(self, model: SingleModel, path: Path, *, device: torch.device, rows: int = 6) -> None:
        """PNG, a row for each of the first sequences: its frame, then truth, volume and blended, each also darker."""
        lines: list[UInt8[np.ndarray, "h w 3"]] = []
        for image, batch in zip(self.images[:rows], self._batches, strict=False):
            hdr, blended = self._predict(model, batch, device)
            cells = [cv2.resize(image, (4 * HEIGHT // 3 * 2, 2 * HEIGHT), interpolation=cv2.INTER_AREA)]
            for panoramas in (batch.truth, hdr, blended):
                shown = panoramas[0, 0].permute(1, 2, 0).numpy()
                cells.append(np.concatenate([linear_to_srgb8(shown), linear_to_srgb8(shown * 2**_DARK_EV)]))
            lines.append(np.concatenate(cells, axis=1))
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), np.concatenate(lines)[..., ::-1]):
            raise OutputError(f"{path}: the picture cannot be written")

    def _predict(
        self, model: SingleModel, batch: Batch, device: torch.device
    ) -> tuple[Float[Tensor, "b p 3 h w"], Float[Tensor, "b p 3 h w"]]:
        here = batch.to(device)
        with torch.no_grad():
            hdr, blended = predicted_panoramas(model, model(here.volume), here, bf16=False, device=device)
        return hdr.cpu(), blended.cpu()
