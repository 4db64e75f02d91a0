"""Rooms of other authors: Blender scenes, rendered by Cycles through the Python module `bpy`.

Start at `render.render_room`. `scene` opens a file and reads its triangles, `floor` finds where a camera can walk,
`cycles` renders frames and panoramas. `check` opens all scenes of a run before the first is rendered.

`bpy` is an extra (`pip install 'roomlight[blender]'`): Blender as a Python module, for the one version of Python that
its wheel is made for. It holds one scene in a process.
"""
