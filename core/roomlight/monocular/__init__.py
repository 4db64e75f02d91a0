"""Depth of frames that come without: from one picture by a network, then made consistent over a stream by its poses.

`stream` is where to start, `stream_state` what it knows between two frames. `estimate` is what every model returns,
`network` the model inside the package, `model_file` any ONNX file of the user's, `tracks` features that several frames
see, `fitting` scale, shift and errors over the picture, `sweep` depth by what other views show, `floor` how high the
camera is over the floor, `pose_scale` the metres of poses that have none.

What else pictures tell: `motion` places the cameras of a video by their `features`, `adjustment` adjusts them together,
`horizon` says which way is up.
"""
