"""What a training run is told: frozen, written beside its results, read back when it resumes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

from roomlight.errors import ModelError
from roomlight_model.config import ModelConfig

Stage = Literal["single-sglv", "single-blend", "single-joint"]
STAGES: Final[tuple[str, ...]] = get_args(Stage)
DepthKind = Literal["exact", "arkit", "both"]
OPTIONS: Final = "options.json"
"""Where a run's folder says what was asked."""
HELD_OUT: Final = 48
"""Sequences kept from training, at most a quarter of the first folder: 12 rooms of four walks, 24 of two."""


@dataclass(frozen=True)
class TrainOptions:
    """One stage of one model. Lengths of a run are steps: hours depend on the machine, results must not.

    volume_shape is the resolution trained at ([z, y, x]; half of the paper's costs an eighth), and the one that the
    checkpoint is exported for: opacity is that of a voxel, so weights of one resolution are wrong at another until they
    are trained there. rays are drawn at random from each probe's panorama in the first stage; `sphere_pixels` x
    `sphere_samples` more are the rendering layer's. panorama_height is that of the blending stages, and of the exported
    blending graphs. surround_max: trained on are sequences that are at most so many times as bright all around as in
    their first frame (`training.subsets.surround`; 0: on all). frames: up to so many of a walk are shown
    together, as a stream shows them: the volume is their mean (`engine.fusion`), panoramas accumulate. held_out: how
    many of the first folder's sequences are kept from training; what was kept when a run began is kept when it goes on.
    """

    stage: Stage = "single-sglv"
    steps: int = 20_000
    batch: int = 4
    learning_rate: float = 1e-3
    warm_up: int = 200
    weight_decay: float = 1e-2
    rendering_weight: float = 0.3
    ema: float = 0.999
    rays: int = 384
    sphere_pixels: int = 24
    sphere_samples: int = 12
    volume_shape: tuple[int, int, int] = (32, 30, 42)
    panorama_height: int = 60
    depth: DepthKind = "both"
    frames: int = 1
    augment: bool = True
    surround_max: float = 0.0
    held_out: int = HELD_OUT
    bf16: bool = True
    seed: int = 0
    model: ModelConfig = field(default_factory=ModelConfig)

    def __post_init__(self) -> None:
        """ModelError for a value that no run can use; it names the option."""
        if self.stage not in STAGES:
            raise ModelError(f"stage is {self.stage!r}; it is one of {', '.join(STAGES)}")
        for name, least in (
            ("steps", 1),
            ("batch", 1),
            ("rays", 8),
            ("frames", 1),
            ("held_out", 0),
            ("sphere_pixels", 0),
            ("sphere_samples", 2),
        ):
            if getattr(self, name) < least:
                raise ModelError(f"{name} is {getattr(self, name)}; it is {least} or more")
        for name, low, high in (
            ("learning_rate", 0, 1),
            ("ema", 0, 1),
            ("rendering_weight", 0, 100),
            ("surround_max", 0, 100),
        ):
            value = getattr(self, name)
            if not low <= value <= high or (name == "learning_rate" and value == 0):
                raise ModelError(f"{name} is {value}; it lies between {low} and {high}")
        if min(self.volume_shape) < 8:
            raise ModelError(f"volume_shape is {self.volume_shape}; every side is 8 or more")
        if self.panorama_height < 8 or self.panorama_height % 2:
            raise ModelError(f"panorama_height is {self.panorama_height}; it is even and 8 or more")

    @property
    def trained_model(self) -> ModelConfig:
        """The networks with the sizes they are trained at: what checkpoints say and graphs are exported for."""
        sg = replace(self.model.sg, volume_shape=self.volume_shape)
        return replace(self.model, sg=sg, blend=replace(self.model.blend, height=self.panorama_height))

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        plain = asdict(self)
        plain["model"] = self.model.to_dict()
        plain["volume_shape"] = list(self.volume_shape)
        return plain

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "TrainOptions":
        """Read what `to_dict` wrote; ModelError for what another version wrote."""
        unknown = set(values) - {entry.name for entry in fields(TrainOptions)}
        if unknown:
            raise ModelError(f"the run's options hold {sorted(unknown)}, which this version does not know")
        given = dict(values)
        given["model"] = ModelConfig.from_dict(given.get("model", {}))
        if "volume_shape" in given:
            given["volume_shape"] = tuple(given["volume_shape"])
        return TrainOptions(**given)

    @staticmethod
    def read(path: Path) -> "TrainOptions":
        """The options of a run's folder; ModelError names the file."""
        try:
            values = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise ModelError(f"{path}: not the options of a training run ({error})") from error
        if not isinstance(values, dict):
            raise ModelError(f"{path}: not the options of a training run")
        return TrainOptions.from_dict(values)
