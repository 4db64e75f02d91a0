"""Every format's builder, by the name of its layout."""

import formats
import tool_formats

BUILDERS = {
    "nerfstudio": formats.nerfstudio,
    "nerfcapture": formats.nerfcapture,
    "seven-scenes": formats.seven_scenes,
    "stray-scanner": formats.stray_scanner,
    "record3d": formats.record3d,
    "record3d-export": formats.record3d_export,
    "tum": formats.tum,
    "roomlight": formats.roomlight,
    "polycam": formats.polycam,
    "3d-scanner-app": formats.scanner_app,
    "arkitscenes": formats.arkit_scenes,
    "scannet": formats.scannet,
    "scannet-frames": tool_formats.scannet_frames,
    "scannetpp": tool_formats.scannetpp,
    "rtabmap": tool_formats.rtabmap,
    "ros-bag": tool_formats.ros_bag,
    "colmap": formats.colmap,
    "colmap-text": formats.colmap_text,
}
_LAYOUTS = {
    "nerfcapture": "nerfstudio",
    "record3d-export": "record3d",
    "scannet-frames": "scannet",
    "colmap-text": "colmap",
}
FORMAT_OF = {name: _LAYOUTS.get(name, name) for name in BUILDERS}
