"""Validation on held-out rooms during training: the paper's losses, and pictures.

It gives a run's curve and selects its best weights; published results, beside baselines, come from `roomlight eval`,
which runs the serving engine. Single views have 120 rows and the evaluation's means and units, so that their numbers
can be compared with it; sequences have the height of training.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OutputError
from roomlight.metrics import intervals
from roomlight_model.sphere_rendering import shade
from roomlight_model.training.batches import Batch, collate
from roomlight_model.training.examples import DepthKind, example_of, read_example
from roomlight_model.training.losses import Losses, draw_sphere, log_l2_loss, radiance_along, rendering_loss
from roomlight_model.training.sequences import PreparedWalk, WalkBatch, collate_walks, read_walk, with_views
from roomlight_model.training.subsets import Recordings

if TYPE_CHECKING:
    from roomlight_model.training.video import Unroll

HEIGHT: Final = 120
MOST_WALKS: Final = 12
"""Held-out walks that are scored, at most; the networks run once for each frame."""
_DARK_EV: Final = -4.0
"""Exposure of a second copy of every panorama, which shows the light sources."""
_SPHERE: Final = (96, 64)
"""Pixels and samples of the glossy sphere; the directions are the same in every validation."""

Predict = Callable[[Batch], Mapping[str, Float[Tensor, "b p 3 h w"]]]
"""Predicts panoramas of a batch by name: the volume's (`sglv`), and the blended ones if the stage trains them."""
Picture = UInt8[np.ndarray, "_ _ 3"]


class SingleViewValidation:
    """First frames of some sequences with exact depth, collated once.

    If training uses several frames, also as many frames spread over each walk.
    """

    def __init__(
        self, recordings: Recordings, *, volume_shape: tuple[int, int, int], frames: int, rendering_weight: float
    ) -> None:
        """Collate the sequences.

        Args:
            volume_shape: Resolution [z, y, x] of the volumes.
            frames: Largest number of frames of an example in training.
            rendering_weight: Weight of the rendering loss in the score "loss".
        """
        rng = np.random.default_rng(0)
        self._rendering_weight = rendering_weight
        self._images: list[Picture] = []
        self._batches: list[Batch] = []
        self._walks: list[Batch] = []
        for number in range(len(recordings)):
            example = example_of(recordings.read(number, frames=[0]), rng, depth="exact")
            self._images.append(linear_to_srgb8(example.frame.image))
            batch = collate([example], volume_shape=volume_shape, panorama_height=HEIGHT)
            self._batches.append(batch)
            if frames > 1:
                walk = read_example(recordings, number, rng, depth="exact", augment=False, frames=frames)
                self._walks.append(collate([walk], volume_shape=volume_shape, panorama_height=HEIGHT))

    @torch.no_grad()
    def scores(self, predict: Predict) -> dict[str, float]:
        """Return the mean log-L2 and rendering loss of each kind of panorama, and `loss`, the sum that is minimised.

        Kinds: the volume's (`sglv`), the blended ones if the stage trains them (`blended`); `_walk`: after all frames
        of a walk. `loss` is the blended panoramas', or the volume's, and the mean with that after a walk.
        """
        errors: dict[str, list[tuple[float, float]]] = {}
        for batches, after in ((self._batches, ""), (self._walks, "_walk")):
            for batch in batches:
                for name, panoramas in predict(batch).items():
                    errors.setdefault(name + after, []).append(_errors(panoramas.cpu(), batch))
        trained = [name for name in errors if name.startswith("blended")] or list(errors)
        scores: dict[str, float] = {}
        for name, values in errors.items():
            scores[f"log_l2_{name}"], scores[f"rendering_{name}"] = np.mean(values, axis=0).tolist()
        losses = [scores[f"log_l2_{name}"] + self._rendering_weight * scores[f"rendering_{name}"] for name in trained]
        return {"loss": float(np.mean(losses)), **scores}

    @torch.no_grad()
    def draw(self, predict: Predict, path: Path, *, rows: int = 6) -> None:
        """Write a PNG with a row for each of the first sequences: frame, then truth, volume and blended, also darker.

        Raises:
            OutputError: The file cannot be written.
        """
        lines: list[list[Picture]] = []
        for image, batch in zip(self._images[:rows], self._batches, strict=False):
            frame = cv2.resize(image, (2 * HEIGHT * 4 // 3, 2 * HEIGHT), interpolation=cv2.INTER_AREA)
            shown = (batch.truth[0], *(panoramas[0] for panoramas in predict(batch).values()))
            lines.append([frame, *(_two_exposures(panoramas[0]) for panoramas in shown)])
        _write_rows(path, lines)


Unrolled = Callable[[WalkBatch], Any]
"""Begins to run a model over a batch and returns a `video.Unroll`."""


class WalkValidation:
    """The first frames of held-out walks, up to the stage's number; every second one has phone-like depth."""

    def __init__(
        self,
        recordings: Recordings,
        *,
        frames: int,
        depth: DepthKind,
        volume_shape: tuple[int, int, int],
        panorama_height: int,
        with_probes: bool,
    ) -> None:
        """Take the first walks; they are read again for every validation.

        Args:
            frames: Largest number of frames of a sequence.
            depth: Depth of training; "exact" gives all walks exact depth.
            volume_shape: Resolution [z, y, x] of the volumes.
            with_probes: Whether the model needs what the probes see of each frame's mesh.
        """
        self._recordings, self._numbers = recordings, tuple(range(min(len(recordings), MOST_WALKS)))
        self._frames, self._depth, self._volume_shape = frames, depth, volume_shape
        self._height, self._with_probes = panorama_height, with_probes
        self._alone: list[Losses] = []

    @torch.no_grad()
    def scores(self, unroll: Unrolled) -> dict[str, float]:
        """Return mean losses of the frames after the first: `video` of all, `video_01_07` and so on by the intervals of
        `metrics.intervals`, counted from 1, and `no_rnn` of each alone, through the single-view networks. `loss` is the
        one that training lowers.
        """
        losses: dict[str, list[Losses]] = {}
        alone: list[Losses] = []
        for number in self._numbers:
            batch = self._batch(number)
            sequence: Unroll = unroll(batch)
            for frame in range(1, batch.frames):
                now = sequence.advance(frame)
                losses.setdefault("video", []).append(now)
                part = next(part for part in intervals(batch.frames) if frame in part)
                losses.setdefault(f"video_{part.start + 1:02d}_{part.stop:02d}", []).append(now)
                if not self._alone:
                    alone.append(unroll(batch.cut(frame, frame + 1)).first_losses())
        self._alone = self._alone or alone  # the stages do not train the single-view networks
        scores = {"loss": _mean(losses["video"], "loss")}
        for name, values in {**losses, "no_rnn": self._alone}.items():
            for part in ("log_l2", "rendering", "smoothness"):
                if (name, part) != ("no_rnn", "smoothness"):
                    scores[f"{part}_{name}"] = _mean(values, part)
        return scores

    @torch.no_grad()
    def draw(self, unroll: Unrolled, path: Path, *, rows: int = 4) -> None:
        """Write a PNG with a row for each of the first walks: the truth, then the first, middle and last frame's light.

        Raises:
            OutputError: The file cannot be written.
        """
        lines: list[list[Picture]] = []
        for number in self._numbers[:rows]:
            batch = self._batch(number)
            sequence: Unroll = unroll(batch)
            shown = [batch.truth(0), sequence.panoramas()]
            for frame in range(1, batch.frames):
                sequence.advance(frame)
                if frame in (batch.frames // 2, batch.frames - 1):
                    shown.append(sequence.panoramas())
            lines.append([_two_exposures(panoramas[0, 0].float()) for panoramas in shown])
        _write_rows(path, lines)

    def _batch(self, number: int) -> WalkBatch:
        length = min(self._frames, self._recordings.frames_of(number))
        depth: DepthKind = "arkit" if number % 2 and self._depth != "exact" else "exact"
        rng = np.random.default_rng(number)
        walk = read_walk(self._recordings, number, rng, depth=depth, length=length, augment=False)
        prepared = [PreparedWalk.of(walk, self._volume_shape)]
        batch = collate_walks(prepared, panorama_height=self._height)
        return with_views(batch, prepared, panorama_height=self._height) if self._with_probes else batch


def _mean(losses: Sequence[Losses], name: str) -> float:
    return float(np.mean([float(frame[name]) for frame in losses]))


def _errors(panoramas: Float[Tensor, "b p 3 h w"], batch: Batch) -> tuple[float, float]:
    """Return (log-L2, rendering loss) of one sequence's probes."""
    pixels, samples = _SPHERE
    sphere = draw_sphere(batch, pixels=pixels, samples=samples, generator=torch.Generator().manual_seed(0))
    shaded, true_shaded = (shade(sphere, radiance_along(sphere, light)) for light in (panoramas, batch.truth))
    return float(log_l2_loss(panoramas, batch.truth)), float(rendering_loss(shaded, true_shaded))


def _two_exposures(panorama: Float[Tensor, "3 h w"]) -> UInt8[np.ndarray, "2*h w 3"]:
    """Return a panorama as shown on a screen, above a darker copy."""
    linear = panorama.permute(1, 2, 0).cpu().numpy()
    return np.concatenate([linear_to_srgb8(linear), linear_to_srgb8(linear * 2**_DARK_EV)])


def _write_rows(path: Path, rows: Sequence[Sequence[Picture]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = np.concatenate([np.concatenate(cells, axis=1) for cells in rows])
    if not cv2.imwrite(str(path), picture[..., ::-1]):
        raise OutputError(f"{path}: the picture cannot be written")
