"""Gradients of a batch's loss. On CPUs, the examples of a batch are distributed over threads.

oneDNN's 3D convolutions have too little work at the coarse levels to share between threads, which then wait for each
other; two halves of a batch on a thread each do not.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.training.batches import Batch
from roomlight_model.training.options import STAGES, TrainOptions
from roomlight_model.training.sequences import WalkBatch
from roomlight_model.training.stages import Losses, predict, stage_losses
from roomlight_model.training.step_clock import StepClock
from roomlight_model.training.unroll import Unroll

_PIECE_SIZE: Final = 2
"""Examples in one forward pass on a CPU; fixed, so that a run's results do not depend on the number of cores. Sequences
have a pass each: their frames are work enough."""


class _Piece(NamedTuple):
    losses: Losses
    gradients: Sequence[Tensor | None]
    share: float
    """Share of the batch's examples."""


class BatchGradients:
    """Computes a batch's losses and writes their gradients to the parameters' `grad`. Set `clock` to time the parts."""

    def __init__(
        self,
        model: SingleModel | VideoModel,
        parameters: Sequence[nn.Parameter],
        options: TrainOptions,
        *,
        device: torch.device,
    ) -> None:
        """Prepare the threads; `parameters` are the ones that the stage trains."""
        self.clock: StepClock | None = None
        self._model, self._parameters, self._options, self._device = model, tuple(parameters), options, device
        size = _PIECE_SIZE if isinstance(model, SingleModel) else 1
        pieces = -(-options.batch // size) if device.type == "cpu" else 1
        threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(
            min(pieces, threads),
            thread_name_prefix="gradients",
            initializer=torch.set_num_threads,  # applies to the calling thread
            initargs=(max(1, threads // pieces),),
        )
        self._piece_size = size if pieces > 1 else options.batch

    def of(self, batch: Batch | WalkBatch, step: int) -> Losses:
        """Compute gradients and return the mean losses, detached; random directions follow from (seed, step)."""
        pieces = batch.pieces(self._piece_size)
        if len(pieces) == 1:
            done = [self._piece(batch, step, 0, 1.0)]
        else:
            shares = [len(piece.origins) / len(batch.origins) for piece in pieces]
            done = list(self._pool.map(self._piece, pieces, [step] * len(pieces), range(len(pieces)), shares))
        with torch.no_grad():
            for index, parameter in enumerate(self._parameters):
                _accumulate(parameter, [(piece.gradients[index], piece.share) for piece in done])
            means = [
                torch.stack([losses[k] * share for losses, _, share in done]).sum() for k in range(len(Losses._fields))
            ]
            return Losses(*means)

    def _piece(self, batch: Batch | WalkBatch, step: int, number: int, share: float) -> _Piece:
        options, device = self._options, self._device
        seed = np.random.SeedSequence([options.seed, STAGES.index(options.stage), step, number])
        generator = torch.Generator().manual_seed(int(seed.generate_state(1)[0]))
        here = batch.to(device)
        if isinstance(here, WalkBatch) or isinstance(self._model, VideoModel):
            assert isinstance(here, WalkBatch)
            assert isinstance(self._model, VideoModel)
            spent = None if self.clock is None else StepClock()
            unroll = Unroll(self._model, here, options, generator=generator, device=device, clock=spent)
            losses, found = unroll.gradients(self._parameters)
            if self.clock is not None and spent is not None:
                self.clock.add_sums(spent)
            return _Piece(losses, found, share)
        with self._part("forward"):
            sglv = predict(self._model, here, options, device=device)
        with self._part("render"):
            losses = stage_losses(self._model, sglv, here, options, generator=generator, device=device)
        with self._part("backward"):
            gradients = torch.autograd.grad(losses.total, self._parameters, allow_unused=True)
        return _Piece(Losses(*(loss.detach() for loss in losses)), gradients, share)

    def _part(self, name: str) -> AbstractContextManager[None]:
        return nullcontext() if self.clock is None else self.clock.part(name)


def _accumulate(parameter: nn.Parameter, pieces: Sequence[tuple[Tensor | None, float]]) -> None:
    """Set grad = sum of share x gradient, with the parameter's strides: the fused optimiser needs the same strides."""
    known = [(gradient, share) for gradient, share in pieces if gradient is not None]
    if not known:
        parameter.grad = None
        return
    if parameter.grad is None:
        parameter.grad = torch.empty_like(parameter)
    first, share = known[0]
    parameter.grad.copy_(first).mul_(share)
    for gradient, share in known[1:]:
        parameter.grad.add_(gradient, alpha=share)
