"""A tracked position: its panorama, the model's state of it, its lights."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel, ProbeLightSource
from roomlight.engine.models.interface import ProbeEstimator, Rendered
from roomlight.engine.panorama.blend import PanoramaState, accumulate, farthest_depth_m
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.room import Room
from roomlight.engine.state.snapshot import ProbeSnapshot
from roomlight.engine.surface.mesh import FrameMesh, PartialPanorama
from roomlight.engine.volume.sglv import render_panorama
from roomlight.light.light import GivenPanorama, Light
from roomlight.light.main_light import find_lights


@dataclass(frozen=True)
class Probe:
    """A position in the room, in world metres, and what the session has accumulated there.

    A frame passes in this order: `render`, `view`, `blend`, `update_lights`.
    """

    position: Position
    room: Room
    panorama: PanoramaState
    estimator: ProbeEstimator
    tracker: LightTracker

    @classmethod
    def fresh(cls, position: Position, room: Room, *, height: int) -> "Probe":
        """Return a probe that has observed nothing; its panorama has `height` rows."""
        panorama = PanoramaState.fresh(height, room.grid.depth_max_m)
        return cls(position, room, panorama, room.volume.new_probe(), LightTracker())

    @classmethod
    def of_keyframes(cls, position: Position, room: Room, *, height: int) -> "Probe":
        """Return a probe into which the keyframes and the last frame are blended, in order of time.

        The SGLVs of those moments are gone: every frame is blended over the present SGLV, which has observed more. 2D
        hidden states run through the same frames from the first on.
        """
        probe = cls.fresh(position, room, height=height)
        rendered = probe.render()
        for kept in room.keyframes.with_last():
            probe.blend(rendered, probe.view(kept.mesh), kept.mesh)
        return probe

    @classmethod
    def of_snapshot(cls, saved: ProbeSnapshot, room: Room) -> "Probe":
        """Return a probe that continues from a saved one, and use its arrays."""
        estimator = room.volume.new_probe()
        estimator.restore(saved.memory)
        return cls(saved.position, room, saved.panorama, estimator, replace(saved.tracker))

    def render(self) -> Rendered:
        """Ray trace the SGLV after the last frame."""
        height = self.panorama.observed.shape[0]
        return Rendered(*render_panorama(self.room.sglv, self.position, height=height, far=self.room.volume.far))

    def view(self, mesh: FrameMesh) -> PartialPanorama:
        """Render what the probe sees of a frame's mesh."""
        partial = mesh.render_panorama(np.asarray(self.position), height=self.panorama.observed.shape[0])
        return partial.within(farthest_depth_m(self.room.grid.depth_max_m))

    def blend(self, rendered: Rendered, partial: PartialPanorama, mesh: FrameMesh) -> None:
        """Let the model estimate the light, and blend the view of a mesh into the panorama."""
        depth_max_m = self.room.grid.depth_max_m
        estimate = self.estimator.estimate(self.panorama, rendered, partial, depth_max_m=depth_max_m)
        accumulate(
            self.panorama,
            hdr=estimate.hdr,
            detail=partial.radiance,
            detail_depth_m=partial.depth_m,
            weight=estimate.weight,
            detail_clipped=partial.clipped,
            detail_guessed=partial.guessed,
            camera=mesh.camera_to_world[:3, 3] - np.asarray(self.position),
        )

    def update_lights(self) -> None:
        """Let the tracker see the panorama after a frame."""
        self.tracker.update(find_lights(self.panorama.radiance))

    def light(self, index: int, load: Callable[[], LightingModel]) -> Light:
        """Return the light after the frame `index`; later frames do not change it, and it is computed on first use."""
        state = self.panorama.for_lighting()
        source = ProbeLightSource(state, self.tracker.lights if self.tracker.frames else None, load)
        return Light(self.position, observed=state.observed, coverage=state.coverage(), frame=index, source=source)

    def estimate(self, index: int) -> Light:
        """Return the model's own estimate after the frame `index`: without the network that makes light of it."""
        radiance, observed = self.panorama.radiance.copy(), self.panorama.observed.copy()
        source = GivenPanorama(radiance, self.tracker.lights if self.tracker.frames else None)
        return Light(self.position, observed=observed, coverage=self.panorama.coverage(), frame=index, source=source)

    def snapshot(self, handle: int) -> ProbeSnapshot:
        """Return a copy that later frames do not change."""
        return ProbeSnapshot(handle, self.position, self.panorama.copy(), self.estimator.save(), replace(self.tracker))
