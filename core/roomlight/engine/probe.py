"""A tracked position: its panorama, the model's state of it, its lights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel, ProbeLightSource
from roomlight.engine.models.interface import ProbeEstimator, Rendered
from roomlight.engine.panorama.blend import AT_PROBE, UNSEEN_DEPTH, PanoramaState, accumulate, farthest_depth_m
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.panorama.likely_light import likely_lights
from roomlight.engine.room import AnyRoom
from roomlight.engine.state.snapshot import ProbeSnapshot
from roomlight.engine.surface.mesh import FrameMesh, PartialPanorama
from roomlight.engine.volume.sglv import render_panorama
from roomlight.light.light import Light
from roomlight.threads import parallel_for, thread_count

_VIEWS_AT_ONCE: Final = 8 * thread_count()
"""Views of meshes by probes between two pauses of long work; 0.8 MB each at 120 rows if one probe has them all."""


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
    def of_keyframes(cls, positions: Sequence[Position], room: AnyRoom, *, height: int) -> "list[Probe]":
        """Return probes that know what the keyframes and the last frame show.

        Their views are blended in order of time, each with its full weight, into what is seen of the place. The model
        then estimates the light once, as if one frame had shown all of it. The SGLVs of those moments are gone; the
        present one has observed more. Several probes share the meshes, and are computed on all cores.
        """
        probes = [cls.fresh(position, room, height=height) for position in positions]
        shown = [PanoramaState.fresh(height, room.grid.depth_max_m) for _ in probes]
        meshes, at_once = [mesh for _, mesh in room.meshes], max(1, _VIEWS_AT_ONCE // len(probes))
        for start in range(0, len(meshes), at_once):
            # of copies: the triangles of all keyframes would take 40 MB
            cls._show([mesh.passing() for mesh in meshes[start : start + at_once]], probes, shown)

        def finish(first: int, last: int) -> None:
            for probe, seen in zip(probes[first:last], shown[first:last], strict=True):
                probe._begin(seen)

        parallel_for(finish, len(probes), most=1)
        return probes

    def _begin(self, shown: PanoramaState) -> None:
        """Take over what is seen of the place, and let the model infer the rest."""
        seen = PartialPanorama(
            shown.radiance, shown.observed > 0, shown.depth_m * (shown.observed > 0), shown.clipped, shown.guessed
        )
        rendered = self.render()
        assert rendered is not None
        estimate = self.estimator.estimate(self.panorama, rendered, seen, depth_max_m=self.room.grid.depth_max_m)
        for _ in range(2):  # surfaces are in several frames: each adds a share of what the ones before left out
            self._accumulate(self.panorama, seen, None, hdr=estimate.hdr, weight=estimate.weight)
        self.panorama.changed[:], self.panorama.viewed_from[:] = shown.changed, shown.viewed_from

    @staticmethod
    def _show(meshes: Sequence[FrameMesh], probes: "Sequence[Probe]", shown: Sequence[PanoramaState]) -> None:
        """Blend views of meshes, in their order, into what probes are shown.

        A probe alone divides the meshes among the cores; several share each mesh.
        """
        views: dict[int, PartialPanorama] = {}
        alone = probes[0] if len(probes) == 1 else None

        def prepare(first: int, last: int) -> None:
            for number in range(first, last):
                meshes[number].prepare()
                if alone is not None:
                    views[number] = alone.view(meshes[number])

        def blend(first: int, last: int) -> None:
            for probe, state in zip(probes[first:last], shown[first:last], strict=True):
                for number, mesh in enumerate(meshes):
                    partial = views[number] if alone is not None else probe.view(mesh)
                    probe._accumulate(state, partial, mesh, hdr=None, weight=partial.mask.astype(np.float32))

        parallel_for(prepare, len(meshes), most=1)
        parallel_for(blend, len(probes), most=1)

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
            self._accumulate(self.panorama, partial, mesh, hdr=None, weight=partial.mask.astype(np.float32))
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
        hdr: Float[np.ndarray, "h w 3"] | None,
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
        self.tracker.update(likely_lights(self.panorama.radiance, self.panorama.observed))

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
