"""A video model that is small enough for tests to run; its graphs are committed, because to export them takes long.

Its volumes have 16 x 15 x 21 voxels, its panoramas 32 rows; it holds the single-view graphs too. After a change of the
networks or their export: `python tests/tiny_networks.py`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from roomlight_model.networks import VideoModel

FOLDER: Final = Path(__file__).parent / "networks" / "tiny-video"
_CARD: Final[dict[str, object]] = {"steps": 1, "seed": 3}


def tiny_network() -> "VideoModel":
    """Return the model in PyTorch, before its weights are rounded to half precision."""
    import torch

    from roomlight_model.checkpoint import build_network
    from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
    from roomlight_model.networks import VideoModel

    sg = SGConfig(volume_shape=(16, 15, 21), channels=4, full_channels=4)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        model = build_network("video", ModelConfig(sg=sg, blend=BlendConfig(height=32, channels=4, full_channels=4)))
    assert isinstance(model, VideoModel)
    return model.eval()


def _export() -> None:
    from roomlight_export.exporting import export_checkpoint
    from roomlight_model.checkpoint import save_checkpoint

    with TemporaryDirectory() as folder:
        save_checkpoint(Path(folder) / "video.pt", tiny_network(), card=_CARD)
        export_checkpoint(Path(folder) / "video.pt", FOLDER, ort=False, progress=print)


if __name__ == "__main__":
    _export()
