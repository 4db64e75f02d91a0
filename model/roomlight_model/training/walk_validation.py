"""Validation of the video stages on held-out walks: losses by intervals of frames, beside each frame alone; pictures.

It gives a run's curve and selects its best weights. Panoramas have the height of training.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OutputError
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.training.examples import Recordings
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.sequences import PreparedWalk, WalkBatch, collate_walks, read_walk, with_views
from roomlight_model.training.stages import Losses
from roomlight_model.training.unroll import Unroll

INTERVALS: Final = ((1, 8), (8, 14), (14, 20), (20, 26), (26, 32))
"""Frames of the paper's table, first and past the last."""
MOST_WALKS: Final = 12
"""Held-out walks that are scored, at most; the networks run once for each frame."""
_RAYS: Final = 2048
_DARK_EV: Final = -4.0
"""Exposure of a second copy of every panorama, which shows the light sources."""


class WalkValidation:
    """The first frames of held-out walks, up to the stage's number; every second one has phone-like depth."""

    def __init__(self, recordings: Recordings, numbers: Sequence[int], options: TrainOptions) -> None:
        """Take the first of the sequences of these numbers; they are read again for every validation."""
        self._recordings, self._numbers = recordings, tuple(numbers)[:MOST_WALKS]
        # joint training also keeps the volume alone accurate; what counts here is what a probe shows
        stage = "video-sglv" if options.stage == "video-sglv" else "video-blend"
        self._options = replace(options, stage=stage, rays=_RAYS, bf16=False)
        self._alone: list[Losses] = []

    def scores(self, model: SingleModel | VideoModel, *, device: torch.device) -> dict[str, float]:
        """Return mean losses: `video` over all frames after the first, `video_01_07` and so on by intervals, and
        `no_rnn`: each of these frames alone, through the single-view networks.
        """
        losses: dict[str, list[Losses]] = {}
        alone: list[Losses] = []
        with torch.no_grad():
            for number in self._numbers:
                batch = self._batch(number).to(device)
                unroll = self._unroll(model, batch, device)
                for frame in range(1, batch.frames):
                    now = unroll.advance(frame)
                    losses.setdefault("video", []).append(now)
                    for first, past in INTERVALS:
                        if first <= frame < past:
                            losses.setdefault(f"video_{first:02d}_{past - 1:02d}", []).append(now)
                    if not self._alone:
                        alone.append(self._unroll(model, batch.cut(frame, frame + 1), device).first_losses())
        self._alone = self._alone or alone  # the stages do not train the single-view networks
        scores: dict[str, float] = {}
        for name, values in {**losses, "no_rnn": self._alone}.items():
            for field in ("log_l2", "rendering", "smoothness"):
                if (name, field) != ("no_rnn", "smoothness"):
                    scores[f"{field}_{name}"] = float(np.mean([float(getattr(value, field)) for value in values]))
        return scores

    def loss(self, scores: dict[str, float]) -> float:
        """Return the loss that the stage trains, over all frames after the first."""
        options = self._options
        rendering = options.rendering_weight * scores["rendering_video"]
        return scores["log_l2_video"] + rendering + options.smoothness_weight * scores["smoothness_video"]

    def draw(self, model: SingleModel | VideoModel, path: Path, *, device: torch.device, rows: int = 4) -> None:
        """Write a PNG with a row for each of the first walks: the truth, then the first, middle and last frame's light.

        Raises:
            OutputError: The file cannot be written.
        """
        lines: list[UInt8[np.ndarray, "h w 3"]] = []
        for number in self._numbers[:rows]:
            batch = self._batch(number).to(device)
            shown = [batch.truth(0)]
            with torch.no_grad():
                unroll = self._unroll(model, batch, device)
                for frame in range(batch.frames):
                    if frame:
                        unroll.advance(frame)
                    if frame in (0, batch.frames // 2, batch.frames - 1):
                        shown.append(unroll.panoramas())
            cells = [panoramas[0, 0].permute(1, 2, 0).float().cpu().numpy() for panoramas in shown]
            lines.append(
                np.concatenate(
                    [np.concatenate([linear_to_srgb8(one), linear_to_srgb8(one * 2**_DARK_EV)]) for one in cells],
                    axis=1,
                )
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), np.concatenate(lines)[..., ::-1]):
            raise OutputError(f"{path}: the picture cannot be written")

    def _unroll(self, model: SingleModel | VideoModel, batch: WalkBatch, device: torch.device) -> Unroll:
        assert isinstance(model, VideoModel)
        return Unroll(model, batch, self._options, generator=torch.Generator().manual_seed(0), device=device)

    def _batch(self, number: int) -> WalkBatch:
        options, rng = self._options, np.random.default_rng(number)
        length = min(options.frames, self._recordings.frames_of(number))
        depth = "arkit" if number % 2 and options.depth != "exact" else "exact"
        walk = read_walk(self._recordings, number, rng, depth=depth, length=length, augment=False)
        prepared = [PreparedWalk.of(walk, options.volume_shape)]
        height = options.panorama_height
        batch = collate_walks(prepared, panorama_height=height)
        return batch if options.stage == "video-sglv" else with_views(batch, prepared, panorama_height=height)
