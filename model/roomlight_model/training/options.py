"""Options of a training run: frozen, stored with its results, read again when the run resumes."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from roomlight.errors import ModelError, OptionError
from roomlight_model.config import ModelConfig

TrainingStage = Literal["single-sglv", "single-blend", "single-joint", "video-sglv", "video-blend", "video-joint"]
STAGES: Final[tuple[str, ...]] = get_args(TrainingStage)
DepthKind = Literal["exact", "arkit", "both"]
OPTIONS: Final = "options.json"
"""File with the options, in a run's folder."""
HELD_OUT: Final = 48
"""Default number of held-out sequences, at most a quarter of the first folder: 12 rooms of four walks, 24 of two."""


def is_video(stage: str) -> bool:
    """Return whether a stage trains the recurrent networks."""
    return stage.startswith("video-")


@dataclass(frozen=True)
class TrainOptions:
    """Options of one stage of one model. A run's length is in steps: hours depend on the machine, results must not.

    Attributes:
        stage: Stage of training; see `training.stages`.
        steps: Optimiser steps.
        batch: Examples in a batch.
        learning_rate: Largest learning rate, after the warm-up.
        warm_up: Steps of the linear warm-up.
        weight_decay: AdamW's weight decay.
        rendering_weight: Weight of the rendering loss.
        ema: Decay of the averaged weights.
        rays: Rays drawn at random from each probe's panorama in the first stage.
        sphere_pixels: Pixels of the rendering layer's sphere.
        sphere_samples: Directions of each of its pixels.
        volume_shape: Resolution [z, y, x] of training (half of the paper's costs an eighth) and of the exported
            graphs. Opacity is per voxel, so that weights need training at the resolution they are used at.
        panorama_height: Rows of the panoramas in the blending stages and of the exported blending graphs.
        depth: Exact depth, simulated phone depth, or both.
        frames: Largest number of frames of a walk in an example. Single-view stages: the volume is their mean
            (`engine.fusion`), panoramas accumulate. Video stages: the sequence's length, 2 or more.
        window: Video stages: frames over which gradients go back in time (truncated back-propagation). It bounds the
            memory of a step (`training.unroll.window_mb`).
        variants: `video-blend`: draw so many sequences from each walk and keep what the fixed 3D networks make of them
            in the run's folder (`training.walk_cache`); 0 draws new ones at every step.
        smoothness_weight: Video stages: weight of the difference between the panoramas of consecutive frames.
        augment: Whether to draw frames at random and augment them.
        light_changes: Video stages: share of sequences whose light changes at a frame (`training.light_changes`).
        second_looks: Video stages: share of sequences that stop at a frame or return the way they came, so that the
            networks see the same places again.
        surround_max: Train only on sequences whose surroundings are at most this many times as bright as their
            first frame (`training.subsets.surround`); 0 trains on all.
        relative: Single-view blending and joint stages: divide each example's error by that of the fill of its
            observed light, and count what exceeds it twice (`training.stages.relative_errors`).
        held_out: Sequences of the first folder that are kept from training; a resumed run keeps the same ones.
        bf16: Whether the networks compute in bfloat16.
        seed: Seed of all random choices.
        model: Widths of the networks.

    Raises:
        OptionError: A value is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    stage: TrainingStage = "single-sglv"
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
    window: int = 31
    variants: int = 0
    smoothness_weight: float = 0.01
    augment: bool = True
    light_changes: float = 0.0
    second_looks: float = 0.0
    surround_max: float = 0.0
    relative: bool = False
    held_out: int = HELD_OUT
    bf16: bool = True
    seed: int = 0
    model: ModelConfig = field(default_factory=ModelConfig)

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise OptionError(f"stage is {self.stage!r}; it must be one of {', '.join(STAGES)}")
        for name, least in (
            ("steps", 1),
            ("batch", 1),
            ("rays", 8),
            ("frames", 2 if is_video(self.stage) else 1),
            ("window", 1),
            ("variants", 0),
            ("held_out", 0),
            ("sphere_pixels", 0),
            ("sphere_samples", 2),
        ):
            if getattr(self, name) < least:
                raise OptionError(f"{name} is {getattr(self, name)}; it must be {least} or more in {self.stage}")
        for name, low, high in (
            ("learning_rate", 0, 1),
            ("ema", 0, 1),
            ("rendering_weight", 0, 100),
            ("smoothness_weight", 0, 100),
            ("light_changes", 0, 1),
            ("second_looks", 0, 1),
            ("surround_max", 0, 100),
        ):
            value = getattr(self, name)
            if not low <= value <= high or (name == "learning_rate" and value == 0):
                raise OptionError(f"{name} is {value}; it must be between {low} and {high}")
        if (self.light_changes or self.second_looks) and not is_video(self.stage):
            raise OptionError(f"light_changes and second_looks need a video stage, not {self.stage}")
        if self.relative and self.stage not in ("single-blend", "single-joint"):
            raise OptionError(f"relative needs the stage single-blend or single-joint, not {self.stage}")
        if self.variants and self.stage != "video-blend":
            raise OptionError(f"variants is {self.variants}; only video-blend has fixed 3D networks, it must be 0")
        if min(self.volume_shape) < 8:
            raise OptionError(f"volume_shape is {self.volume_shape}; every side must be 8 or more")
        if self.panorama_height < 8 or self.panorama_height % 2:
            raise OptionError(f"panorama_height is {self.panorama_height}; it must be even and 8 or more")

    @property
    def trained_model(self) -> ModelConfig:
        """The networks' configuration at the sizes of training, for checkpoints and exported graphs."""
        sg = replace(self.model.sg, volume_shape=self.volume_shape)
        return replace(self.model, sg=sg, blend=replace(self.model.blend, height=self.panorama_height))

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return _ADAPTER.dump_python(self, mode="json")

    @staticmethod
    def read(path: Path) -> "TrainOptions":
        """Read the options of a run's folder.

        Raises:
            ModelError: The file is unreadable, or not the options of a run of this version; the message names it.
        """
        try:
            return _ADAPTER.validate_json(path.read_bytes(), strict=True)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise ModelError(
                f"{path}: not the options of a training run of this version: {where}: {first['msg']}"
            ) from error
        except (OSError, OptionError) as error:
            raise ModelError(f"{path}: not the options of a training run ({error})") from error


_ADAPTER: Final = TypeAdapter(TrainOptions)
