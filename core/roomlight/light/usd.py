"""Universal Scene Description: light as a package (USDZ), and a replay's panoramas as a stage (USDA).

A dome light's texture shows +z of the light's own axes in its centre and +x left of it (UsdLuxDomeLight, after
OpenEXR's latitude-longitude maps). The centre of RoomLight's panoramas shows the world's +x: the dome is turned by 90
degrees about y. A distant light shines along its -z; with `normalize` its intensity is the irradiance on a surface that
faces it, whatever its angle (UsdLuxDistantLight).

A USDZ file is a zip archive without compression whose files begin at multiples of 64 bytes; its first file is the
stage (Pixar, Usdz File Format Specification).
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.imaging.rates import exact_rate
from roomlight.light.encode import to_exr
from roomlight.light.main_light import MainLight, without_lights

_ALIGNMENT: Final = 64
_LOCAL_HEADER_BYTES: Final = 30
_EXTRA_HEADER_BYTES: Final = 4
_PADDING_ID: Final = 0x1986
"""Tag of the extra field that aligns a file; the one that Pixar's tools write."""
_UNIT: Final = "metres, y up; radiance 1 is white at the reference exposure"
_STAGE: Final = """#usda 1.0
(
    defaultPrim = "Light"
    doc = "{doc}"
{time}    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Light"{variants}
{{
    def DomeLight "Room"
    {{
        float inputs:intensity = 1
{texture}        token inputs:texture:format = "latlong"
        double xformOp:rotateY = 90
        uniform token[] xformOpOrder = ["xformOp:rotateY"]
    }}
{choices}}}
"""
_VARIANTS: Final = """ (
    prepend variantSets = "lights"
    variants = {
        string lights = "inDome"
    }
)"""
_CHOICES: Final = """
    variantSet "lights" = {{
        "inDome" {{
            over "Room"
            {{
                asset inputs:texture:file = @light.exr@
            }}
        }}
        "separate" {{
            over "Room"
            {{
                asset inputs:texture:file = @ambient.exr@
            }}
{distant}        }}
    }}
"""
_DISTANT: Final = """
            def DistantLight "Light{number}"
            {{
                float inputs:angle = {angle:.6g}
                color3f inputs:color = ({color})
                float inputs:intensity = {intensity:.9g}
                bool inputs:normalize = 1
                quatf xformOp:orient = ({orient})
                uniform token[] xformOpOrder = ["xformOp:orient"]
            }}
"""


def to_usdz(
    position: Position,
    panorama: Float[np.ndarray, "h w 3"],
    lights: Sequence[MainLight],
    *,
    metadata: dict[str, str] | None = None,
) -> bytes:
    """Return a package with a dome light, and the lights as a choice.

    The variant set `lights` has `inDome` (selected): the dome holds all light. In `separate` lamps and windows are
    distant lights and the dome is the rest, for renderers whose domes cast no shadows. Both shed the same light.

    Args:
        position: world metres.
        panorama: linear RGB [H, 2H, 3].
        lights: its lights; without any there is no choice.
        metadata: of the EXR files.
    """
    rest, lights = without_lights(panorama, lights)
    doc = _doc(position)
    whole = to_exr(panorama, metadata=metadata)
    if not lights:
        texture = "        asset inputs:texture:file = @light.exr@\n"
        stage = _STAGE.format(doc=doc, time="", variants="", texture=texture, choices="")
        return _package({"light.usda": stage.encode(), "light.exr": whole})
    choices = _CHOICES.format(distant="".join(_distant(number, light) for number, light in enumerate(lights)))
    stage = _STAGE.format(doc=doc, time="", variants=_VARIANTS, texture="", choices=choices)
    files = {"light.exr": whole, "ambient.exr": to_exr(rest, metadata=metadata)}
    return _package({"light.usda": stage.encode()} | files)


def sequence_stage(position: Position, files: Mapping[int, str], frames_per_second: float) -> str:
    """Return a stage whose dome light shows a panorama file at each frame, until the next; the last without a time.

    Args:
        position: world metres.
        files: names of panoramas beside the stage, by frame; at least one.
        frames_per_second: rate at which frames count.
    """
    samples = "".join(f"            {frame}: @./{name}@,\n" for frame, name in sorted(files.items()))
    rate = f"{float(exact_rate(frames_per_second)):.16g}"
    return _STAGE.format(
        doc=_doc(position),
        time=f"    startTimeCode = {min(files)}\n    endTimeCode = {max(files)}\n"
        f"    timeCodesPerSecond = {rate}\n    framesPerSecond = {rate}\n",
        variants="",
        texture=f"        asset inputs:texture:file = @./{files[max(files)]}@\n"
        f"        asset inputs:texture:file.timeSamples = {{\n{samples}        }}\n",
        choices="",
    )


def _doc(position: Position) -> str:
    x, y, z = position
    return f"Image-based light at world position ({x:.4g}, {y:.4g}, {z:.4g}), {_UNIT}"


def _distant(number: int, light: MainLight) -> str:
    strongest = float(light.intensity.max())
    x, y, z, w = light.quaternion
    return _DISTANT.format(
        number=number,
        angle=2 * light.radius_deg,
        color=", ".join(f"{part:.9g}" for part in (light.intensity / strongest).tolist()),
        intensity=strongest,
        orient=", ".join(f"{part:.9g}" for part in (w, x, y, z)),
    )


def _package(files: dict[str, bytes]) -> bytes:
    """Return a zip archive without compression whose files begin at multiples of 64 bytes."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name)  # of 1980, so that equal light gives equal bytes
            start = packed.tell() + _LOCAL_HEADER_BYTES + len(name.encode()) + _EXTRA_HEADER_BYTES
            padding = -start % _ALIGNMENT
            info.extra = _PADDING_ID.to_bytes(2, "little") + padding.to_bytes(2, "little") + bytes(padding)
            archive.writestr(info, data)
    return packed.getvalue()
