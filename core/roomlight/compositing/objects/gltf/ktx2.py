"""KTX2 images that Basis Universal has compressed (KHR_texture_basisu), by the extra `ktx2`."""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8

from roomlight.errors import ObjectError

KTX2: Final = b"\xabKTX 20\xbb"
"""The first bytes of a file."""
_MODULE: Final = "opengl_basisu"


def ktx2_available() -> bool:
    """Return whether Basis Universal can be decoded (the extra `ktx2` is installed)."""
    return importlib.util.find_spec(_MODULE) is not None


def decode_ktx2(data: bytes, label: str, check: Callable[[int, int], None]) -> UInt8[np.ndarray, "h w 4"] | None:
    """Return the pixels of a file's largest level; None without the extra, and of files that hold other data.

    Args:
        label: Begins every message.
        check: Receives width and height before anything is decoded; raises where they pass a limit.

    Raises:
        ObjectError: The file is damaged.
    """
    if not ktx2_available():
        return None
    library: Any = importlib.import_module(_MODULE)
    try:
        texture = library.open(data)
        size = int(texture.width), int(texture.height)
    except library.UnsupportedError:
        return None
    except Exception as error:  # the binding raises whatever damaged bytes lead to
        raise ObjectError(f"{label}: its KTX2 data is damaged ({str(error)[:80]})") from error
    check(*size)
    try:
        return np.array(texture.transcode(library.Target.RGBA8).data)
    except Exception as error:  # as above
        raise ObjectError(f"{label}: its KTX2 data is damaged ({str(error)[:80]})") from error
