"""Read the materials of an OBJ (MTL) and their textures, which lie beside it.

Colours are sRGB, as viewers take them; Blender's are linear, its pictures replace them, and `Ka` of its metals (`illum`
3 and 6) is how metallic they are. Shininess becomes roughness as Blender writes it, Ns = 1000 (1 - roughness)^2;
`Pr` and `Pm` (Wavefront's extension for physically based materials) count instead where they are stated; `Pc` and `Pcr`
are a clear coat.
"""

import io
import math
import re
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.limits import ObjectLimits, plain_text, statement
from roomlight.compositing.objects.materials import Colour, Material, colour_of
from roomlight.compositing.objects.pictures import PictureReader
from roomlight.compositing.objects.textures import Texture
from roomlight.conventions import srgb_to_linear
from roomlight.errors import ObjectError
from roomlight.imaging.tags import profile_to_srgb8
from roomlight.notes import Note

_VALUES: Final = {"kd": 3, "ks": 3, "ke": 3, "ns": 1, "ni": 1, "d": 1, "tr": 1, "pr": 1, "pm": 1, "pc": 1, "pcr": 1}
_PICTURES: Final = ("map_kd", "map_ke", "map_d")
_LEFT_OUT: Final = {
    **dict.fromkeys(("map_bump", "bump", "norm", "disp", "map_disp"), "relief"),
    **dict.fromkeys(("map_ks", "map_ns", "map_pr", "map_pm", "refl"), "textures of gloss, metal and reflection"),
    **dict.fromkeys(("ps", "aniso", "map_pc", "map_ps"), "sheen, brushed metal and textures of the clear coat"),
    "tf": "coloured glass",
}
_DEFAULTS: Final = {"ps": 0, "aniso": 0, "tf": 1}
"""Values with which these keys change nothing; `anisor` only says how."""
_MOVED: Final = re.compile(
    r"(?:^| )-(?:s(?: +1(?:\.0*)?)*(?= +-?[\d.])(?! +1(?:\.0*)?(?: |$))|o(?: +-?[0.]+)* +-?[0.]*[1-9]|clamp +on)"
)
"""Options of a texture that change something: a scale other than 1, an offset other than 0."""

_NUMBER: Final = r"\s+[-+]?[\d.,]+(?:e[-+]?\d+)?(?=\s)"
_OPTION: Final = re.compile(
    rf"-(?:(?:imfchan|type|colorspace)\s+\S+|mm(?:{_NUMBER}){{0,2}}|[ost](?:{_NUMBER}){{0,3}}"
    rf"|\w+(?:\s+(?:on|off)(?=\s)|{_NUMBER})?)\s+(?=\S)",
    re.IGNORECASE,
)
"""An option of a texture with its own values; what follows may begin with a number too."""
_OF_BLENDER: Final = re.compile(rb"\s*# *Blender\b.*\bMTL File\b", re.IGNORECASE)
_METAL: Final = ("3", "6")
_UNREAD: Final = re.compile(r"(?:^| )-(?:imfchan|type|colorspace(?! +srgb)) ", re.IGNORECASE)
_GAIN: Final = re.compile(r"(?:^| )-mm +(?!0(?:\.0*)? +1(?:\.0*)?(?: |$))")


@dataclass
class _Stated:
    """The lines of a material; `metallic` is Blender's."""

    of_blender: bool = False
    illum: str = ""
    metallic: float = 0.0
    values: dict[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    pictures: dict[str, str] = field(default_factory=dict[str, str])


class MtlReader:
    """Reads one object's materials; textures are decoded once. `missing`: a library was not there."""

    def __init__(self, beside: FilesBeside, limits: ObjectLimits, name: str) -> None:
        self._beside, self._limits, self._name = beside, limits, name
        self._reader = PictureReader(limits)
        self._pictures: dict[str, UInt8[np.ndarray, "h w c"] | None] = {}
        self._left_out: set[str] = set()
        self.notes: list[Note] = []
        self.missing = False

    def materials(self, library: str) -> dict[str, Material]:
        """Return a library's materials by name. One that is missing is noted; damage raises ObjectError."""
        label = f"{self._name}: its materials in {library[:60]}"
        try:
            data = self._read(library, label)
        except ObjectError as error:
            self.missing = True
            self.notes.append(Note(str(error), "the object is grey", "put it beside the object"))
            return {}
        stated = self._stated(plain_text(data))
        self._limits.check("materials", len(stated), label)
        materials = {name: self._material(lines, f"{label}: {name[:60]}") for name, lines in stated.items()}
        self.notes.extend(
            Note(f"{label}: {kind}", "it is missing", "export as GLB if it matters") for kind in sorted(self._left_out)
        )
        return materials

    def _read(self, stated: str, label: str) -> bytes:
        """Return the content of a file that lies here under its name, or under the last part of its address."""
        name = self._beside.near(stated) or stated
        if re.search(r"[/\\]", stated) and not re.search(r"[/\\]", name):
            left_out = f"{label}: its address {stated[:60]!r}"
            effect = "the file of this name beside it is read"
            self.notes.append(Note(left_out, effect, "nothing to do if it is that"))
        return self._beside.read(name, label)

    def _stated(self, text: bytes) -> dict[str, _Stated]:
        materials: dict[str, _Stated] = {}
        of_blender = _OF_BLENDER.match(text) is not None
        current = _Stated()
        for raw in text.splitlines():
            key, rest = statement(raw)
            if key != "newmtl" and not key.startswith("map_"):  # names may hold `#`, as 3ds Max's do
                rest = rest.partition("#")[0].strip()
            if key == "newmtl":
                current = materials.setdefault(rest, _Stated(of_blender))
            elif key in _VALUES:
                numbers = finite_numbers(rest.removeprefix("-halo").split()[: _VALUES[key]])
                if numbers:
                    stated = numbers if len(numbers) == _VALUES[key] else numbers[:1] * _VALUES[key]
                    current.values[key] = self._in_range(key, stated)
                else:
                    self._left_out.add(f"the line {raw.strip()[:60].decode('utf-8', 'replace')!r}")
            elif key in _PICTURES:
                rest = rest.replace("\t", " ")
                current.pictures[key] = file_of_map(rest)
                options = rest[: rest.rfind(current.pictures[key])]
                if _MOVED.search(options):
                    self._left_out.add("scale, offset and clamping of textures (-s, -o, -clamp)")
                if _UNREAD.search(options):
                    self._left_out.add("channel, kind and colour space of textures (-imfchan, -type, -colorspace)")
                if _GAIN.search(options):
                    self._left_out.add("brightness and contrast of textures (-mm)")
            elif key in _LEFT_OUT:
                if key in _DEFAULTS and set(finite_numbers(rest.split())) == {_DEFAULTS[key]}:
                    continue
                self._left_out.add(_LEFT_OUT[key])
            elif key == "map_ka":
                current.pictures[key] = rest
            elif (key.startswith("map_") and key != "map_aat") or key == "decal":
                self._left_out.add(f"the texture {key[:40]}")
            elif key == "ka" and of_blender:
                current.metallic = float(np.mean(finite_numbers(rest.split()) or (0.0,)))
            elif key == "illum":
                current.illum = rest
                if rest == "0":
                    self._left_out.add("light that does not shade it (illum 0)")
        return materials

    def _in_range(self, key: str, values: tuple[float, ...]) -> tuple[float, ...]:
        """Return a colour from 0 to 1: larger ones are of 255, or too large; emission may be."""
        if key not in ("kd", "ks") or max(values) <= 1:
            return values
        whole = 255.0 if max(values) > 2 else 1.0
        left_out = f"{self._name}: {key.capitalize()} of {max(values):g} in its materials"
        self.notes.append(Note(left_out, "it is read as of 255" if whole > 1 else "it is read as 1", "write 0 to 1"))
        return tuple(min(value / whole, 1.0) for value in values)

    def _material(self, stated: _Stated, label: str) -> Material:
        def share(key: str, default: float) -> float:
            return min(max(stated.values.get(key, (default,))[0], 0.0), 1.0)

        base = self._picture(stated, "map_kd", label)
        glow = self._picture(stated, "map_ke", label)
        kd, ke = (stated.values.get(key, default) for key, default in (("kd", (0.8,) * 3), ("ke", (0.0,) * 3)))
        if base is not None and (stated.of_blender or "kd" not in stated.values or max(kd) <= 0):
            kd = (1.0,) * 3  # exporters write black beside a texture, Blender 0.8
        if glow is not None and (stated.of_blender or "ke" not in stated.values):
            ke = (1.0,) * 3
        if "map_ka" in stated.pictures and base is None:  # beside the other it is the same
            self._left_out.add("the texture map_ka")
        cut_out = "map_d" in stated.pictures
        if cut_out and stated.pictures["map_d"] != stated.pictures.get("map_kd"):
            self._left_out.add("a texture of opacity")
            cut_out = False
        transparent = share("tr", 0.0)
        if transparent == 1 and "d" not in stated.values:  # old MeshLab and OpenMVS write so what is opaque
            effect = "it is read as opaque"
            self.notes.append(Note(f"{self._name}: Tr of 1 in its materials", effect, "write d 0 if it is invisible"))
            transparent = 0.0
        ior = stated.values.get("ni", (1.5,))[0]
        shininess = min(max(stated.values.get("ns", (0.0,))[0], 0.0), 1000.0)
        return Material(
            base_colour=_linear(kd, is_linear=stated.of_blender),
            metallic=share("pm", stated.metallic if stated.illum in _METAL else 0.0),
            roughness=share("pr", 1 - math.sqrt(shininess / 1000)),
            specular=1.0 if "pr" in stated.values else min(2 * float(np.mean(stated.values.get("ks", (0.0,)))), 1.0),
            ior=ior if 1.05 < ior <= 3 else 1.5,
            opacity=share("d", 1 - transparent),
            alpha_cutoff=0.5 if cut_out else None,
            clearcoat=share("pc", 0.0),
            clearcoat_roughness=share("pcr", 0.0),
            emissive=_linear(ke, most=1e6, is_linear=stated.of_blender),
            base_colour_texture=None if base is None else Texture.from_srgb8(base if cut_out else base[..., :3]),
            emissive_texture=None if glow is None else Texture.from_srgb8(glow[..., :3]),
        )

    def _picture(self, stated: _Stated, key: str, label: str) -> UInt8[np.ndarray, "h w c"] | None:
        name = stated.pictures.get(key)
        if name is None:
            return None
        if name not in self._pictures:
            where = f"{label}, {key}"
            self._limits.check("images", len(self._pictures) + 1, self._name)
            self._pictures[name], advice = None, "put it beside the object"
            try:
                data = self._read(name, where)
                advice = "save it as PNG"
                self._pictures[name] = self._decoded(data, where, name.lower())
            except ObjectError as error:
                self.notes.append(Note(str(error), "its colour alone is used", advice))
        return self._pictures[name]

    def _decoded(self, data: bytes, where: str, name: str) -> UInt8[np.ndarray, "h w c"]:
        """Decode a picture to sRGB by its colour profile. Nothing but its name tells TGA."""
        pixels = self._reader.read(data, where, more=("BMP", "GIF", "TIFF", *(("TGA",) if name[-4:] == ".tga" else ())))
        with Image.open(io.BytesIO(data)) as image:
            profile = image.info.get("icc_profile")
        if profile:
            converted, notes = profile_to_srgb8(np.ascontiguousarray(pixels[..., :3]), profile, where)
            self.notes.extend(notes)
            pixels = pixels if converted is None else np.concatenate([converted, pixels[..., 3:]], axis=-1)
        return pixels


def file_of_map(rest: str) -> str:
    """Return the file of a map line: options such as `-s 1 1 1` may precede it, and it may hold spaces."""
    start = 0
    while option := _OPTION.match(rest, start):
        start = option.end()
    return rest[start:].strip('"')


def finite_numbers(words: list[str]) -> tuple[float, ...]:
    """Return the numbers that words state, none if one of them is no finite number; a comma is a decimal point."""
    try:
        numbers = tuple(float(word.replace(",", ".")) for word in words)
    except ValueError:
        return ()
    return numbers if all(math.isfinite(number) for number in numbers) else ()


def _linear(colour: tuple[float, ...], most: float = 1.0, *, is_linear: bool = False) -> Colour:
    """Decode sRGB; a colour whose largest value is above 1 is that many times as bright."""
    values = np.clip(np.array(colour, np.float64), 0, most)
    if is_linear:
        return colour_of(values)
    times = max(float(values.max()), 1.0)
    return colour_of(times * srgb_to_linear(values / times))
