"""Widths and options of the networks: frozen dataclasses, read from JSON with checks. Needs no PyTorch.

Volumes are [z, y, x]; panoramas are H x 2H. `docs/networks.md` gives the reasons for the defaults.
"""

import json
from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from roomlight.errors import ModelError

NetworkForm = Literal["single", "video"]
"""`single`: each image on its own. `video`: the recurrent networks, with the single-view ones for frame 0."""

Norm = Literal["group", "none"]
GateKernel = Literal[1, 3]

FORMS: tuple[str, ...] = get_args(NetworkForm)
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
    full_layers: int = 1
    """3 x 3 x 3 convolutions at full resolution before the heads."""
    spherical_gaussians: bool = True
    """False gives the RGB-alpha volume of the paper's ablation: w = 0 and no heads for it."""
    norm: Norm = "group"
    """Group normalisation at a quarter and an eighth of the resolution, or none."""
    fine_gate_kernel: GateKernel = 1
    """Kernel of the gates of SGGRU_0 (half resolution); its candidate is always 3 x 3 x 3."""
    direct: bool = True
    """The heads also receive the initial volume and start as its copy; False: only the paper's two skips."""
    own_colour: bool = True
    """Divide a frame by its mean colour and predict in units of it, so that unseen walls take the room's colour and
    brightness without learning it. The recurrent networks take the first frame's mean colour for all frames."""
    filled: bool = True
    """Where nothing was seen, `direct` heads start from the surroundings; False: from the mean colour."""

    def __post_init__(self) -> None:
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

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    height: int = 120
    """Rows of the panorama that graphs are exported for; it has twice as many columns."""
    channels: int = 16
    """Width at half resolution; twice that at a quarter, four times at an eighth."""
    full_channels: int = 8
    """Width at full resolution."""
    filled: bool = True
    """Outside the mesh, mix a fill from the seen pixels into the volume's rendering; False: only the volume (the
    paper)."""

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

        `sg.units` of older weights must be "first", the only units that are left.

        Raises:
            ModelError: A field is unknown, of the wrong type or out of range; the message names it.
        """
        try:
            return _ADAPTER.validate_json(json.dumps(_without_units(values)), strict=True)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "it"
            raise ModelError(
                f"the configuration does not fit this version: {where}: {first['msg']}, got {first['input']!r}"
            ) from error
        except (TypeError, ValueError) as error:
            raise ModelError(f"the configuration does not fit this version: it is not JSON ({error})") from error


def _without_units(values: object) -> object:
    """Drop the field `sg.units` of older weights where it says "first"; any other value stays and is refused."""
    match values:
        case {"sg": {"units": "first", **sg}, **others}:
            return {**others, "sg": sg}
        case _:
            return values


_ADAPTER: Final = TypeAdapter(ModelConfig)
