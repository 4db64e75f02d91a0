"""Widths and options of the networks: frozen, JSON in and out, checked on the way in. Needs no PyTorch.

Volumes are [z, y, x]; panoramas are H x 2H. Why each default is what it is stands in `model/NETWORKS.md`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, TypeVar, get_args

from roomlight.errors import ModelError

Form = Literal["single", "video"]
"""`single`: each image on its own. `video`: the recurrent networks, with the single-view ones for frame 0."""

Norm = Literal["group", "none"]
GateKernel = Literal[1, 3]

FORMS: tuple[str, ...] = get_args(Form)
_CHOICES: dict[str, tuple[object, ...]] = {"norm": get_args(Norm), "fine_gate_kernel": get_args(GateKernel)}


@dataclass(frozen=True)
class SGConfig:
    """The 3D encoder-decoder and its two GRUs. Cost grows with the square of either width."""

    volume_shape: tuple[int, int, int] = (64, 60, 84)
    """Voxels in z, y, x that graphs are exported for (the paper's); the weights themselves fit any size."""
    channels: int = 32
    """Width at half resolution; twice that at a quarter, four times at an eighth."""
    full_channels: int = 16
    """Width at full resolution, where nearly all voxels are."""
    full_layers: int = 1
    """3 x 3 x 3 convolutions at full resolution before the heads."""
    spherical_gaussians: bool = True
    """False gives the RGB-alpha volume of the paper's ablation: w = 0 and no heads for it."""
    norm: Norm = "group"
    """Group normalisation at a quarter and an eighth of the resolution, or none at all."""
    fine_gate_kernel: GateKernel = 1
    """Kernel of the gates of SGGRU_0 (half resolution); its candidate is always 3 x 3 x 3."""
    direct: bool = True
    """The heads also see the initial volume itself and begin as its copy; False is the paper's two skips alone."""
    own_colour: bool = True
    """The networks see a frame divided by its own mean colour and answer in units of it: unseen walls take the room's
    colour and brightness without having to learn it."""
    filled: bool = True
    """Where nothing was seen, `direct` heads begin with what is seen around; False: with the mean colour."""

    def __post_init__(self) -> None:
        """Refuse sizes that no network can be built for."""
        if min(self.volume_shape) < 8:
            raise ModelError(
                f"volume_shape must be 8 or more in each direction (three halvings), got {self.volume_shape}"
            )
        if self.channels < 4 or self.channels % 4:
            raise ModelError(f"channels must be a positive multiple of 4, got {self.channels}")
        if self.full_channels < 1 or self.full_layers < 1:
            raise ModelError(
                f"full_channels and full_layers must be positive, got {self.full_channels} and {self.full_layers}"
            )


@dataclass(frozen=True)
class BlendConfig:
    """The 2D encoder-decoder over panoramas and its two GRUs."""

    height: int = 120
    """Rows of the panorama that graphs are exported for; it has twice as many columns."""
    channels: int = 16
    """Width at half resolution; twice that at a quarter, four times at an eighth."""
    full_channels: int = 8
    """Width at full resolution."""
    filled: bool = True
    """Beyond the mesh, mix a fill of what was seen into the volume's rendering, and its colour; False: the volume alone
    (the paper)."""

    def __post_init__(self) -> None:
        """Refuse sizes that no network can be built for."""
        if self.height < 8 or self.height % 2:
            raise ModelError(f"the panorama's height must be even and 8 or more, got {self.height}")
        if self.channels < 1 or self.full_channels < 1:
            raise ModelError(f"widths must be positive, got {self.channels} and {self.full_channels}")


@dataclass(frozen=True)
class ModelConfig:
    """Everything needed to build the networks of either form."""

    sg: SGConfig = field(default_factory=SGConfig)
    blend: BlendConfig = field(default_factory=BlendConfig)

    def to_dict(self) -> dict[str, dict[str, object]]:
        """Plain JSON values; `from_dict` gives the same configuration back."""
        plain = asdict(self)
        plain["sg"]["volume_shape"] = list(self.sg.volume_shape)
        return plain

    @staticmethod
    def from_dict(values: object) -> "ModelConfig":
        """Read what `to_dict` wrote; missing fields take defaults, unknown or misfit ones are refused."""
        parts = _mapping(values, "the configuration")
        unknown = set(parts) - {"sg", "blend"}
        if unknown:
            raise ModelError(
                f"the configuration has unknown parts {sorted(unknown)}; it was written by another version"
            )
        return ModelConfig(
            sg=_read(SGConfig, parts.get("sg", {}), "sg"),
            blend=_read(BlendConfig, parts.get("blend", {}), "blend"),
        )


_Part = TypeVar("_Part", SGConfig, BlendConfig)


def _mapping(values: object, name: str) -> Mapping[str, object]:
    if not isinstance(values, Mapping) or not all(isinstance(key, str) for key in values):
        raise ModelError(f"{name} must be a mapping of names to values, got {type(values).__name__}")
    return values


def _read(part: type[_Part], values: object, name: str) -> _Part:
    given: dict[str, Any] = dict(_mapping(values, f"the configuration's {name!r}"))
    defaults = part()
    unknown = set(given) - {entry.name for entry in fields(part)}
    if unknown:
        raise ModelError(f"the configuration's {name!r} has unknown fields {sorted(unknown)}, of another version")
    for key, value in given.items():
        wanted = getattr(defaults, key)
        if isinstance(wanted, tuple):
            if not isinstance(value, list | tuple) or [type(size) for size in value] != [int] * len(wanted):
                raise ModelError(f"the configuration's {name}.{key} must be {len(wanted)} integers, got {value!r}")
            given[key] = tuple(value)
        elif type(value) is not type(wanted):  # bool is an int to isinstance
            raise ModelError(f"the configuration's {name}.{key} must be {type(wanted).__name__}, got {value!r}")
        elif key in _CHOICES and value not in _CHOICES[key]:
            raise ModelError(f"the configuration's {name}.{key} must be one of {_CHOICES[key]}, got {value!r}")
    return part(**given)
