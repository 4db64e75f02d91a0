"""`roomlight bench rendering`: the rendering layer's importance sampling beside a uniform grid of directions.

Both use the same number of directions per pixel: drawn by the BRDF (`roomlight_model.sphere_rendering`), or a fixed
grid over theta and phi of each pixel's hemisphere, as in earlier rendering layers (Li et al. 2020). A grid misses
lamps between its directions, in a pattern that follows the normal: this is the aliasing of the paper's figure.
Importance sampling has noise instead, which differs from pixel to pixel and averages out. A blur removes noise, so
the error that remains after it is aliasing. The reference has 2,048 directions by importance.

Importing this module needs PyTorch: pip install 'roomlight[train]'.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from roomlight.images import write_png
from roomlight.imaging.drawing import Canvas
from roomlight.spheres import SphereRenderer
from roomlight_bench.timing import ProgressCallback
from roomlight_bench.training.sphere_sampling import SphereSampling

COUNTS: Final = (16, 64, 256)
"""Numbers of directions per pixel; each is 4 k^2: the grid has k rows and 4 k columns."""
_REFERENCE: Final = 2048
_SIZE: Final = 128
_BLUR: Final = 3.0
_MARGIN: Final = 20
_GAP: Final = 12
_LABEL: Final = 20

Pixels = Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class SamplingError:
    """RMS differences from the reference, of spheres clamped to [0, 1] as in the rendering loss, and after a blur."""

    samples: int
    uniform: float
    importance: float
    uniform_blurred: float
    importance_blurred: float


@dataclass(frozen=True)
class RenderingReport:
    """Errors and spheres of both samplings.

    Attributes:
        errors: A row per number of directions.
        spheres: Linear pixels [n, 3] of the sphere's mask by (directions, "uniform" or "importance").
        reference: The same pixels from 2,048 directions.
        renderer: The sphere's geometry.
    """

    errors: tuple[SamplingError, ...]
    spheres: dict[tuple[int, str], Pixels]
    reference: Pixels
    renderer: SphereRenderer

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values, without the spheres."""
        return {"reference_samples": _REFERENCE, "errors": [asdict(error) for error in self.errors]}

    def table(self) -> Table:
        """Return a table with a row per number of directions."""
        table = Table(
            title="Glossy sphere, RMS error against 2,048 directions",
            title_justify="left",
            caption=f"clamped to [0, 1] as in the rendering loss; blurred: by {_BLUR} of {self.renderer.size} pixels; "
            "ratio: importance / uniform",
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            show_edge=False,
        )
        headings = ("directions", "uniform", "importance", "ratio", "uniform, blurred", "importance, blurred", "ratio")
        for heading in headings:
            table.add_column(heading, justify="right", min_width=len(heading))
        for error in self.errors:
            columns = [str(error.samples)]
            for uniform, importance in (
                (error.uniform, error.importance),
                (error.uniform_blurred, error.importance_blurred),
            ):
                columns += [f"{uniform:.4f}", f"{importance:.4f}", f"{importance / uniform:.2f}"]
            table.add_row(*columns)
        return table

    def write_picture(self, path: Path) -> None:
        """Write a PNG with a row per number of directions: uniform, importance, reference.

        Raises:
            OutputError: The file cannot be written.
        """
        samplings = ("uniform", "importance", "reference")
        canvas = Canvas(
            2 * _MARGIN + len(samplings) * (self.renderer.size + _GAP) - _GAP,
            2 * _MARGIN + len(self.errors) * (self.renderer.size + _LABEL + _GAP) - _GAP,
        )
        size = self.renderer.size
        for row, error in enumerate(self.errors):
            top = _MARGIN + row * (size + _LABEL + _GAP)
            for column, sampling in enumerate(samplings):
                left = _MARGIN + column * (size + _GAP)
                count = _REFERENCE if sampling == "reference" else error.samples
                canvas.text((left, top), f"{sampling}, {count}", width=size)
                pixels = self.reference if sampling == "reference" else self.spheres[error.samples, sampling]
                image = np.zeros((size, size, 3), np.float32)
                image[self.renderer.mask] = pixels
                canvas.picture((left, top + _LABEL), image, size=(size, size))
        write_png(path, canvas.image)


def compare_sampling(
    panorama: Float[np.ndarray, "h w 3"],
    view: tuple[float, float, float],
    *,
    counts: Sequence[int] = COUNTS,
    size: int = _SIZE,
    progress: ProgressCallback | None = None,
) -> RenderingReport:
    """Light a glossy sphere by both samplings at each count, and by many directions as the reference.

    Args:
        panorama: Linear HDR radiance [h, 2h, 3].
        view: Direction from the camera to the sphere, world axes; see `SphereRenderer`.
        counts: Numbers of directions per pixel.
        size: Pixels across the sphere.
        progress: Called with what is being rendered.
    """
    renderer = SphereRenderer(view, size=size)
    sampling = SphereSampling(panorama, renderer.normals, view)
    if progress is not None:
        progress("the reference")
    reference = sampling.by_importance(_REFERENCE)
    spheres: dict[tuple[int, str], Pixels] = {}
    errors: list[SamplingError] = []
    for count in counts:
        if progress is not None:
            progress(f"{count} directions")
        spheres[count, "uniform"] = sampling.by_grid(count)
        spheres[count, "importance"] = sampling.by_importance(count)
        differences = [
            spheres[count, sampling].clip(0, 1) - reference.clip(0, 1) for sampling in ("uniform", "importance")
        ]
        blurred = [_blurred(difference, renderer) for difference in differences]
        rms = [float(np.sqrt(np.mean(difference**2))) for difference in (*differences, *blurred)]
        errors.append(SamplingError(count, *rms))
    return RenderingReport(tuple(errors), spheres, reference, renderer)


def _blurred(pixels: Pixels, renderer: SphereRenderer) -> Pixels:
    """Blur pixels with their neighbours on the sphere."""
    image = np.zeros((*renderer.mask.shape, 4), np.float32)
    image[renderer.mask, :3], image[renderer.mask, 3] = pixels, 1
    image = cv2.GaussianBlur(image, (0, 0), _BLUR)
    return (image[..., :3] / np.maximum(image[..., 3:], 1e-6))[renderer.mask]
