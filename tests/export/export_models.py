"""The networks that the export's tests share."""

import torch

from roomlight_model.checkpoint import Network, build_network
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig

SHAPE = (17, 14, 23)  # no side is divisible by 2 three times
CONFIG = ModelConfig(
    SGConfig(volume_shape=SHAPE, channels=8, full_channels=4), BlendConfig(height=18, channels=4, full_channels=4)
)
CARD: dict[str, object] = {"steps": 3, "date": "2026-01-02"}


def distinct_network(form: str) -> Network:
    """A network in which every weight differs from every other, as in trained ones: heads and biases begin at zero."""
    torch.manual_seed(4)
    network = build_network(form, CONFIG)
    with torch.no_grad():
        for weight in network.parameters():
            weight += (0.1 if form in ("single", "video") else 0.05) * torch.randn_like(weight)
    return network.eval()
