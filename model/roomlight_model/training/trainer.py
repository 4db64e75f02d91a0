"""The training loop: batches prepared in advance, EMA weights, checkpoints from which a killed run resumes.

A run is a folder:

    options.json      the options (`TrainOptions`)
    last.pt           the state to resume from: written atomically every few minutes
    model.pt          the EMA weights as a checkpoint that `roomlight export` reads
    best.pt           likewise, with the best score on held-out rooms (`keep_scored`)
    log.jsonl         one line for every reported step
    tensorboard/      the same curves
    pictures/         panoramas of held-out rooms during training
    cache/            prepared sequences (`TrainOptions.variants`); may be deleted

All random choices follow from (seed, step), so that a resumed run repeats the loss curve of an uninterrupted one.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Final

import numpy as np
import torch

from roomlight.errors import ModelError, OutputError
from roomlight.files import write_atomic
from roomlight_model.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from roomlight_model.networks import SingleModel, VideoModel, build
from roomlight_model.training.batches import Batch, collate
from roomlight_model.training.examples import Recordings, read_example
from roomlight_model.training.gradients import BatchGradients
from roomlight_model.training.light_changes import LightChanges
from roomlight_model.training.options import OPTIONS, STAGES, TrainOptions, is_video
from roomlight_model.training.sequences import (
    LightChange,
    PreparedWalk,
    WalkBatch,
    collate_walks,
    draw_length,
    joined,
    read_walk,
    with_views,
)
from roomlight_model.training.stages import Losses, trained_modules
from roomlight_model.training.starting import starting_model, starting_options
from roomlight_model.training.step_clock import StepClock
from roomlight_model.training.unroll import with_renderings
from roomlight_model.training.walk_cache import WalkCache

_AHEAD: Final = 3
"""Batches prepared in advance."""
_REPORT_STEPS: Final = 20
_CURVES: Final = ("loss", "log_l2", "rendering", "smoothness")
"""Names of the fields of `Losses` in a run's curves."""
LAST: Final = "last.pt"
"""File with the state to resume from, in a run's folder."""


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a run, reported every few steps; means since the last report."""

    step: int
    steps: int
    loss: float
    log_l2: float
    rendering: float
    smoothness: float
    learning_rate: float
    seconds_a_step: float
    waited_for_data: float
    """Share of the time."""


ProgressCallback = Callable[[TrainingProgress], object]


class Trainer:
    """One stage of training in one folder. Set `clock` to time the parts of each step."""

    def __init__(
        self,
        options: TrainOptions,
        recordings: Recordings,
        out: Path,
        *,
        device: torch.device,
        start_from: Checkpoint | None = None,
        data: Callable[[], list[dict[str, Any]]] = list,
        change_light: LightChange | None = None,
    ) -> None:
        """Start a run in an empty folder, or resume the folder's run.

        A run can be resumed with another number of steps; the learning rate then follows the new length.

        Args:
            options: The options of the run.
            recordings: The sequences to train on.
            out: The run's folder.
            device: The device of the networks.
            start_from: Weights of an earlier stage.
            data: Returns the description of the sequences for the card.
            change_light: Video stages: changes the light of sequences at a frame; see `sequences.LightChange`. None
                changes it as `options.light_changes` says.

        Raises:
            ModelError: The folder's run has other options, `start_from` does not fit the stage, or there are fewer
                sequences than a batch needs.
            OutputError: The folder holds other files, or cannot be written.
        """
        if len(recordings) < options.batch:
            raise ModelError(f"{len(recordings)} sequences are fewer than a batch of {options.batch}")
        options = starting_options(options, start_from)
        self.options, self.out, self.device = options, out, device
        if change_light is None and options.light_changes:
            change_light = LightChanges(options.light_changes)
        self._recordings, self._data, self._change_light = recordings, data, change_light
        self._before = None if start_from is None else start_from.card
        self.model = starting_model(options, start_from, resumes=(out / LAST).exists())
        _channels_last(self.model.to(device))
        for parameter in self.model.parameters():
            parameter.requires_grad_(False)
        parameters = [p for module in trained_modules(self.model, options.stage) for p in module.parameters()]
        for parameter in parameters:
            parameter.requires_grad_(True)
        self._parameters = parameters
        self._gradients = BatchGradients(self.model, parameters, options, device=device)
        self._optimizer = torch.optim.AdamW(
            parameters,
            lr=options.learning_rate,
            weight_decay=options.weight_decay,
            fused=True,  # 1.5 ms a step where the plain loop takes 7.7
        )
        self.average = {name: value.detach().clone() for name, value in self.model.state_dict().items()}
        self._cache = WalkCache(out / "cache")
        self.step = 0
        self.seconds = 0.0
        self.clock: StepClock | None = None
        self._window = dict.fromkeys(_CURVES, 0.0)
        self._open()

    def train(
        self,
        *,
        report: ProgressCallback,
        every: Callable[["Trainer"], object] | None = None,
        every_steps: int = 1000,
        checkpoint_s: float = 240.0,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Train until the options' last step, or until `stop` returns True; then save the run's state.

        `every` is called with the trainer after every `every_steps` steps (evaluation, pictures).

        Raises:
            ModelError: The loss is not finite.
            OutputError: The folder cannot be written.
        """
        saved = began = time.monotonic()
        before = self.seconds
        total, waited, counted, since = self._window, 0.0, 0, began
        batches = self._batches()
        self.model.train()
        while self.step < self.options.steps and not stop():
            requested_at = time.monotonic()
            batch = next(batches)
            waited += time.monotonic() - requested_at
            losses = self._one_step(batch)
            self.step += 1
            for name, value in zip(_CURVES, losses, strict=True):
                total[name] += float(value)
            counted += 1
            now = time.monotonic()
            self.seconds = before + now - began
            if self.step % _REPORT_STEPS == 0 or self.step == self.options.steps:
                count = (self.step - 1) % _REPORT_STEPS + 1
                progress = TrainingProgress(
                    step=self.step,
                    steps=self.options.steps,
                    **{name: value / count for name, value in total.items()},
                    learning_rate=self._rate(),
                    seconds_a_step=(now - since) / max(counted, 1),
                    waited_for_data=waited / max(now - since, 1e-9),
                )
                if self.step % _REPORT_STEPS == 0:  # a run that ended in between may be made longer
                    total.update(dict.fromkeys(total, 0.0))
                waited, counted, since = 0.0, 0, now
                self._log(vars(progress))
                report(progress)
            if every is not None and self.step % every_steps == 0:
                every(self)
                self.model.train()
                waited, counted, since = 0.0, 0, time.monotonic()
            if time.monotonic() - saved > checkpoint_s:
                self.save()
                saved = time.monotonic()
        self.save()

    def averaged(self) -> SingleModel | VideoModel:
        """Build a model with the EMA weights, for evaluation."""
        model = build(self.model.form, self.options.trained_model).to(self.device)
        model.load_state_dict(self.average)
        return _channels_last(model).eval()

    def keep_scored(self, score: float, scores: Mapping[str, float] | None = None) -> bool:
        """Write model.pt with the score of its EMA weights, and best.pt if no earlier score was as low.

        Returns whether best.pt was written.
        """
        averaged, card = self.averaged(), {**self.card(), "held_out": score, "scores": dict(scores or {})}
        save_checkpoint(self.out / "model.pt", averaged, card=card)
        best = self.out / "best.pt"
        if best.exists():
            before = load_checkpoint(best).card.get("held_out")
            if isinstance(before, int | float) and before <= score:
                return False
        save_checkpoint(best, averaged, card=card)
        return True

    def save(self) -> None:
        """Write last.pt and model.pt, each atomically."""
        buffer = BytesIO()
        torch.save(
            {
                "step": self.step,
                "seconds": self.seconds,
                "window": self._window,
                "model": self.model.state_dict(),
                "average": self.average,
                "optimizer": self._optimizer.state_dict(),
            },
            buffer,
        )
        write_atomic(self.out / LAST, buffer.getvalue())
        save_checkpoint(self.out / "model.pt", self.averaged(), card=self.card())

    def card(self) -> dict[str, Any]:
        """Return the record of this stage for the checkpoint; `before` is the record of the stage it started from."""
        before = {} if self._before is None else {"before": self._before}
        return {
            "stage": self.options.stage,
            "steps": self.step,
            "hours": round(self.seconds / 3600, 3),
            "seed": self.options.seed,
            "sequences": len(self._recordings),
            "data": self._data(),
            "date": datetime.now(UTC).date().isoformat(),
            "options": self.options.to_dict(),
            **before,
        }

    def _one_step(self, batch: Batch | WalkBatch) -> Losses:
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate()
        self._gradients.clock = self.clock
        losses = self._gradients.of(batch, self.step)
        if not torch.isfinite(losses.total):
            loss = float(losses.total)
            raise ModelError(f"{self.out}: the loss is {loss} at step {self.step}; use a lower learning rate")
        with self._part("optimiser"):
            torch.nn.utils.clip_grad_norm_(self._parameters, 1.0)
            self._optimizer.step()
            keep = min(self.options.ema, (1 + self.step) / (10 + self.step))
            with torch.no_grad():
                for name, value in self.model.state_dict().items():
                    self.average[name].lerp_(value, 1 - keep)
        return losses

    def _part(self, name: str) -> AbstractContextManager[None]:
        return nullcontext() if self.clock is None else self.clock.part(name)

    def _rate(self) -> float:
        """Return the learning rate: linear warm-up, then a cosine down to a hundredth."""
        options = self.options
        if self.step < options.warm_up:
            return options.learning_rate * (self.step + 1) / options.warm_up
        done = (self.step - options.warm_up) / max(1, options.steps - options.warm_up)
        return options.learning_rate * (0.01 + 0.99 * 0.5 * (1 + float(np.cos(np.pi * min(done, 1.0)))))

    def _batches(self) -> Iterator[Batch | WalkBatch]:
        """Yield batches from the current step on, prepared in advance by two threads."""
        with ThreadPoolExecutor(2, thread_name_prefix="examples") as pool:
            waiting: list[Future[Batch | WalkBatch]] = []
            step = self.step
            make = self._walk_batch if is_video(self.options.stage) else self._batch
            try:
                while True:
                    while len(waiting) < _AHEAD:
                        waiting.append(pool.submit(make, step))
                        step += 1
                    yield waiting.pop(0).result()
            finally:
                for future in waiting:
                    future.cancel()

    def _batch(self, step: int) -> Batch:
        options = self.options
        with self._part("data"):
            examples = [
                read_example(
                    self._recordings,
                    index,
                    rng,
                    depth=options.depth,
                    augment=options.augment,
                    frames=options.frames,
                )
                for index, rng in self._drawn(step)
            ]
            height = None if options.stage == "single-sglv" else options.panorama_height
            return collate(examples, volume_shape=options.volume_shape, panorama_height=height)

    def _walk_batch(self, step: int) -> WalkBatch:
        options, drawn = self.options, list(self._drawn(step))
        if not options.variants:
            return self._prepared_walks(drawn, np.random.default_rng([options.seed, STAGES.index(options.stage), step]))
        variant = step * options.batch // len(self._recordings) % options.variants
        seeds = [options.seed, STAGES.index(options.stage), variant]

        def make(index: int) -> WalkBatch:
            # the lengths of a batch are equal: they follow from the variant alone
            batch = self._prepared_walks(
                [(index, np.random.default_rng([*seeds, index]))], np.random.default_rng(seeds)
            )
            assert isinstance(self.model, VideoModel)
            with self._part("mesh"):
                return with_renderings(batch, self.model, options, device=self.device)

        return joined([self._cache.get(index, variant, partial(make, index)) for index, _ in drawn])

    def _prepared_walks(self, drawn: Sequence[tuple[int, np.random.Generator]], rng: np.random.Generator) -> WalkBatch:
        """Prepare one sequence of each recording; `rng` draws their common length: they run side by side."""
        options = self.options
        most = min(options.frames, *(self._recordings.frames_of(index) for index, _ in drawn))
        length = draw_length(most, rng) if options.augment else most
        with self._part("data"):
            walks = [
                PreparedWalk.of(
                    read_walk(
                        self._recordings,
                        index,
                        own,
                        depth=options.depth,
                        length=length,
                        augment=options.augment,
                        change_light=self._change_light,
                        second_looks=options.second_looks,
                    ),
                    options.volume_shape,
                )
                for index, own in drawn
            ]
            height = None if options.stage == "video-sglv" else options.panorama_height
            batch = collate_walks(walks, panorama_height=height)
        if height is None:
            return batch
        with self._part("mesh"):
            return with_views(batch, walks, panorama_height=height)

    def _drawn(self, step: int) -> Iterator[tuple[int, np.random.Generator]]:
        """Yield the sequences of a step's batch, each with its generator."""
        options, count = self.options, len(self._recordings)
        for slot in range(options.batch):
            number = step * options.batch + slot
            order = np.random.default_rng([options.seed, number // count]).permutation(count)
            yield (
                int(order[number % count]),
                np.random.default_rng([options.seed, STAGES.index(options.stage), step, slot]),
            )

    def _open(self) -> None:
        options_path = self.out / OPTIONS
        if not options_path.exists():
            if self.out.exists() and any(self.out.iterdir()):
                raise OutputError(f"{self.out}: holds other files and no training run; give an empty folder")
            self.out.mkdir(parents=True, exist_ok=True)
            write_atomic(options_path, (json.dumps(self.options.to_dict(), indent=1) + "\n").encode())
        elif replace(before := TrainOptions.read(options_path), steps=self.options.steps) != self.options:
            ours, theirs = self.options.to_dict(), before.to_dict()
            changed = [name for name in ours if ours[name] != theirs[name] and name != "steps"]
            raise ModelError(
                f"{self.out}: its run has other options ({', '.join(changed)}); use another folder or the same options"
            )
        elif before != self.options:
            write_atomic(options_path, (json.dumps(self.options.to_dict(), indent=1) + "\n").encode())
        last = self.out / LAST
        if last.exists():
            try:
                state = torch.load(last, map_location=self.device, weights_only=True)
                self.model.load_state_dict(state["model"])
                self._optimizer.load_state_dict(state["optimizer"])
                self.average = {name: value.to(self.device) for name, value in state["average"].items()}
                self._window |= state["window"]
                self.step, self.seconds = int(state["step"]), float(state["seconds"])
            except (OSError, RuntimeError, KeyError, ValueError, IndexError, EOFError, UnpicklingError) as error:
                raise ModelError(f"{last}: cannot be resumed from ({error}); delete it to start again") from error
        self._cut_log()

    def _cut_log(self) -> None:
        """Remove lines that were logged after the checkpoint; those steps will be logged again."""
        log = self.out / "log.jsonl"
        if not log.exists():
            return
        kept: list[str] = []
        for line in log.read_text().splitlines():
            try:
                if json.loads(line)["step"] <= self.step:
                    kept.append(line)
            except (ValueError, KeyError, TypeError):
                break  # a line that was cut off when the process was killed
        write_atomic(log, "".join(line + "\n" for line in kept).encode())

    def _log(self, values: dict[str, Any]) -> None:
        with (self.out / "log.jsonl").open("a") as log:
            log.write(json.dumps(values) + "\n")


def _channels_last(model: SingleModel | VideoModel) -> SingleModel | VideoModel:
    """Set channels-last memory: a step of the 3D networks takes 157 ms of CPU time in bf16 and 349 in fp32; without
    it 206 and 1,570.
    """
    networks: list[torch.nn.Module] = [model.sg_encoder, model.sg_decoder]
    if isinstance(model, VideoModel):
        networks += [model.single.sg_encoder, model.single.sg_decoder, model.sg_gru0, model.sg_gru1]
    for network in networks:
        network.to(memory_format=torch.channels_last_3d)
    return model
