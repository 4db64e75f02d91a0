"""The model that a stage starts with: fresh, or from the weights of an earlier stage."""

from dataclasses import replace

import torch

from roomlight.errors import ModelError
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.networks import SingleModel, VideoModel, build
from roomlight_model.training.options import TrainOptions, is_video


def starting_options(options: TrainOptions, start_from: Checkpoint | None) -> TrainOptions:
    """Return the options with the network widths of `start_from`.

    Raises:
        ModelError: A single-view stage would start from a video model.
    """
    if start_from is None:
        return options
    if isinstance(start_from.model, VideoModel) and not is_video(options.stage):
        raise ModelError(f"stage {options.stage} trains a single-view model, not a {start_from.form} one")
    return replace(options, model=start_from.config)


def starting_model(
    options: TrainOptions, start_from: Checkpoint | None, *, resumes: bool = False
) -> SingleModel | VideoModel:
    """Build the model of `starting_options`; the video stages begin with single-view weights (`warm_start`).

    `resumes`: the run's own weights will replace these.

    Raises:
        ModelError: A video stage has no weights to start from.
    """
    video = is_video(options.stage)
    if video and start_from is None and not resumes:
        raise ModelError(
            f"stage {options.stage} starts from trained weights: give `start_from` a single-view checkpoint or model "
            "folder, or the checkpoint of the video stage before"
        )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(options.seed)
        model = build("video" if video else "single", options.model)
    if start_from is None:
        return model
    if isinstance(model, VideoModel) and isinstance(start_from.model, SingleModel):
        model.single.load_state_dict(start_from.model.state_dict())
        model.warm_start()
    else:
        model.load_state_dict(start_from.model.state_dict())
    return model
