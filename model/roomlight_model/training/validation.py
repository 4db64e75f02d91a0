"""Validation on held-out rooms during training: the paper's two losses, and pictures.

It gives a run's curve and selects its best weights; published results, beside baselines, come from `roomlight eval`,
which runs the serving engine. Both use 120 rows, the same means and units, the first frame and exact depth, so that
their numbers can be compared.
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
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.sphere_rendering import disc, look_up, sample_sphere, shade, sphere_normals
from roomlight_model.training.batches import Batch, collate
from roomlight_model.training.examples import Recordings, example_of, read_example
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.stages import predicted_panoramas, rendered_panoramas

HEIGHT: Final = 120
_DARK_EV: Final = -4.0
"""Exposure of a second copy of every panorama, which shows the light sources."""
_SPHERE: Final = (96, 64)
"""Pixels and samples of the glossy sphere; the directions are the same in every validation."""

Panoramas = Float[Tensor, "p 3 h w"]


class Validation:
    """First frames of some sequences with exact depth, collated once.

    If training uses several frames, also as many frames spread over each walk.
    """

    def __init__(self, recordings: Recordings, numbers: Sequence[int], options: TrainOptions) -> None:
        """Collate the sequences of these numbers."""
        rng = np.random.default_rng(0)
        self._options = options
        self.images: list[UInt8[np.ndarray, "h w 3"]] = []
        self._batches: list[Batch] = []
        self._walks: list[Batch] = []
        for number in numbers:
            example = example_of(recordings.read(number, frames=[0]), rng, depth="exact")
            self.images.append(linear_to_srgb8(example.frame.image))
            batch = collate([example], volume_shape=options.volume_shape, panorama_height=HEIGHT)
            self._batches.append(batch)
            if options.frames > 1:
                walk = read_example(recordings, number, rng, depth="exact", augment=False, frames=options.frames)
                self._walks.append(collate([walk], volume_shape=options.volume_shape, panorama_height=HEIGHT))

    def scores(self, model: SingleModel | VideoModel, *, device: torch.device) -> dict[str, float]:
        """Return the mean log-L2 and rendering loss of each method.

        Methods: the volume (`sglv`), and the blended panoramas if the stage trains them (`blended`). `_walk`: after all
        frames of a walk.
        """
        errors: dict[str, list[tuple[float, float]]] = {}
        for batches, after in ((self._batches, ""), (self._walks, "_walk")):
            for batch in batches:
                for name, panoramas in self._predict(model, batch, device).items():
                    errors.setdefault(name + after, []).append(_errors(panoramas, batch))
        scores: dict[str, float] = {}
        for name, values in errors.items():
            scores[f"log_l2_{name}"], scores[f"rendering_{name}"] = np.mean(values, axis=0).tolist()
        return scores

    @property
    def blends(self) -> bool:
        """Whether the stage trains the blending networks."""
        return self._options.stage != "single-sglv"

    def loss(self, scores: dict[str, float]) -> float:
        """Return the paper's loss of the networks that the stage trains: log-L2 plus the weighted rendering loss.

        With walks, it is the mean of both.
        """
        name = "blended" if self.blends else "sglv"
        weight, names = self._options.rendering_weight, [name, name + "_walk"] if self._walks else [name]
        return float(np.mean([scores[f"log_l2_{one}"] + weight * scores[f"rendering_{one}"] for one in names]))

    def draw(self, model: SingleModel | VideoModel, path: Path, *, device: torch.device, rows: int = 6) -> None:
        """Write a PNG with a row for each of the first sequences: frame, then truth, volume and blended, also darker.

        Raises:
            OutputError: The file cannot be written.
        """
        lines: list[UInt8[np.ndarray, "h w 3"]] = []
        for image, batch in zip(self.images[:rows], self._batches, strict=False):
            cells = [cv2.resize(image, (2 * HEIGHT * 4 // 3, 2 * HEIGHT), interpolation=cv2.INTER_AREA)]
            for panoramas in (batch.truth[0], *self._predict(model, batch, device).values()):
                shown = panoramas[0].permute(1, 2, 0).numpy()
                cells.append(np.concatenate([linear_to_srgb8(shown), linear_to_srgb8(shown * 2**_DARK_EV)]))
            lines.append(np.concatenate(cells, axis=1))
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), np.concatenate(lines)[..., ::-1]):
            raise OutputError(f"{path}: the picture cannot be written")

    def _predict(self, model: SingleModel | VideoModel, batch: Batch, device: torch.device) -> dict[str, Panoramas]:
        assert isinstance(model, SingleModel)
        here = batch.to(device)
        with torch.no_grad():
            sglv = model(here.volume)
            if not self.blends:
                return {"sglv": rendered_panoramas(sglv, here, height=HEIGHT, device=device)[0].cpu()}
            hdr, blended = predicted_panoramas(
                model, sglv, here, weight_height=self._options.panorama_height, bf16=False, device=device
            )
        return {"sglv": hdr[0].cpu(), "blended": blended[0].cpu()}


def _errors(panoramas: Panoramas, batch: Batch) -> tuple[float, float]:
    """Return (log-L2, rendering loss) of one sequence's probes."""
    truth = batch.truth[0]
    difference = torch.log1p(panoramas.clamp(min=0)) - torch.log1p(truth)
    generator = torch.Generator().manual_seed(0)
    pixels, samples = _SPHERE
    points = disc(pixels, batch=(len(truth),), generator=generator)
    sphere = sample_sphere(
        sphere_normals(batch.to_viewer[0], points), batch.to_viewer[0], samples=samples, generator=generator
    )
    flat = sphere.directions.flatten(1, 2)
    spheres = [shade(sphere, look_up(light, flat).reshape(sphere.directions.shape)) for light in (panoramas, truth)]
    rendering = (spheres[0].clamp(max=1) - spheres[1].clamp(max=1)).square().mean()
    return float(difference.square().mean()), float(rendering)
