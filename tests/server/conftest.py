"""Tiny networks, exported once: untrained weights of both forms for volumes of 16 x 15 x 21 voxels."""

import pytest

from roomlight_export.exporting import export_checkpoint
from roomlight_model.checkpoint import save_untrained
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig

VOLUME_SHAPE = (16, 15, 21)
PANORAMA_HEIGHT = 32


@pytest.fixture(scope="session")
def tiny_video(tmp_path_factory):
    """(checkpoint, model folder) of the video form, which holds the single-view graphs too."""
    folder = tmp_path_factory.mktemp("tiny")
    config = ModelConfig(
        sg=SGConfig(volume_shape=VOLUME_SHAPE, channels=4, full_channels=4),
        blend=BlendConfig(height=PANORAMA_HEIGHT, channels=4, full_channels=4),
    )
    save_untrained(folder / "video.pt", "video", config, seed=3)
    export_checkpoint(folder / "video.pt", folder / "video", ort=False)
    return folder / "video.pt", folder / "video"
