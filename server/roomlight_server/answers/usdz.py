"""A USDZ package with a dome light: the light of a probe for tools that read Universal Scene Description.

A USDZ file is a zip archive without compression whose files begin at multiples of 64 bytes; its first file is the
stage (Pixar, Usdz File Format Specification). The texture of a dome light is equirectangular; its centre shows +z of
the light's own axes (UsdLuxDomeLight), while the centre of RoomLight's panoramas shows +x: the light is turned about y.
"""

import io
import zipfile
from typing import Final

from roomlight.light.light import Light

MEDIA_TYPE: Final = "model/vnd.usdz+zip"
_ALIGNMENT: Final = 64
_LOCAL_HEADER_BYTES: Final = 30
_EXTRA_HEADER_BYTES: Final = 4
_PADDING_ID: Final = 0x1986
"""Tag of the extra field that aligns a file; the one that Pixar's tools write."""
_STAGE: Final = """#usda 1.0
(
    defaultPrim = "Light"
    doc = "Image-based light at world position {position}, metres, y up; radiance 1 is white at the reference exposure"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Light"
{{
    def DomeLight "Room"
    {{
        float inputs:intensity = 1
        asset inputs:texture:file = @light.exr@
        token inputs:texture:format = "latlong"
        double xformOp:rotateY = 90
        uniform token[] xformOpOrder = ["xformOp:rotateY"]
    }}
}}
"""


def to_usdz(light: Light) -> bytes:
    """Return a package with a stage of one dome light, textured by the light's panorama as EXR."""
    x, y, z = light.position
    stage = _STAGE.format(position=f"({x:.4g}, {y:.4g}, {z:.4g})").encode()
    return _package({"light.usda": stage, "light.exr": light.file("exr")})


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
