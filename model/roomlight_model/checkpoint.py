"""Checkpoint files of all networks: weights, their configuration and the record of their training.

A file is one `torch.save` of {"format": 2, "form", "config", "state", "card"}. The card is the training's record in
plain JSON values (steps, seed, data, scores); a card with steps = 0 says that the weights are untrained.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from roomlight.errors import ModelError, OutputError
from roomlight.files import write_atomic
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.config import ModelConfig
from roomlight_model.depth.network import DepthNetwork
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.object_light_network import ObjectLightNetwork

Network = SingleModel | VideoModel | ClippingNetwork | ObjectLightNetwork | DepthNetwork
FORMAT: Final = 2
_NETWORKS: Final[Mapping[str, Callable[[ModelConfig], Network]]] = {
    "single": SingleModel,
    "video": VideoModel,
    "clipping": lambda _: ClippingNetwork(),
    "objects": lambda _: ObjectLightNetwork(),
    "depth": lambda _: DepthNetwork(),
}
FORMS: Final = tuple(_NETWORKS)
"""Forms of a network: the whole models for one view and for video, and the small networks that serve both."""


@dataclass(frozen=True)
class Checkpoint:
    """A loaded checkpoint.

    Attributes:
        form: One of `FORMS`.
        config: The widths of a `single` or `video` model; the small networks have fixed widths and ignore it.
        model: The network, on the CPU, in evaluation mode.
    """

    form: str
    config: ModelConfig
    model: Network
    card: dict[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of the weights."""
        digest = hashlib.sha256()
        for name, value in self.model.state_dict().items():
            digest.update(name.encode() + value.contiguous().numpy().tobytes())
        return digest.hexdigest()


def build_network(form: str, config: ModelConfig) -> Network:
    """Build the network of a form, freshly initialised.

    Raises:
        ModelError: The form is unknown.
    """
    if form not in _NETWORKS:
        raise ModelError(f"the form is {form!r}; it must be one of {', '.join(FORMS)}")
    return _NETWORKS[form](config)


def save_checkpoint(path: Path, model: Network, *, card: Mapping[str, Any]) -> None:
    """Write a checkpoint, atomically.

    Raises:
        OutputError: The file cannot be written.
        ModelError: The card holds values that are not JSON.
    """
    try:
        json.dumps(dict(card))
    except (TypeError, ValueError) as error:
        raise ModelError(f"the training card must hold JSON values only ({error})") from error
    buffer = BytesIO()
    torch.save(
        {
            "format": FORMAT,
            "form": model.form,
            "config": model.config.to_dict() if isinstance(model, SingleModel | VideoModel) else {},
            "state": {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()},
            "card": dict(card),
        },
        buffer,
    )
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give the name of a checkpoint file")
    write_atomic(path, buffer.getvalue())


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without running code from it.

    Raises:
        ModelError: The file is not a checkpoint, is damaged, or does not fit; the message names file and fault.
    """
    raw = _read(path)
    if isinstance(raw, dict) and "optimizer" in raw:
        raise ModelError(f"{path}: is what a training run resumes from; its weights are model.pt and best.pt beside it")
    if not isinstance(raw, dict) or raw.get("format") is None:
        raise ModelError(f"{path}: not a RoomLight checkpoint (it has no 'format')")
    if raw["format"] != FORMAT:
        raise ModelError(
            f"{path}: checkpoint format {raw['format']!r}; this version reads format {FORMAT}. Train again, or start "
            "from a model folder that was exported from it"
        )
    missing = [key for key in ("form", "config", "state", "card") if key not in raw]
    if missing:
        raise ModelError(f"{path}: the checkpoint lacks {', '.join(missing)}; it is incomplete")
    form, card, state = raw["form"], raw["card"], raw["state"]
    if not isinstance(card, dict) or not isinstance(state, dict):
        raise ModelError(f"{path}: the checkpoint's card and state must be mappings")
    try:
        config = ModelConfig.from_dict(raw["config"])
        model = build_network(form, config)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    _check_state(path, state, model.state_dict())
    model.load_state_dict(state)
    return Checkpoint(form, config, model.eval(), card)


def _read(path: Path) -> object:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not zipfile.is_zipfile(BytesIO(data)):
        raise ModelError(
            f"{path}: not a PyTorch checkpoint, or a truncated one; give another, or delete its run's folder to train "
            "it again"
        )
    try:
        return torch.load(BytesIO(data), weights_only=True, map_location="cpu")
    except Exception as error:  # the unpickler raises any type for damaged bytes
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise ModelError(f"{path}: does not load as a checkpoint of plain tensors ({reason})") from error


def _check_state(path: Path, given: Mapping[object, object], wanted: Mapping[str, Tensor]) -> None:
    """Raise ModelError with the first misfit in one line; PyTorch's own message lists every tensor."""
    missing, extra = sorted(set(wanted) - set(given)), sorted(str(name) for name in set(given) - set(wanted))
    if missing or extra:
        raise ModelError(
            f"{path}: the weights do not fit the configuration: {len(missing)} missing ({missing[:1]}), "
            f"{len(extra)} unknown ({extra[:1]})"
        )
    for name, tensor in wanted.items():
        value = given[name]
        if not isinstance(value, Tensor) or value.shape != tensor.shape or not value.is_floating_point():
            shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise ModelError(f"{path}: weight {name} is {shape}, the configuration asks for {tuple(tensor.shape)}")
        if not torch.isfinite(value).all():
            raise ModelError(f"{path}: weight {name} holds NaN or infinity; the training diverged")
