"""Gradients of a batch's loss.

On CPUs the pieces of a batch run on threads of their own. oneDNN's 3D convolutions have too little work at the coarse
levels to share between threads, which then wait for each other; two halves of a batch on a thread each do not.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from roomlight_model.training.batches import Tensors
from roomlight_model.training.losses import Losses
from roomlight_model.training.run_folder import RunOptions

LossFunction = Callable[[Any, torch.Generator], Losses]
"""A stage's losses of some examples (`loop.Stage.losses`)."""


class _Piece(NamedTuple):
    losses: dict[str, float]
    gradients: Sequence[Tensor | None]
    share: float
    """Share of the batch's examples."""


class BatchGradients:
    """Computes a batch's losses and writes their gradients to the parameters' `grad`."""

    def __init__(
        self,
        losses: LossFunction,
        parameters: Sequence[nn.Parameter],
        options: RunOptions,
        *,
        device: torch.device,
        piece_size: int,
    ) -> None:
        """Prepare the threads.

        Args:
            losses: The stage's losses.
            parameters: Those that the stage trains.
            options: The batch's size and the seed of random directions.
            device: Where the networks run; only a CPU's batches are split.
            piece_size: Examples in one forward pass on a CPU; fixed, so that results do not depend on the cores.
        """
        self._losses, self._parameters, self._options, self._device = losses, tuple(parameters), options, device
        pieces = -(-options.batch // piece_size) if device.type == "cpu" else 1
        threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(
            min(pieces, threads),
            thread_name_prefix="gradients",
            initializer=torch.set_num_threads,  # applies to the calling thread
            initargs=(max(1, threads // pieces),),
        )
        self._piece_size = piece_size if pieces > 1 else options.batch

    def of(self, batch: Tensors, step: int) -> dict[str, float]:
        """Compute gradients and return the mean losses; random directions follow from (seed, step)."""
        pieces = batch.pieces(self._piece_size)

        def compute(number: int) -> _Piece:
            return self._piece(pieces[number], (step, number), len(pieces[number]) / len(batch))

        done = [compute(0)] if len(pieces) == 1 else list(self._pool.map(compute, range(len(pieces))))
        with torch.no_grad():
            for index, parameter in enumerate(self._parameters):
                _accumulate(parameter, [(piece.gradients[index], piece.share) for piece in done])
        return {name: sum(piece.losses[name] * piece.share for piece in done) for name in done[0].losses}

    def _piece(self, batch: Tensors, keys: tuple[int, int], share: float) -> _Piece:
        generator = torch.Generator().manual_seed(int(self._options.rng(*keys).integers(2**31)))
        losses = self._losses(batch.to(self._device), generator)
        gradients = torch.autograd.grad(losses["loss"], self._parameters, allow_unused=True)
        return _Piece({name: float(value.detach()) for name, value in losses.items()}, gradients, share)


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
