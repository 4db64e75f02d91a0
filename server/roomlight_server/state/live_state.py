"""What is saved of a session besides its engine: options, owner, order of frames, named probes."""

from dataclasses import dataclass
from typing import Literal

from pydantic import BaseModel, ConfigDict

from roomlight.conventions import Position
from roomlight.engine.state.snapshot import SessionSnapshot
from roomlight.monocular.estimate import DepthModel
from roomlight.monocular.fitting import Fit
from roomlight.monocular.network import DepthNetworkModel
from roomlight.monocular.stream import DepthStream
from roomlight.wire.compositing import SessionScene
from roomlight.wire.messages import FrameResult, SessionRequest
from roomlight_server.work.intake import LatestFrame


class _Saved(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class NamedProbe(BaseModel, extra="forbid"):
    """A named probe; `handle` is that of the engine."""

    position: Position
    handle: int
    coverage: float = 0.0


class SavedQueue(_Saved):
    """The order of frames up to the last one whose outcome is certain.

    Attributes:
        last_index: its index; None: there was none.
        digest: SHA-256 of its bytes, as hexadecimal digits.
        result: its result; None if it was rejected.
        counts: counts of all frames up to it.
    """

    last_index: int | None
    digest: str
    result: FrameResult | None
    counts: dict[str, int]


class SavedBase(_Saved):
    """A file beside the state that holds a kept frame: the client's message, or pixels."""

    file: str
    sha256: str
    kind: Literal["message", "pixels"]


class DepthScale(_Saved):
    """What later frames without depth need of the stream before them (`StreamState`), so that their metres stay.

    `model` is the digest of a network, or the name of another depth model.
    """

    per_metre: float
    unmoved: bool
    fit: Fit | None
    model: str = ""

    @classmethod
    def of(cls, stream: DepthStream) -> "DepthScale":
        """Return that of a stream."""
        state = stream.state
        return cls(per_metre=state.per_metre, unmoved=state.unmoved, fit=state.fit, model=_identity(stream.model))

    def give(self, stream: DepthStream) -> None:
        """Let a new stream go on from it, unless its model is another, whose units are its own."""
        if _identity(stream.model) == self.model:
            state = stream.state
            state.per_metre, state.unmoved, state.fit = self.per_metre, self.unmoved, self.fit


def _identity(model: DepthModel) -> str:
    return model.digest if isinstance(model, DepthNetworkModel) else model.name


class SavedValues(_Saved):
    """The values of a saved session.

    Attributes:
        owner: SHA-256 of the owner, which is itself a digest of the token.
        name: id of the session.
        request: options of the session.
        reference: exposure at which radiance 1 is white; None before the first frame.
        light_frame: index of the last processed frame.
        bases: files of the kept frames, by index.
        latest: index of the last frame, if its message is in the file or in `bases`.
        scene: title and placed objects.
        depth_scale: of estimated depth; None: none was estimated.
    """

    owner: str
    name: str
    request: SessionRequest
    reference: float | None
    probes: dict[str, NamedProbe]
    queue: SavedQueue
    light_frame: int
    bases: dict[int, SavedBase]
    latest: int | None
    scene: SessionScene = SessionScene()
    depth_scale: DepthScale | None = None


@dataclass(frozen=True)
class LiveState:
    """The state of a session between two frames; `bases` and `latest` of the values are filled in on disk."""

    snapshot: SessionSnapshot
    values: SavedValues
    latest: LatestFrame | None
