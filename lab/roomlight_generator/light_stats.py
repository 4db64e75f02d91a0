"""Statistics of the light in a first frame and around it; generated rooms beside real panoramas.

Values are luminance (Rec. 709) in units of the first frame's white: 1.0 is what the frame shows as white; of clipped
pixels it is the brightest channel, which clips first. Shares of the sphere and means over it are weighted by solid
angle. Panoramas are compared at the same height, `HEIGHT` rows.
World frame: y up.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.conventions import LUMINANCE, panorama_solid_angles, srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.errors import DatasetError
from roomlight.frame import CLIPPED_SRGB8
from roomlight.images import read_panorama
from roomlight.spheres import radiance_along, resize_panorama
from roomlight_generator.panoramas.library import panorama_files
from roomlight_generator.sequences.walk import FIELD_OF_VIEW_DEGREES, camera_axes

HEIGHT: Final = 120
"""Rows of the measured panoramas, as of a dataset's probes; higher panoramas are averaged down."""
VIEWS: Final = 8
"""Views cropped from each real panorama."""
WHITE_PERCENTILE: Final = 80
WHITE_SHARE: Final = 0.43
"""Exposure of a real panorama's views: their 80th percentile is 0.43 of white.

Frames of five phone recordings have 0.41 to 0.45, with a mean of 0.26 to 0.34, a median of 0.21 to 0.35 and 0 to 2 % of
clipped pixels.
"""
PITCH_DEGREES: Final = (-14.0, 6.0)
"""Range of the views' elevation: phones look slightly down."""
TOLERANCE: Final = 0.25
"""Relative difference up to which quartiles count as alike."""

_CLIPPED: Final = float(srgb8_to_linear(np.array([CLIPPED_SRGB8], np.uint8))[0])
_VIEW_SIZE: Final = (160, 120)
_BRIGHT: Final = 3.0
"""Factor over the frame's mean above which a direction is a bright area."""
_TINY: Final = 1e-9

Measures = dict[str, float]
"""Measures of one frame and one panorama by name; NaN where a measure has no value."""


@dataclass(frozen=True)
class LightRow:
    """Quartiles (25, 50 and 75 %) of one measure, generated and real."""

    name: str
    generated: tuple[float, float, float]
    real: tuple[float, float, float]

    @property
    def alike(self) -> bool:
        """Whether each quartile is within `TOLERANCE` of the real one."""
        pairs = zip(self.generated, self.real, strict=True)
        return all(abs(generated - real) <= TOLERANCE * abs(real) for generated, real in pairs)


@dataclass(frozen=True)
class LightComparison:
    """Generated first frames with their probes, and views of real panoramas with their panorama."""

    sequences: int
    panoramas: int
    rows: tuple[LightRow, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rows = {row.name: {"generated": row.generated, "real": row.real, "alike": row.alike} for row in self.rows}
        return {"sequences": self.sequences, "panoramas": self.panoramas, "rows": rows}


def measure_light(
    frame: Float[np.ndarray, "h w 3"], clipped: Float[np.ndarray, "n 3"], panorama: Float[np.ndarray, "ph pw 3"] | None
) -> Measures:
    """Measure one frame and one panorama near it, or a frame alone.

    "above 3 x frame" means above three times the frame's mean; ceiling, walls and floor are the means over the
    directions more than 30 degrees above the horizon, less than 30 from it, and more than 30 below.

    Args:
        frame: Linear RGB as the phone shows it, at most 1.
        clipped: True radiance at the frame's clipped pixels; empty if none is clipped.
    """
    luminances = frame @ LUMINANCE
    mean = max(float(luminances.mean()), _TINY)
    of_frame = {
        "frame's mean": mean,
        "frame's median": float(np.median(luminances)),
        f"frame's {WHITE_PERCENTILE}th percentile": float(np.percentile(luminances, WHITE_PERCENTILE)),
        "frame's clipped share": float((frame.max(axis=-1) >= _CLIPPED).mean()),
        "clipped pixels' radiance": float(np.median(clipped.max(axis=-1))) if len(clipped) else np.nan,
    }
    if panorama is None:
        return of_frame
    light = np.asarray(resize_panorama(panorama, min(len(panorama), HEIGHT)) @ LUMINANCE, np.float64)
    share = np.broadcast_to(panorama_solid_angles(len(light)) / (4 * np.pi), light.shape)
    total = max(float((light * share).sum()), _TINY)
    white, bright = light > 1, light > _BRIGHT * mean
    high = float(np.percentile(light, 99.9))
    ceiling, walls, floor = _bands(light, share)
    return {
        **of_frame,
        "sphere above white": float(share[white].sum()),
        "energy above white": float((light * share)[white].sum()) / total,
        "panorama's mean": total,
        "panorama's median": float(np.median(light)),
        "99.9th percentile": high,
        "mean / frame's mean": total / mean,
        "99.9th / frame's mean": high / mean,
        "sphere above 3 x frame": float(share[bright].sum()),
        "energy above 3 x frame": float((light * share)[bright].sum()) / total,
        "ceiling / floor": ceiling / floor,
        "ceiling / walls": ceiling / walls,
        "floor / walls": floor / walls,
    }


def recording_light(recording: Recording) -> list[Measures]:
    """Measure a recording's first frame with each of its probes, or alone if it has none.

    Raises:
        DatasetError: if the recording lacks the radiance of clipped pixels.
    """
    frame = srgb8_to_linear(recording.colour[0])
    saturated = recording.colour[0].max(axis=-1) >= CLIPPED_SRGB8
    stored = frame[None] if recording.clipped_radiance is None else recording.clipped_radiance
    if recording.clipped_radiance is None and saturated.any():
        raise DatasetError(f"{recording.name}: lacks the radiance of clipped pixels; generate the dataset again")
    clipped = stored[0][saturated].astype(np.float32)
    clipped = np.maximum(clipped, frame[saturated])  # noise and JPEG clip pixels that were not
    panoramas = [*recording.probe_panoramas] or [None]
    return [measure_light(frame, clipped, panorama) for panorama in panoramas]


def panorama_light(
    panorama: Float[np.ndarray, "h w 3"], rng: np.random.Generator, *, views: int = VIEWS
) -> list[Measures]:
    """Measure views of a real panorama, each with the whole panorama exposed as the view.

    A view looks in a random direction from the panorama's centre: any azimuth, an elevation in `PITCH_DEGREES`, a
    phone's field of view (55 to 72 degrees across the long side of 4:3). Its exposure takes its 80th percentile to 0.43
    of white. A view that is black above its 80th percentile has no exposure and is left out.
    """
    measures: list[Measures] = []
    for _ in range(views):
        view = _crop(panorama, rng)
        level = float(np.percentile(view @ LUMINANCE, WHITE_PERCENTILE))
        if level <= 0:
            continue
        scale = np.float32(WHITE_SHARE / level)
        clipped = (scale * view)[(scale * view).max(axis=-1) >= _CLIPPED]
        measures.append(measure_light(np.minimum(scale * view, 1), clipped, scale * panorama))
    return measures


def compare_light(
    dataset: Dataset, panoramas: Path, *, limit: int | None = None, progress: Callable[[int, int], None] | None = None
) -> LightComparison:
    """Compare a dataset, or `limit` sequences spread evenly over it, with the real panoramas of a folder.

    Views of panoramas are drawn with a fixed seed: the same folder gives the same figures.

    Raises:
        DatasetError: if a sequence is damaged or a folder has nothing to compare.
        ImageError: if a panorama cannot be read.
    """
    files = panorama_files(panoramas)
    count = len(dataset) if limit is None else min(limit, len(dataset))
    if not count:
        raise DatasetError(f"{dataset.folder}: has no sequence to compare; `roomlight dataset generate` makes them")
    numbers = sorted({round(k) for k in np.linspace(0, len(dataset) - 1, count).tolist()})
    done = 0

    def counted(measured: Iterable[list[Measures]]) -> Iterator[Measures]:
        nonlocal done
        for measures in measured:
            done += 1
            if progress:
                progress(done, len(numbers) + len(files))
            yield from measures

    generated = list(counted(recording_light(dataset.read(number, frames=(0,), clipped=True)) for number in numbers))
    rng = np.random.default_rng(0)
    real = list(counted(panorama_light(read_panorama(path), rng) for path in files))
    return LightComparison(len(numbers), len(files), compare_measures(generated, real))


def compare_measures(generated: Sequence[Measures], real: Sequence[Measures]) -> tuple[LightRow, ...]:
    """Return the quartiles of each measure that has values on both sides."""
    rows = (LightRow(name, _quartiles(generated, name), _quartiles(real, name)) for name in real[0])
    return tuple(row for row in rows if np.isfinite([*row.generated, *row.real]).all())


def _quartiles(measured: Sequence[Measures], name: str) -> tuple[float, float, float]:
    values = np.array([measures.get(name, np.nan) for measures in measured])
    values = values[np.isfinite(values)]
    if not len(values):
        return np.nan, np.nan, np.nan
    low, middle, high = np.percentile(values, [25, 50, 75]).tolist()
    return low, middle, high


def _bands(light: Float[np.ndarray, "h w"], share: Float[np.ndarray, "h w"]) -> tuple[float, float, float]:
    """Return the mean over the directions above 30 degrees of elevation, those between, and those below -30 degrees."""
    third = round(len(light) / 3)
    bands = (slice(0, third), slice(third, len(light) - third), slice(len(light) - third, None))
    first, second, last = (max(float((light * share)[band].sum() / share[band].sum()), _TINY) for band in bands)
    return first, second, last


def _crop(panorama: Float[np.ndarray, "h w 3"], rng: np.random.Generator) -> Float[np.ndarray, "vh vw 3"]:
    """Return a phone's view of a panorama in a random direction, not exposed."""
    width, height = _VIEW_SIZE
    focal = width / 2 / np.tan(np.radians(rng.uniform(*FIELD_OF_VIEW_DEGREES)) / 2)
    yaw, pitch = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*PITCH_DEGREES))
    rays = Intrinsics(focal, focal, width / 2, height / 2, width, height).rays() @ camera_axes(yaw, pitch).T
    return radiance_along(panorama, rays / np.linalg.norm(rays, axis=-1, keepdims=True))
