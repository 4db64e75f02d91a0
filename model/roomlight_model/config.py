"""Widths and options of the networks: frozen dataclasses, read from JSON with checks. Needs no PyTorch.

Volumes are [z, y, x]; panoramas are H x 2H. `docs/networks.md` gives the reasons for the defaults.
"""

import json
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from pydantic import ConfigDict, TypeAdapter, ValidationError

from roomlight.errors import ModelError

_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True)
class SGConfig:
    """The 3D encoder-decoder and its two GRUs. Cost grows with the square of either width."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    volume_shape: tuple[int, int, int] = (64, 60, 84)
    """Voxels in z, y, x that graphs are exported for (the paper's); the weights themselves fit any size."""
    channels: int = 32
    """Width at half resolution; twice that at a quarter, four times at an eighth."""
    full_channels: int = 16
    """Width at full resolution, which has nearly all voxels."""

    def __post_init__(self) -> None:
        if min(self.volume_shape) < 8:
            raise ModelError(
                f"volume_shape must be 8 or more in each direction (three halvings), got {self.volume_shape}"
            )
        if self.channels < 4 or self.channels % 4:
            raise ModelError(f"channels must be a positive multiple of 4, got {self.channels}")
        if self.full_channels < 1:
            raise ModelError(f"full_channels must be positive, got {self.full_channels}")


@dataclass(frozen=True)
class BlendConfig:
    """The 2D encoder-decoder over panoramas and its two GRUs."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    height: int = 120
    """Rows of the panorama that graphs are exported for; it has twice as many columns."""
    channels: int = 16
    """Width at half resolution; twice that at a quarter, four times at an eighth."""
    full_channels: int = 8
    """Width at full resolution."""

    def __post_init__(self) -> None:
        if self.height < 8 or self.height % 2:
            raise ModelError(f"the panorama's height must be even and 8 or more, got {self.height}")
        if self.channels < 1 or self.full_channels < 1:
            raise ModelError(f"widths must be positive, got {self.channels} and {self.full_channels}")


@dataclass(frozen=True)
class ModelConfig:
    """Everything needed to build the networks of either form."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    sg: SGConfig = field(default_factory=SGConfig)
    blend: BlendConfig = field(default_factory=BlendConfig)

    def to_dict(self) -> dict[str, dict[str, object]]:
        """Return plain JSON values, which `from_dict` reads."""
        return _ADAPTER.dump_python(self, mode="json")

    @staticmethod
    def from_dict(values: object) -> "ModelConfig":
        """Read the result of `to_dict`; missing fields take their defaults.

        Older weights have further fields, which were options once: each must have the value of `_SETTLED`.

        Raises:
            ModelError: A field is unknown, of the wrong type or out of range; the message names it.
        """
        try:
            return _ADAPTER.validate_json(json.dumps(_without_settled(values)), strict=True)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "it"
            raise ModelError(
                f"the configuration does not fit this version: {where}: {first['msg']}, got {first['input']!r}"
            ) from error
        except (TypeError, ValueError) as error:
            raise ModelError(f"the configuration does not fit this version: it is not JSON ({error})") from error


def _without_settled(values: Any) -> object:
    """Drop the fields of older weights that have the value of `_SETTLED`; any other value stays and is refused."""
    if not isinstance(values, dict):
        return values
    return {
        part: {key: value for key, value in fields.items() if value != _SETTLED.get(part, {}).get(key, _UNKNOWN)}
        if isinstance(fields, dict)
        else fields
        for part, fields in values.items()
    }


_ADAPTER: Final = TypeAdapter(ModelConfig)
_UNKNOWN: Final = object()
_SETTLED: Final[dict[str, dict[str, object]]] = {
    "sg": {
        "units": "first",
        "full_layers": 1,
        "spherical_gaussians": True,
        "norm": "group",
        "fine_gate_kernel": 1,
        "direct": True,
        "own_colour": True,
        "filled": True,
    },
    "blend": {"filled": True},
}
"""Fields of older weights: what was an option, and the value that all shipped weights have."""
