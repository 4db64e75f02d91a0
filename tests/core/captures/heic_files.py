"""HEIC files built from boxes (ISO/IEC 14496-12, 23008-12): a colour picture and the depth map of a portrait.

Only the HEVC pictures come from an encoder; items, properties and references are written here.
"""

import io
import struct
from collections.abc import Iterator

import numpy as np
import pillow_heif
from PIL import Image


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def full_box(kind: bytes, *parts: bytes, version: int = 0, flags: int = 0) -> bytes:
    return box(kind, struct.pack(">I", version << 24 | flags), *parts)


def boxes(data: bytes) -> Iterator[tuple[bytes, bytes, bytes]]:
    """Kind, body and all bytes of the boxes in a row."""
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        yield kind, data[at + 8 : at + size], data[at : at + size]
        at += size


def encoded(pixels: np.ndarray) -> tuple[list[bytes], bytes]:
    """The properties (hvcC, ispe, pixi) and the HEVC data of a picture."""
    stream = io.BytesIO()
    options = {"quality": 95, "chroma": 444} if pixels.ndim == 3 else {"quality": 95}
    pillow_heif.from_pillow(Image.fromarray(pixels)).save(stream, **options)
    tree = {kind: body for kind, body, _ in boxes(stream.getvalue())}
    meta = {kind: body for kind, body, _ in boxes(tree[b"meta"][4:])}
    properties = {kind: body for kind, body, _ in boxes(meta[b"iprp"])}
    kept = [whole for kind, _, whole in boxes(properties[b"ipco"]) if kind in (b"hvcC", b"ispe", b"pixi", b"clap")]
    return kept, tree[b"mdat"]


def portrait(
    srgb8: np.ndarray,
    disparity8: np.ndarray | None,
    *,
    xmp: str = "",
    sei: tuple[float, float] | None = None,
    more: tuple[bytes, ...] = (),
) -> bytes:
    """A photo with an auxiliary image of disparity; `more` are properties of both, such as irot and of colour colr."""
    colour_properties, colour = encoded(srgb8)
    items = [(1, b"hvc1", b"", [*colour_properties, *more], colour)]
    references = b""
    if disparity8 is not None:
        depth_properties, depth = encoded(disparity8)
        kind = full_box(b"auxC", b"urn:mpeg:hevc:2015:auxid:2\0", b"" if sei is None else depth_sei(*sei))
        rotation = [part for part in more if part[4:8] == b"irot"]
        items.append((2, b"hvc1", b"", [*depth_properties, kind, *rotation], depth))
        references += box(b"auxl", struct.pack(">HHH", 2, 1, 1))
    if xmp:
        items.append((3, b"mime", b"application/rdf+xml\0", [], xmp.encode()))
        references += box(b"cdsc", struct.pack(">HHH", 3, 1, 2))
    return written(items, references)


def written(items: list[tuple[int, bytes, bytes, list[bytes], bytes]], references: bytes) -> bytes:
    entries = [
        full_box(b"infe", struct.pack(">HH4s", number, 0, kind), b"\0", content, version=2)
        for number, kind, content, _, _ in items
    ]
    properties = [part for _, _, _, own, _ in items for part in own]
    associations, first = b"", 1
    for number, _, _, own, _ in items:
        if own:
            associations += struct.pack(">HB", number, len(own)) + bytes(
                (0x80 if part[4:8] in (b"hvcC", b"irot", b"clap") else 0) | first + at for at, part in enumerate(own)
            )
            first += len(own)
    count = struct.pack(">I", sum(bool(own) for _, _, _, own, _ in items))
    ends = np.cumsum([len(data) for *_, data in items])

    def meta(start: int) -> bytes:
        offsets = [start + int(end) - len(item[4]) for end, item in zip(ends, items, strict=True)]
        places = b"".join(
            struct.pack(">HHHII", item[0], 0, 1, offset, len(item[4]))
            for item, offset in zip(items, offsets, strict=True)
        )
        return full_box(
            b"meta",
            full_box(b"hdlr", struct.pack(">I4s12s", 0, b"pict", b""), b"\0"),
            full_box(b"pitm", struct.pack(">H", 1)),
            full_box(b"iinf", struct.pack(">H", len(items)), *entries),
            full_box(b"iref", references) if references else b"",
            box(b"iprp", box(b"ipco", *properties), full_box(b"ipma", count, associations)),
            full_box(b"iloc", b"\x44\x00", struct.pack(">H", len(items)), places),
        )

    head = box(b"ftyp", b"heic", struct.pack(">I", 0), b"mif1heic")
    start = len(head) + len(meta(0)) + 8
    return head + meta(start) + box(b"mdat", *[data for *_, data in items])


def depth_sei(low: float, high: float) -> bytes:
    """Depth representation information (ISO/IEC 23008-2, D.2.25): uniform disparity between two values."""
    bits = "0011"  # no z_near, no z_far, d_min, d_max
    bits += "010"  # depth_representation_type 1, ue(v)
    bits += "1"  # disparity_ref_view_id 0, ue(v)
    for value in (low, high):
        mantissa, exponent = np.frexp(value)
        fraction = round((float(mantissa) * 2 - 1) * 2**32)
        bits += "0" + f"{int(exponent) - 1 + 31:07b}" + f"{31:05b}" + f"{fraction:032b}"
    bits += "1" + "0" * (-(len(bits) + 1) % 8)
    payload = bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))
    message = bytes([39 << 1, 1, 177, len(payload)]) + payload
    return struct.pack(">II", 4 + len(message), len(message)) + message


APPLE_XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    "<rdf:Description><apdi:FloatMinValue>{low}</apdi:FloatMinValue><apdi:FloatMaxValue>{high}</apdi:FloatMaxValue>"
    "<apdi:AuxiliaryImageType>disparity</apdi:AuxiliaryImageType>"
    "<depthData:Accuracy>{accuracy}</depthData:Accuracy>"
    "<depthData:IntrinsicMatrixReferenceWidth>4032</depthData:IntrinsicMatrixReferenceWidth>"
    "<depthData:IntrinsicMatrixReferenceHeight>3024</depthData:IntrinsicMatrixReferenceHeight>"
    "<depthData:IntrinsicMatrix><rdf:Seq><rdf:li>{focal}</rdf:li><rdf:li>0</rdf:li></rdf:Seq>"
    "</depthData:IntrinsicMatrix></rdf:Description></rdf:RDF></x:xmpmeta>"
)
