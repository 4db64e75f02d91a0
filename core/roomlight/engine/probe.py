"""A tracked position: its panorama, the model's state of it, its lights."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel, ProbeLightSource
from roomlight.engine.models.choosing import ProbeEstimator
from roomlight.engine.models.interface import Rendered
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.blend import (
    AT_PROBE,
    PanoramaState,
    PartialPanorama,
    accumulate,
    farthest_depth_m,
    unseen_depth_m,
)
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.panorama.likely_light import likely_lights
from roomlight.engine.room import AnyRoom
from roomlight.engine.state.snapshot import ProbeSnapshot
from roomlight.engine.surface.mesh import FrameMesh, MeshesView, distinct, forget_seen_through
from roomlight.engine.volume.sglv import render_coarse_panorama
from roomlight.light.light import Light
from roomlight.threads import parallel_for, thread_count

_PIXELS_AT_ONCE: Final = 8 * 2 * 120**2
"""Most pixels of panoramas that late points have at once, about 250 bytes each."""
_GROUPS: Final = 4
"""Parts of the meshes, by time, that a late point's threads divide; light does not depend on the number of threads."""


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
    def of_keyframes(cls, positions: Sequence[Position], room: AnyRoom, *, height: int) -> "Iterator[Probe]":
        """Yield probes that know what the keyframes and the last frame show.

        Each direction shows the first frame that sees it, or a later one whose surface is closer; what later frames
        contradict comes last. The model then estimates the light once, as if one frame had shown all of it. The SGLVs
        of those moments are gone; the present one has observed more. All probes share what `distinct` leaves of the
        meshes; some at a time are computed on all cores.
        """
        shown = sorted((mesh for _, mesh in room.meshes), key=lambda mesh: mesh.contradicted)
        meshes = distinct(shown)
        groups = [meshes[n * len(meshes) // _GROUPS : (n + 1) * len(meshes) // _GROUPS] for n in range(_GROUPS)]
        cameras = np.array([mesh.camera_to_world[:3, 3] for mesh in shown]).reshape(-1, 3)
        at_once = max(1, min(4 * thread_count(), _PIXELS_AT_ONCE // (2 * height**2)))
        for start in range(0, len(positions), at_once):
            probes = [cls.fresh(position, room, height=height) for position in positions[start : start + at_once]]
            cls._show(probes, groups, cameras)
            yield from probes

    @staticmethod
    def _show(
        probes: "Sequence[Probe]", groups: Sequence[Sequence[tuple[int, FrameMesh]]], cameras: Float[np.ndarray, "n 3"]
    ) -> None:
        """Show fresh probes groups of meshes, those of earlier frames first."""
        height = probes[0].panorama.observed.shape[0]
        views = [[MeshesView(np.asarray(probe.position), height) for _ in groups] for probe in probes]

        def show(first: int, last: int) -> None:
            for number in range(first, last):
                views[number // _GROUPS][number % _GROUPS].add(groups[number % _GROUPS])

        def begin(first: int, last: int) -> None:
            for probe, (earliest, *others) in zip(probes[first:last], views[first:last], strict=True):
                for other in others:
                    earliest.add_view(other)
                probe._begin(earliest, cameras)

        parallel_for(show, len(probes) * _GROUPS, most=1)
        parallel_for(begin, len(probes), most=1)

    def _begin(self, shown: MeshesView, cameras: Float[np.ndarray, "n 3"]) -> None:
        """Take over what is seen of the place, and let the model infer the rest."""
        seen = shown.partial().within(farthest_depth_m(self.room.grid.depth_max_m))
        depth_max_m = self.room.grid.depth_max_m
        estimate = self.estimator.estimate(self.panorama, self._rendered(), seen, depth_max_m=depth_max_m)
        for _ in range(2):  # surfaces are in several frames: each adds a share of what the ones before left out
            self._accumulate(seen, None, hdr=estimate.hdr, weight=estimate.weight)
        self.panorama.viewed_from[:] = shown.viewed_from(cameras)

    @classmethod
    def of_snapshot(cls, saved: ProbeSnapshot, room: AnyRoom) -> "Probe":
        """Return a probe that continues from a saved one, and use its arrays."""
        estimator = room.new_probe()
        estimator.restore(saved.memory)
        return cls(saved.position, room, saved.panorama, estimator, replace(saved.tracker), saved.forgotten)

    def in_room(self, room: AnyRoom) -> "Probe":
        """Return the probe with the lighting volume of another room from now on, and use its arrays.

        If its size is another, what was not seen or farther than depth was kept is seen next as if for the first time.
        """
        before_m, depth_m = self.room.grid.depth_max_m, self.panorama.depth_m
        if before_m != room.grid.depth_max_m:
            depth_m[depth_m >= farthest_depth_m(before_m) - CLOSER_M] = unseen_depth_m(room.grid.depth_max_m)
        forgotten = self.forgotten or self.room.grid.contains(self.position)
        return replace(self, room=room, forgotten=forgotten and not room.grid.contains(self.position))

    def render(self) -> Rendered | None:
        """Ray trace the SGLV after the last frame; None for a place whose room is forgotten."""
        return None if self.forgotten else self._rendered()

    def _rendered(self) -> Rendered:
        """Ray trace the SGLV.

        From a place outside, rays miss the volume: networks, which take all of a rendering as light, get that at the
        nearest place in the volume.
        """
        room, height = self.room, self.panorama.observed.shape[0]
        position = self.position if room.far == "none" else room.grid.nearest_inside(self.position)
        return Rendered(*render_coarse_panorama(room.sglv, position, height=height, far=room.far))

    def view(self, mesh: FrameMesh) -> PartialPanorama:
        """Render what the probe sees of a frame's mesh: of completed depth, what lies before no measured surface."""
        partial = mesh.render_panorama(np.asarray(self.position), height=self.panorama.observed.shape[0])
        return partial.within(farthest_depth_m(self.room.grid.depth_max_m)).not_before(self.panorama)

    def blend(self, rendered: Rendered | None, partial: PartialPanorama, mesh: FrameMesh) -> None:
        """Let the model estimate the light, and blend the view of a mesh into the panorama.

        What the frame and the one before see through, such as a person who has left, is forgotten first.
        """
        depth_max_m = self.room.grid.depth_max_m
        forget_seen_through(self.panorama, partial, mesh, self.position, depth_max_m)
        if rendered is None:
            self._accumulate(partial, mesh, hdr=None, weight=partial.mask.astype(np.float32))
            return
        estimate = self.estimator.estimate(self.panorama, rendered, partial, depth_max_m=depth_max_m)
        self._accumulate(partial, mesh, hdr=estimate.hdr, weight=estimate.weight)

    def _accumulate(
        self,
        partial: PartialPanorama,
        mesh: FrameMesh | None,
        *,
        hdr: Float[np.ndarray, "h w 3"] | None,
        weight: Float[np.ndarray, "h w"],
    ) -> None:
        camera = AT_PROBE if mesh is None else mesh.camera_to_world[:3, 3] - np.asarray(self.position)
        unseen_m = unseen_depth_m(self.room.grid.depth_max_m)
        accumulate(self.panorama, partial, hdr=hdr, weight=weight, unseen_m=unseen_m, camera=camera)

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
