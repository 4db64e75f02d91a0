"""The engine: a stream of frames in, light at any point out.

Start at `session.Session`; everything else serves it. Modules in the order in which a frame passes them:

    session            frames in, light out; tracked probes
    clipping           radiance of clipped pixels
    volume             the lighting volume's frame, and its initialisation from one frame
    backend            what a lighting model does for a session (an interface)
    classical_backend  the model without networks; fusion averages the frames' volumes
    network_backend    the model on ONNX graphs; graphs and providers load and run them, runtime imports ONNX Runtime
    sglv               the spherical Gaussian lighting volume, and its ray tracing at a point
    mesh               the frame's depth as a textured mesh, and its panorama at a point
    blend              a probe's panorama: how a frame's details enter it; fill completes what was not observed
    keyframes          frames that are kept for positions requested later
    memory             bytes that a session takes

Units: metres; world y up; linear relative RGB (`roomlight.conventions`).
"""
