"""The parts of glTF 2.0's JSON that are read, as types with bounds.

Exporters write whole numbers as 36.0, null for what they leave out, and factors above 1; what has one meaning is read.
Factors that glTF limits to 0 to 1 are clamped, with a note in the validation's context.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator


def _clamped(value: Any, info: Any) -> Any:
    if isinstance(value, int | float) and not 0 <= value <= 1 and isinstance(info.context, list):
        info.context.append(f"{info.field_name} of {value:.4g}")
        return min(max(float(value), 0.0), 1.0) if value == value else value
    return value


def _with_alpha(value: Any) -> Any:
    return [*value, 1.0] if isinstance(value, list) and len(value) == 3 else value


def _upper(value: Any) -> Any:
    return value.upper() if isinstance(value, str) else value


Index = Annotated[int, Field(ge=0, lt=1 << 31)]
Share = Annotated[float, BeforeValidator(_clamped), Field(ge=0, le=1)]
Number = Annotated[float, Field(ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(ge=0, le=1e6)]
Three = tuple[Number, Number, Number]
Tint = Annotated[tuple[Share, Share, Share, Share], BeforeValidator(_with_alpha)]


class _Model(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False, frozen=True)
    extensions: dict[str, Any] = {}

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, values: Any) -> Any:
        return (
            {key: value for key, value in values.items() if value is not None} if isinstance(values, dict) else values
        )


class Buffer(_Model):
    """Bytes: the GLB's own, or a data URI."""

    byteLength: Index  # noqa: N815  (glTF's spelling, here and below)
    uri: str | None = None


class BufferView(_Model):
    """A span of a buffer."""

    buffer: Index
    byteOffset: Index = 0  # noqa: N815
    byteLength: Index  # noqa: N815
    byteStride: Annotated[int, Field(ge=0, le=252)] | None = None  # noqa: N815


class SparseIndices(_Model):
    """Which values of a sparse accessor are replaced."""

    bufferView: Index  # noqa: N815
    byteOffset: Index = 0  # noqa: N815
    componentType: Literal[5121, 5123, 5125]  # noqa: N815


class SparseValues(_Model):
    """What they are replaced by."""

    bufferView: Index  # noqa: N815
    byteOffset: Index = 0  # noqa: N815


class Sparse(_Model):
    """Replaced values of an accessor."""

    count: Index
    indices: SparseIndices
    values: SparseValues


class Accessor(_Model):
    """Typed values in a buffer view."""

    bufferView: Index | None = None  # noqa: N815
    byteOffset: Index = 0  # noqa: N815
    componentType: Literal[5120, 5121, 5122, 5123, 5125, 5126]  # noqa: N815
    count: Index
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    normalized: bool = False
    sparse: Sparse | None = None


class Primitive(_Model):
    """Triangles of one material."""

    attributes: dict[str, Index] = {}
    indices: Index | None = None
    material: Annotated[int, Field(ge=-1, lt=1 << 31)] = -1
    mode: Annotated[int, Field(ge=0, le=6)] = 4
    targets: list[dict[str, Index]] = []


class Mesh(_Model):
    """Primitives that are placed together."""

    primitives: list[Primitive] = []
    weights: list[Number] = []


class Skin(_Model):
    """Joints that move vertices."""

    joints: list[Index]
    inverseBindMatrices: Index | None = None  # noqa: N815


class Instancing(_Model):
    """EXT_mesh_gpu_instancing."""

    attributes: dict[str, Index] = {}


class Node(_Model):
    """A place in the scene."""

    children: list[Index] = []
    mesh: Index | None = None
    skin: Index | None = None
    weights: list[Number] = []
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    translation: Three = (0.0, 0.0, 0.0)
    rotation: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    scale: Three = (1.0, 1.0, 1.0)


class Scene(_Model):
    """Root nodes."""

    nodes: list[Index] = []


class TextureTransform(_Model):
    """KHR_texture_transform."""

    offset: tuple[Number, Number] = (0.0, 0.0)
    rotation: Number = 0.0
    scale: tuple[Number, Number] = (1.0, 1.0)
    texCoord: Index | None = None  # noqa: N815


class TextureInfo(_Model):
    """Which texture, by which coordinates; scale is of normal textures alone."""

    index: Index
    texCoord: Index = 0  # noqa: N815
    scale: Annotated[float, Field(ge=-1e3, le=1e3)] = 1.0


class MetallicRoughness(_Model):
    """The base of every material."""

    baseColorFactor: Tint = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    baseColorTexture: TextureInfo | None = None  # noqa: N815
    metallicFactor: Share = 1.0  # noqa: N815
    roughnessFactor: Share = 1.0  # noqa: N815
    metallicRoughnessTexture: TextureInfo | None = None  # noqa: N815


class SpecularGlossiness(_Model):
    """KHR_materials_pbrSpecularGlossiness."""

    diffuseFactor: Tint = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    diffuseTexture: TextureInfo | None = None  # noqa: N815
    specularFactor: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)  # noqa: N815
    glossinessFactor: Share = 1.0  # noqa: N815
    specularGlossinessTexture: TextureInfo | None = None  # noqa: N815


class Transmission(_Model):
    """KHR_materials_transmission."""

    transmissionFactor: Share = 0.0  # noqa: N815
    transmissionTexture: TextureInfo | None = None  # noqa: N815


class Volume(_Model):
    """KHR_materials_volume; no distance attenuates nothing."""

    thicknessFactor: Positive = 0.0  # noqa: N815
    thicknessTexture: TextureInfo | None = None  # noqa: N815
    attenuationDistance: Annotated[float, Field(ge=0)] = 0.0  # noqa: N815
    attenuationColor: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)  # noqa: N815


class Ior(_Model):
    """KHR_materials_ior; 0 reflects everything."""

    ior: Positive = 1.5


class Specular(_Model):
    """KHR_materials_specular."""

    specularFactor: Share = 1.0  # noqa: N815
    specularTexture: TextureInfo | None = None  # noqa: N815
    specularColorFactor: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)  # noqa: N815
    specularColorTexture: TextureInfo | None = None  # noqa: N815


class Clearcoat(_Model):
    """KHR_materials_clearcoat."""

    clearcoatFactor: Share = 0.0  # noqa: N815
    clearcoatTexture: TextureInfo | None = None  # noqa: N815
    clearcoatRoughnessFactor: Share = 0.0  # noqa: N815
    clearcoatRoughnessTexture: TextureInfo | None = None  # noqa: N815
    clearcoatNormalTexture: TextureInfo | None = None  # noqa: N815


class Sheen(_Model):
    """KHR_materials_sheen."""

    sheenColorFactor: tuple[Share, Share, Share] = (0.0, 0.0, 0.0)  # noqa: N815
    sheenColorTexture: TextureInfo | None = None  # noqa: N815
    sheenRoughnessFactor: Share = 0.0  # noqa: N815
    sheenRoughnessTexture: TextureInfo | None = None  # noqa: N815


class EmissiveStrength(_Model):
    """KHR_materials_emissive_strength."""

    emissiveStrength: Positive = 1.0  # noqa: N815


class GltfMaterial(_Model):
    """A material."""

    pbrMetallicRoughness: MetallicRoughness = MetallicRoughness()  # noqa: N815
    normalTexture: TextureInfo | None = None  # noqa: N815
    occlusionTexture: TextureInfo | None = None  # noqa: N815
    emissiveTexture: TextureInfo | None = None  # noqa: N815
    emissiveFactor: tuple[Positive, Positive, Positive] = (0.0, 0.0, 0.0)  # noqa: N815
    alphaMode: Annotated[Literal["OPAQUE", "MASK", "BLEND"], BeforeValidator(_upper)] = "OPAQUE"  # noqa: N815
    alphaCutoff: Positive = 0.5  # noqa: N815
    doubleSided: bool = False  # noqa: N815


class Sampler(_Model):
    """How a texture goes on outside [0, 1], and looks from near."""

    wrapS: int = 10497  # noqa: N815
    wrapT: int = 10497  # noqa: N815
    magFilter: Any = None  # noqa: N815


class GltfTexture(_Model):
    """An image and a sampler."""

    source: Index | None = None
    sampler: Index | None = None


class GltfImage(_Model):
    """A picture in a buffer view or a data URI."""

    uri: str | None = None
    bufferView: Index | None = None  # noqa: N815


class Asset(_Model):
    """The version."""

    version: Annotated[str, BeforeValidator(lambda value: str(value) if isinstance(value, int | float) else value)] = (
        "2.0"
    )


class Gltf(_Model):
    """A glTF file."""

    asset: Asset = Asset()
    scene: Index = 0
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    skins: list[Skin] = []
    accessors: list[Accessor] = []
    bufferViews: list[BufferView] = []  # noqa: N815
    buffers: list[Buffer] = []
    materials: list[GltfMaterial] = []
    textures: list[GltfTexture] = []
    samplers: list[Sampler] = []
    images: list[GltfImage] = []
    animations: list[Any] = []
    extensionsRequired: list[str] = []  # noqa: N815
    extensionsUsed: list[str] = []  # noqa: N815
