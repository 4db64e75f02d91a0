"""Checkpoint files of the small networks that serve every model: {"format": 1, "form", "state", "card"}."""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final, get_args
from zipfile import is_zipfile

import torch
from torch import nn

from roomlight.engine.networks.graphs import PartForm
from roomlight.errors import ModelError
from roomlight.files import write_atomic
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.completion_network import CompletionNetwork, ObjectLightNetwork

FORMAT: Final = 1
_NETWORKS: Final[Mapping[PartForm, type[nn.Module]]] = {
    "clipping": ClippingNetwork,
    "completion": CompletionNetwork,
    "objects": ObjectLightNetwork,
}


@dataclass(frozen=True)
class PartCheckpoint:
    """A loaded checkpoint; the network is in evaluation mode."""

    form: PartForm
    network: nn.Module
    card: dict[str, Any]


def build_part(form: PartForm) -> nn.Module:
    """Build the network of a form, freshly initialised."""
    return _NETWORKS[form]()


def save_part_checkpoint(path: Path, form: PartForm, network: nn.Module, *, card: Mapping[str, Any]) -> None:
    """Write a checkpoint, atomically.

    Raises:
        OutputError: The file cannot be written.
    """
    buffer = BytesIO()
    state = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    torch.save({"format": FORMAT, "form": form, "state": state, "card": dict(card)}, buffer)
    write_atomic(path, buffer.getvalue())


def is_part_checkpoint(path: Path) -> bool:
    """Return whether a file is the checkpoint of such a network."""
    try:
        raw = torch.load(path, weights_only=True, map_location="cpu") if is_zipfile(path) else None
    except Exception:  # the unpickler raises any type for damaged bytes
        return False
    return isinstance(raw, dict) and raw.get("form") in get_args(PartForm)


def load_part_checkpoint(path: Path) -> PartCheckpoint:
    """Read a checkpoint without running code from it.

    Raises:
        ModelError: The file is not such a checkpoint, or its weights do not fit or are not finite.
    """
    try:
        raw = torch.load(path, weights_only=True, map_location="cpu")
        form, state, card = raw["form"], raw["state"], raw["card"]
        if raw["format"] != FORMAT or form not in get_args(PartForm):
            raise ModelError(f"{path}: format {raw['format']!r} and form {form!r} are not of this version")
        network = build_part(form)
        network.load_state_dict(state)
    except ModelError:
        raise
    except Exception as error:  # the unpickler raises any type for damaged bytes
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        forms = ", ".join(get_args(PartForm))
        raise ModelError(f"{path}: not the checkpoint of a network of the form {forms} ({reason})") from error
    if not all(torch.isfinite(value).all() for value in state.values()):
        raise ModelError(f"{path}: the weights hold NaN or infinity; the training diverged")
    return PartCheckpoint(form, network.eval(), card)
