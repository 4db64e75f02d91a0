"""The picture: layers, crops, occlusion by real things, the camera's noise and blur."""
