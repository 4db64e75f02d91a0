"""The small configuration that the export's tests share."""

from roomlight_model.config import BlendConfig, ModelConfig, SGConfig

SHAPE = (17, 14, 23)  # no side is divisible by 2 three times
CONFIG = ModelConfig(
    SGConfig(volume_shape=SHAPE, channels=8, full_channels=4), BlendConfig(height=18, channels=4, full_channels=4)
)
CARD: dict[str, object] = {"steps": 3, "date": "2026-01-02"}
