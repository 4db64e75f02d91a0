"""Writes the sample capture that RoomLight ships: `generate_sample(Path("core/roomlight/data/sample"))` made it.

A hand-held walk through the furnished room (31 frames with exact depth and poses) and three ground-truth HDR probes,
all from one light simulation, in the native layout. The same arguments give the same files, whatever the threads.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomlight.captures.native import CaptureWriter
from roomlight_model.sample_room.camera_path import FRAME_INTERVAL_S, PROBES_M, intrinsics, poses
from roomlight_model.sample_room.render import expose, render_depth, render_frame, render_probe
from roomlight_model.sample_room.room import build_room
from roomlight_model.sample_room.transport import bake_indirect

RAY_LIMIT = 2.5
"""Rays of frames (never of probes) are held to this, which keeps the edges of lamps smooth where 8 bits clip anyway."""

JPEG_QUALITY = 90
"""What phones store: 19 kB a frame at 320 x 240."""


@dataclass(frozen=True)
class Quality:
    """Effort of the light simulation; the defaults made the shipped sample, in 4.5 minutes on 2 busy cores.

    frame_samples, probe_samples:  rays a pixel, each with 15 shadow rays.
    gather_rays, bounces:          of each vertex of the indirect light's cache.
    points_per_face:               where direct light is measured for that cache.
    detail_m:                      the cache's step on walls and floor.
    """

    frame_samples: int = 10
    probe_samples: int = 48
    gather_rays: int = 256
    bounces: int = 10
    points_per_face: int = 2
    detail_m: float = 0.085


def generate_sample(
    out: Path,
    *,
    seed: int = 7,
    frames: int = 31,
    width: int = 320,
    height: int = 240,
    probe_height: int = 120,
    quality: Quality | None = None,
) -> None:
    """Build, light, walk through and write the sample room as a native capture at `out`.

    The exposure is constant: 1.0 is white in every frame and the probes' unit. OutputError where `out` holds
    something already or cannot be written; what was begun is removed.
    """
    effort = quality or Quality()
    with CaptureWriter(out, name="sample room") as writer:
        scene = build_room(seed=seed, detail_m=effort.detail_m)
        indirect = bake_indirect(
            scene,
            seed=seed,
            rays=effort.gather_rays,
            bounces=effort.bounces,
            points_per_face=effort.points_per_face,
        )
        camera = intrinsics(width, height)
        for index, camera_to_world in enumerate(poses(frames, seed=seed)):
            image = render_frame(
                scene,
                indirect,
                camera,
                camera_to_world,
                samples=effort.frame_samples,
                seed=1000 * seed + index,
                limit=RAY_LIMIT,
            )
            writer.add(
                srgb8=expose(image, rng=np.random.default_rng([seed, 6, index])),
                depth_m=render_depth(scene, camera, camera_to_world),
                intrinsics=camera,
                camera_to_world=camera_to_world,
                timestamp_s=index * FRAME_INTERVAL_S,
                jpeg_quality=JPEG_QUALITY,
            )
        for index, position in enumerate(PROBES_M):
            panorama = render_probe(
                scene,
                indirect,
                np.array(position),
                height=probe_height,
                samples=effort.probe_samples,
                seed=1000 * seed + 500 + index,
            )
            writer.add_probe(position, panorama)
