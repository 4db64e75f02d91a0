"""Messages of objects, composites and scenes: `/v1/objects`, `/composite` and `/scene` of a session.

World metres, y up; colours are linear RGB; a pose is 16 numbers, column by column, as in `frame_header`.
"""

from typing import Annotated, Final, Literal

from pydantic import Field, StringConstraints, model_validator

from roomlight.wire.frame_header import FiniteNumber, WireModel
from roomlight.wire.messages import Id, WirePosition

OBJECT_ID_PATTERN: Final = r"^[0-9a-f]{64}$"
MAX_COMPOSITE_OBJECTS: Final = 16

ObjectId = Annotated[str, StringConstraints(pattern=OBJECT_ID_PATTERN)]
ObjectFormat = Literal["glb", "gltf", "obj", "ply"]
Shape = Literal["sphere", "cube", "plane", "vase", "chair", "teapot"]
MaterialKind = Literal["diffuse", "glossy", "metal", "mirror", "glass"]
CompositeQuality = Literal["preview", "good", "final"]
CompositeFormat = Literal["png", "jpeg", "exr", "layers"]
Share = Annotated[float, Field(ge=0, le=1)]
Coordinate = Annotated[float, Field(ge=-10_000, le=10_000, allow_inf_nan=False)]


class ObjectInfo(WireModel):
    """An object that the server holds.

    Attributes:
        id: SHA-256 of the file, hexadecimal.
        triangles: number of triangles.
        lower_m: lower corner of its bounding box about its origin, in the file's own metres.
        size_m: sides of its bounding box in the file's own metres.
        bytes: memory that it takes on the server.
        notes: what its file states and was left out or changed.
    """

    id: ObjectId
    triangles: int
    lower_m: Annotated[list[FiniteNumber], Field(min_length=3, max_length=3)]
    size_m: Annotated[list[FiniteNumber], Field(min_length=3, max_length=3)]
    bytes: int
    notes: tuple[str, ...] = ()


class ObjectList(WireModel):
    """The objects of a token, the memory that they take together, and its limit."""

    objects: list[ObjectInfo]
    bytes: int
    limit_bytes: int


class CompositeMaterial(WireModel):
    """A material that replaces those of a file.

    Attributes:
        kind: diffuse, glossy, metal, mirror or glass.
        base_colour: default 0.8 grey, white for metal and glass; mirrors have none.
        roughness: 0 to 1, of glossy (0.2) and metal (0.5).
    """

    kind: MaterialKind
    base_colour: Annotated[list[Share], Field(min_length=3, max_length=3)] | None = None
    roughness: Share | None = None


class CompositeObject(WireModel):
    """An object and its place: exactly one of object and shape, and exactly one of position, pose and pixel.

    Attributes:
        object: id of an uploaded object.
        shape: sphere, cube, plane, vase, chair or teapot, instead of an uploaded object.
        up: axis of an uploaded object that points up; z is turned to y.
        name: of the object in the answer; default object-0, object-1, ...
        size_m: longest side, up to 100 m; default: the file's own metres, 0.2 for sphere and cube, 0.3 for vase and
            teapot, 0.5 for plane, 0.85 for chair.
        material: `kind` (diffuse, glossy, metal, mirror or glass), `base_colour` and `roughness`; default: the file's
            own.
        position: world metres of the anchor, upright; with yaw_degrees.
        pose: rigid, object axes to world, 16 numbers column by column.
        pixel: column and row in the last processed frame, as it was sent: the object stands on the surface there.
        yaw_degrees: about the surface's normal, with position and pixel.
        anchor: point of the object that is placed: base (default), back, top, centre or origin. Not with pixel, whose
            surface chooses it.
    """

    object: ObjectId | None = None
    shape: Shape | None = None
    up: Literal["y", "z"] = "y"
    name: Id | None = None
    size_m: Annotated[float, Field(gt=0, le=100)] | None = None
    material: CompositeMaterial | None = None
    position: WirePosition | None = None
    pose: Annotated[list[Coordinate], Field(min_length=16, max_length=16)] | None = None
    pixel: Annotated[list[Coordinate], Field(min_length=2, max_length=2)] | None = None
    yaw_degrees: Annotated[float, Field(ge=-3600, le=3600, allow_inf_nan=False)] = 0.0
    anchor: Literal["base", "back", "top", "centre", "origin"] | None = None

    @model_validator(mode="after")
    def _check_one_of_each(self) -> "CompositeObject":
        if (self.object is None) == (self.shape is None):
            raise ValueError("must have either object or shape")
        if sum(place is not None for place in (self.position, self.pose, self.pixel)) != 1:
            raise ValueError("must have exactly one of position, pose and pixel")
        return self


class SessionScene(WireModel):
    """What people keep with a session: its title, and the objects that its viewers see in it; at most 16.

    Attributes:
        title: shown in place of the id; empty: the id.
        objects: with position or pose. A pixel belongs to one frame: send the pose of the composite's answer instead.
    """

    title: Annotated[str, StringConstraints(max_length=80, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    objects: Annotated[list[CompositeObject], Field(max_length=MAX_COMPOSITE_OBJECTS)] = Field(
        default_factory=list[CompositeObject]
    )

    @model_validator(mode="after")
    def _check_places(self) -> "SessionScene":
        if any(item.pixel is not None for item in self.objects):
            raise ValueError("objects of a scene must have position or pose: a pixel belongs to one frame")
        return self


class CompositeRequest(WireModel):
    """Request for the last processed frame with objects in it; 1 to 16 objects.

    Attributes:
        quality: preview, good or final.
        format: png and jpeg: 8-bit sRGB. exr: linear radiance. layers: a zip with the layers apart.
    """

    objects: Annotated[list[CompositeObject], Field(min_length=1, max_length=MAX_COMPOSITE_OBJECTS)]
    quality: CompositeQuality = "preview"
    format: CompositeFormat = "png"
