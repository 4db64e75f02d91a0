"""The engine: a stream of frames in, light at any point out.

Start at `session.Session`; everything else serves it. In the order in which a frame passes:

    session       frames in, light out; tracked probes
    preparation   the frame at working size, its depth completed, its clipped light restored (networks.clipping)
    session_view  a session after one frame, for points that are asked for while later frames arrive
    room          what exists from the first frame on: lighting volume, keyframes, last mesh; rooms that were left
    volume        the volume's grid and its initialisation from a frame, fusion, the SGLV and its ray tracing
    models        the lighting models: classical, and the paper's networks, single view or recurrent
    networks      ONNX graphs: loading, providers, the network for clipped light
    surface       the frame's textured mesh, keyframes, frames of other exposure, exposure that drifts
    probe         a tracked position: render, view, blend, lights
    panorama      a probe's panorama: blending, fill and prior of unseen light, lights from frame to frame, panels
    lighting      what lights a thing and what a mirror shows, of a probe's panorama, by a network
    observations  when one observation of a surface gives way to another
    state         sessions on disk
    kernels       compiled loops
    options       the options of a session
    memory        bytes that a session takes

Units: metres; world y up; linear relative RGB (`roomlight.conventions`).
"""
