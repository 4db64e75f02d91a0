"""The engine: a stream of frames in, light at any point out.

Start at `session.Session`; everything else serves it. In the order in which a frame passes:

    session       frames in, light out; tracked probes
    preparation   the frame at working size, its depth completed, its clipped light restored (networks.clipping)
    room          what exists from the first frame on: lighting volume, keyframes, last mesh
    volume        the volume's grid and its initialisation from a frame, fusion, the SGLV and its ray tracing
    models        the lighting models: classical, and the paper's networks, single view or recurrent
    networks      ONNX graphs: loading, providers, the network for clipped light
    surface       the frame's textured mesh, keyframes, frames of other exposure
    probe         a tracked position: render, view, blend, lights
    panorama      a probe's panorama: blending, fill, lights from frame to frame, panels for networks
    observations  when one observation of a surface gives way to another
    state         sessions on disk
    kernels       compiled loops
    memory        bytes that a session takes

Units: metres; world y up; linear relative RGB (`roomlight.conventions`).
"""
