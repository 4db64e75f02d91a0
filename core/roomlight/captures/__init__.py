"""Recorded captures: readers that stream RGB-D frames with poses, and a writer.

Start at `open_capture` (`opening`), which detects the format by the files in the folder (`recognition`). Each format
has a module; `native` specifies RoomLight's own format and has its `CaptureWriter`. Every reader yields
`roomlight.frame.Frame` in RoomLight's conventions: world y up, camera x right, y up, z backward, camera-to-world,
metres.
"""

from roomlight.captures.capture import Capture, ProbeTruth, SkippedFrame
from roomlight.captures.formats.native import CaptureWriter
from roomlight.captures.opening import FORMATS, open_capture
from roomlight.captures.options import CaptureOptions

__all__ = [
    "FORMATS",
    "Capture",
    "CaptureOptions",
    "CaptureWriter",
    "ProbeTruth",
    "SkippedFrame",
    "open_capture",
]
