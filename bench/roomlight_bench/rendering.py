"""`roomlight bench rendering`: the rendering layer's importance sampling beside a uniform grid of directions.

The same number of directions a pixel each: the BRDF's own (`roomlight_model.sphere`), and a fixed grid over theta and
phi of each pixel's hemisphere, as rendering layers before it had (Li et al. 2020). A grid steps over lamps, and where
it does follows the normal: that is the aliasing of the paper's figure. Importance sampling has noise instead, which
differs from pixel to pixel and averages out; what a blur leaves of the error is the aliasing. The reference is 2,048
directions by importance.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from roomlight.drawing import Canvas
from roomlight.images import write_png
from roomlight.spheres import SphereRenderer

COUNTS: Final = (16, 64, 256)
"""Directions a pixel; each is 4 k^2, so that the grid has k rows and 4 k columns."""
_REFERENCE: Final = 2048
_SIZE: Final = 128
_BLUR: Final = 3.0
_MARGIN: Final = 20
_GAP: Final = 12
_LABEL: Final = 20

Pixels = Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class SamplingError:
    """RMS difference to the reference of spheres clamped to [0, 1], as the rendering loss does; and what is left
    of it after a blur."""

    samples: int
    uniform: float
    importance: float
    uniform_blurred: float
    importance_blurred: float


@dataclass(frozen=True)
class RenderingReport:
    """What was compared; `spheres` are linear pixels of the sphere's mask by (samples, way)."""

    errors: tuple[SamplingError, ...]
    spheres: dict[tuple[int, str], Pixels]
    reference: Pixels
    renderer: SphereRenderer

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values, without the pictures."""
        return {"reference_samples": _REFERENCE, "errors": [asdict(error) for error in self.errors]}

    def table(self) -> Table:
        """A row a count."""
        table = Table(
            title="Glossy sphere, RMS error against 2,048 directions",
            title_justify="left",
            caption=f"clamped to [0, 1] as in the rendering loss; blurred: by {_BLUR} pixels of {self.renderer.size}",
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
        """A row a count: uniform, importance, reference. OutputError if it cannot be written."""
        ways = ("uniform", "importance", "reference")
        canvas = Canvas(
            2 * _MARGIN + len(ways) * (self.renderer.size + _GAP) - _GAP,
            2 * _MARGIN + len(self.errors) * (self.renderer.size + _LABEL + _GAP) - _GAP,
        )
        size = self.renderer.size
        for row, error in enumerate(self.errors):
            top = _MARGIN + row * (size + _LABEL + _GAP)
            for column, way in enumerate(ways):
                left = _MARGIN + column * (size + _GAP)
                count = _REFERENCE if way == "reference" else error.samples
                canvas.text((left, top), f"{way}, {count}", width=size)
                pixels = self.reference if way == "reference" else self.spheres[error.samples, way]
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
    progress: Callable[[str], object] | None = None,
) -> RenderingReport:
    """Light a glossy sphere both ways at each count, and once with many directions; `view` as for `SphereRenderer`."""
    from roomlight_bench.sphere_sampling import SphereSampling

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
        off = [spheres[count, way].clip(0, 1) - reference.clip(0, 1) for way in ("uniform", "importance")]
        rms = [float(np.sqrt(np.mean(one**2))) for one in (*off, *(_blurred(one, renderer) for one in off))]
        errors.append(SamplingError(count, *rms))
    return RenderingReport(tuple(errors), spheres, reference, renderer)


def _blurred(off: Pixels, renderer: SphereRenderer) -> Pixels:
    """Differences averaged with their neighbours on the sphere."""
    image = np.zeros((*renderer.mask.shape, 4), np.float32)
    image[renderer.mask, :3], image[renderer.mask, 3] = off, 1
    image = cv2.GaussianBlur(image, (0, 0), _BLUR)
    return (image[..., :3] / np.maximum(image[..., 3:], 1e-6))[renderer.mask]
