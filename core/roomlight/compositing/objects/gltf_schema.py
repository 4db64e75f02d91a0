"""The parts of glTF 2.0's JSON that are read, as strict types with bounds."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Index = Annotated[int, Field(ge=0, lt=1 << 31)]
Share = Annotated[float, Field(ge=0, le=1)]
Number = Annotated[float, Field(ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(ge=0, le=1e6)]


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


class Buffer(_Model):
    """Bytes: the GLB's own, or a data URI."""

    byteLength: Index  # noqa: N815  (glTF's spelling, here and below)
    uri: str | None = None


class BufferView(_Model):
    """A span of a buffer."""

    buffer: Index
    byteOffset: Index = 0  # noqa: N815
    byteLength: Annotated[int, Field(ge=1, lt=1 << 31)]  # noqa: N815
    byteStride: Annotated[int, Field(ge=4, le=252)] | None = None  # noqa: N815


class Accessor(_Model):
    """Typed values in a buffer view."""

    bufferView: Index | None = None  # noqa: N815
    byteOffset: Index = 0  # noqa: N815
    componentType: Literal[5120, 5121, 5122, 5123, 5125, 5126]  # noqa: N815
    count: Annotated[int, Field(ge=1, lt=1 << 31)]
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    normalized: bool = False
    sparse: Any = None


class Primitive(_Model):
    """Triangles of one material."""

    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: Annotated[int, Field(ge=0, le=6)] = 4


class Mesh(_Model):
    """Primitives that are placed together."""

    primitives: list[Primitive]


class Node(_Model):
    """A place in the scene."""

    children: list[Index] = []
    mesh: Index | None = None
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    translation: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    rotation: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Number, Number, Number] = (1.0, 1.0, 1.0)


class Scene(_Model):
    """Root nodes."""

    nodes: list[Index] = []


class TextureInfo(_Model):
    """Which texture, by which coordinates; scale is of normal textures alone."""

    index: Index
    texCoord: Index = 0  # noqa: N815
    scale: Annotated[float, Field(ge=-1e3, le=1e3)] = 1.0


class MetallicRoughness(_Model):
    """The base of every material."""

    baseColorFactor: tuple[Share, Share, Share, Share] = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    baseColorTexture: TextureInfo | None = None  # noqa: N815
    metallicFactor: Share = 1.0  # noqa: N815
    roughnessFactor: Share = 1.0  # noqa: N815
    metallicRoughnessTexture: TextureInfo | None = None  # noqa: N815


class Transmission(_Model):
    """KHR_materials_transmission."""

    transmissionFactor: Share = 0.0  # noqa: N815


class Ior(_Model):
    """KHR_materials_ior."""

    ior: Annotated[float, Field(ge=1, le=3)] = 1.5


class Specular(_Model):
    """KHR_materials_specular."""

    specularFactor: Share = 1.0  # noqa: N815


class EmissiveStrength(_Model):
    """KHR_materials_emissive_strength."""

    emissiveStrength: Positive = 1.0  # noqa: N815


class MaterialExtensions(_Model):
    """The extensions of materials that are read."""

    KHR_materials_transmission: Transmission = Transmission()
    KHR_materials_ior: Ior = Ior()
    KHR_materials_specular: Specular = Specular()
    KHR_materials_emissive_strength: EmissiveStrength = EmissiveStrength()


class GltfMaterial(_Model):
    """A material."""

    pbrMetallicRoughness: MetallicRoughness = MetallicRoughness()  # noqa: N815
    normalTexture: TextureInfo | None = None  # noqa: N815
    emissiveTexture: TextureInfo | None = None  # noqa: N815
    emissiveFactor: tuple[Share, Share, Share] = (0.0, 0.0, 0.0)  # noqa: N815
    alphaMode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"  # noqa: N815
    alphaCutoff: Share = 0.5  # noqa: N815
    extensions: MaterialExtensions = MaterialExtensions()


class GltfTexture(_Model):
    """An image and a sampler."""

    source: Index | None = None


class GltfImage(_Model):
    """A PNG or JPEG in a buffer view or a data URI."""

    uri: str | None = None
    bufferView: Index | None = None  # noqa: N815


class Asset(_Model):
    """The version."""

    version: str


class Gltf(_Model):
    """A glTF file."""

    asset: Asset
    scene: Index = 0
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    accessors: list[Accessor] = []
    bufferViews: list[BufferView] = []  # noqa: N815
    buffers: list[Buffer] = []
    materials: list[GltfMaterial] = []
    textures: list[GltfTexture] = []
    images: list[GltfImage] = []
    extensionsRequired: list[str] = []  # noqa: N815
