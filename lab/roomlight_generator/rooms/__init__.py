"""Furnished and lit rooms. Does not import PyTorch.

Start at `build.build_room`. `shell` builds walls, windows and doors; `finishes`, `palettes` and `colour` choose their
materials; `furniture` reads the model libraries; `planner` places models; `lights` and `sky` light the room. `scene`,
`plan` and `furniture_model` are the data that these parts exchange.
"""
