"""A session between two frames, as plain data that the session no longer changes.

Arrays that the next frame overwrites are copied (9 MB with the classical model, 3 ms). The arrays of the kept frames
are shared: a session replaces their textures and never writes into them.
"""

from dataclasses import dataclass

from roomlight.conventions import Position
from roomlight.engine.models.interface import Arrays
from roomlight.engine.options import SessionOptions
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.surface.drift import Drift
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.surface.texture import Texture
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.errors import StateError


@dataclass(frozen=True)
class KeptFrame:
    """A keyframe or the last frame, with its texture at the time of the snapshot."""

    index: int
    mesh: FrameMesh
    texture: Texture

    @classmethod
    def of(cls, index: int, mesh: FrameMesh) -> "KeptFrame":
        """Return the frame with the texture that the mesh has now."""
        mesh = mesh.passing()
        return cls(index, mesh, mesh.texture)


@dataclass(frozen=True)
class ProbeSnapshot:
    """A tracked probe: its panorama, the model's state of it, its lights.

    `room` is the number of its room: of `SessionSnapshot.left`, or the next one for the present room.
    """

    handle: int
    position: Position
    panorama: PanoramaState
    memory: Arrays
    tracker: LightTracker
    room: int
    forgotten: bool


@dataclass(frozen=True)
class LeftRoom:
    """What is remembered of a room that the camera has left: its SGLV, and the indices of its keyframes."""

    grid: VolumeGrid
    sglv: Arrays
    frames: tuple[int, ...]


@dataclass(frozen=True)
class SessionSnapshot:
    """The state of a session.

    Attributes:
        options: of the session.
        networks: the model in use and the identity of the weights; see `Session.networks`.
        frames: number of frames so far.
        last_index: index of the last frame; `NO_FRAME` before the first.
        next_handle: of the next tracked probe.
        grid: pose and size of the present volume; None before the first frame.
        volume: the model's 3D state; empty before the first frame.
        pending: positions tracked before the first frame, by handle.
        probes: the tracked probes, in the order of their handles in the session.
        keyframes: of all rooms, in order of their indices.
        latest: the last frame, if it is no keyframe.
        left: rooms that the camera has left.
        present: indices of the keyframes of the room that it is in, in order of time.
        drift: gains against frames whose exposure drifts.
    """

    options: SessionOptions
    networks: dict[str, str]
    frames: int
    last_index: int
    next_handle: int
    grid: VolumeGrid | None
    volume: Arrays
    pending: dict[int, Position]
    probes: tuple[ProbeSnapshot, ...]
    keyframes: tuple[KeptFrame, ...]
    latest: KeptFrame | None
    left: tuple[LeftRoom, ...]
    present: tuple[int, ...]
    drift: Drift

    @property
    def kept(self) -> tuple[KeptFrame, ...]:
        """The keyframes, and the last frame if it is no keyframe."""
        return self.keyframes if self.latest is None else (*self.keyframes, self.latest)

    def check(self, options: SessionOptions, networks: dict[str, str]) -> None:
        """Check that a session with these options and networks can continue from the snapshot.

        Raises:
            StateError: The options or the weights differ from the saved ones.
        """
        for name in ("hedge", "height", "keyframes", "unknown_depth"):
            saved, given = getattr(self.options, name), getattr(options, name)
            if saved != given:
                raise StateError(f"the session was saved with {name}={saved!r}, not {given!r}")
        for name, given in networks.items():
            saved = self.networks.get(name)
            if saved != given:
                what = {"model": "the model", "weights": "weights", "clipping": "a network for clipped pixels"}[name]
                digests = [(digest or "none")[:16] for digest in (saved or "", given)]
                raise StateError(f"the session was saved with {what} {digests[0]}, and here is {digests[1]}")
