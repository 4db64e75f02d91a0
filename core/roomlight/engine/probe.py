"""A tracked position: its panorama, the model's state of it, its lights."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel, ProbeLightSource
from roomlight.engine.models.interface import ProbeEstimator, Rendered
from roomlight.engine.panorama.blend import AT_PROBE, UNSEEN_DEPTH, PanoramaState, accumulate, farthest_depth_m
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.room import AnyRoom
from roomlight.engine.state.snapshot import ProbeSnapshot
from roomlight.engine.surface.mesh import FrameMesh, PartialPanorama
from roomlight.engine.volume.sglv import render_panorama
from roomlight.light.light import Light
from roomlight.light.main_light import find_lights
from roomlight.threads import parallel_for, thread_count

_VIEWS_AT_ONCE: Final = 4 * thread_count()
"""Views of meshes that are rendered before they are blended: 0.8 MB each at 120 rows."""


@dataclass(frozen=True)
class Probe:
    """A position in the room, in world metres, and what the session has accumulated there.

    A frame passes in this order: `render`, `view`, `blend`, `update_lights`.

    Attributes:
        room: Whose lighting volume the position lies in; the present one if it lies in none.
        forgotten: Whether the volume that it lay in is no longer remembered: inferred light stays as it was.
    """

    position: Position
    room: AnyRoom
    panorama: PanoramaState
    estimator: ProbeEstimator
    tracker: LightTracker
    forgotten: bool = False

    @classmethod
    def fresh(cls, position: Position, room: AnyRoom, *, height: int) -> "Probe":
        """Return a probe that has observed nothing; its panorama has `height` rows."""
        panorama = PanoramaState.fresh(height, room.grid.depth_max_m)
        return cls(position, room, panorama, room.new_probe(), LightTracker())

    @classmethod
    def of_keyframes(cls, position: Position, room: AnyRoom, *, height: int) -> "Probe":
        """Return a probe that knows what the keyframes and the last frame show.

        Their views are blended in order of time, each with its full weight, into what is seen of the place. The model
        then estimates the light once, as if one frame had shown all of it. The SGLVs of those moments are gone; the
        present one has observed more.
        """
        probe = cls.fresh(position, room, height=height)
        shown = PanoramaState.fresh(height, room.grid.depth_max_m)
        for mesh, partial in probe._views([mesh for _, mesh in room.meshes]):
            weight = partial.mask.astype(np.float32)
            probe._accumulate(shown, partial, mesh, hdr=shown.radiance, weight=weight)
        seen = PartialPanorama(
            shown.radiance, shown.observed > 0, shown.depth_m * (shown.observed > 0), shown.clipped, shown.guessed
        )
        depth_max_m = room.grid.depth_max_m
        rendered = probe.render()
        assert rendered is not None
        estimate = probe.estimator.estimate(probe.panorama, rendered, seen, depth_max_m=depth_max_m)
        for _ in range(2):  # surfaces are in several frames: each adds a share of what the ones before left out
            probe._accumulate(probe.panorama, seen, None, hdr=estimate.hdr, weight=estimate.weight)
        probe.panorama.changed[:], probe.panorama.viewed_from[:] = shown.changed, shown.viewed_from
        return probe

    def _views(self, meshes: Sequence[FrameMesh]) -> Iterator[tuple[FrameMesh, PartialPanorama]]:
        """Render what the probe sees of each mesh, several at a time on all cores."""
        for start in range(0, len(meshes), _VIEWS_AT_ONCE):
            some = meshes[start : start + _VIEWS_AT_ONCE]
            views: dict[int, PartialPanorama] = {}

            def look(first: int, last: int, some: Sequence[FrameMesh] = some, views: dict[int, Any] = views) -> None:
                # of copies: the triangles of all keyframes would take 40 MB
                views.update((number, self.view(some[number].passing())) for number in range(first, last))

            parallel_for(look, len(some))
            yield from ((mesh, views[number]) for number, mesh in enumerate(some))

    @classmethod
    def of_snapshot(cls, saved: ProbeSnapshot, room: AnyRoom) -> "Probe":
        """Return a probe that continues from a saved one, and use its arrays."""
        estimator = room.new_probe()
        estimator.restore(saved.memory)
        return cls(saved.position, room, saved.panorama, estimator, replace(saved.tracker), saved.forgotten)

    def in_room(self, room: AnyRoom) -> "Probe":
        """Return the probe with the lighting volume of another room from now on, and use its arrays."""
        old_m, depth_m = np.float32(UNSEEN_DEPTH * self.room.grid.depth_max_m), self.panorama.depth_m
        depth_m[depth_m == old_m] = UNSEEN_DEPTH * room.grid.depth_max_m
        return replace(self, room=room, forgotten=not room.grid.contains(self.position))

    def render(self) -> Rendered | None:
        """Ray trace the SGLV after the last frame; None for a place whose room is forgotten."""
        if self.forgotten:
            return None
        height = self.panorama.observed.shape[0]
        return Rendered(*render_panorama(self.room.sglv, self.position, height=height, far=self.room.far))

    def view(self, mesh: FrameMesh) -> PartialPanorama:
        """Render what the probe sees of a frame's mesh."""
        partial = mesh.render_panorama(np.asarray(self.position), height=self.panorama.observed.shape[0])
        return partial.within(farthest_depth_m(self.room.grid.depth_max_m))

    def blend(self, rendered: Rendered | None, partial: PartialPanorama, mesh: FrameMesh) -> None:
        """Let the model estimate the light, and blend the view of a mesh into the panorama."""
        if rendered is None:
            weight, hdr = partial.mask.astype(np.float32), self.panorama.radiance.copy()
            self._accumulate(self.panorama, partial, mesh, hdr=hdr, weight=weight)
            return
        depth_max_m = self.room.grid.depth_max_m
        estimate = self.estimator.estimate(self.panorama, rendered, partial, depth_max_m=depth_max_m)
        self._accumulate(self.panorama, partial, mesh, hdr=estimate.hdr, weight=estimate.weight)

    def _accumulate(
        self,
        state: PanoramaState,
        partial: PartialPanorama,
        mesh: FrameMesh | None,
        *,
        hdr: Float[np.ndarray, "h w 3"],
        weight: Float[np.ndarray, "h w"],
    ) -> None:
        camera = AT_PROBE if mesh is None else mesh.camera_to_world[:3, 3] - np.asarray(self.position)
        accumulate(
            state,
            hdr=hdr,
            detail=partial.radiance,
            detail_depth_m=partial.depth_m,
            weight=weight,
            detail_clipped=partial.clipped,
            detail_guessed=partial.guessed,
            camera=camera,
        )

    def update_lights(self) -> None:
        """Let the tracker see the panorama after a frame."""
        self.tracker.update(find_lights(self.panorama.radiance))

    def light(self, index: int, load: Callable[[], LightingModel]) -> Light:
        """Return the light after the frame `index`; later frames do not change it, and it is computed on first use."""
        state = self.panorama.for_lighting()
        source = ProbeLightSource(state, self.tracker.lights if self.tracker.frames else None, load)
        return Light(self.position, observed=state.observed, coverage=state.coverage(), frame=index, source=source)

    def snapshot(self, handle: int, rooms: Sequence[AnyRoom]) -> ProbeSnapshot:
        """Return a copy that later frames do not change; `rooms` are those of the session."""
        panorama, tracker = self.panorama.copy(), replace(self.tracker)
        number = next(n for n, room in enumerate(rooms) if room is self.room)
        return ProbeSnapshot(handle, self.position, panorama, self.estimator.save(), tracker, number, self.forgotten)
