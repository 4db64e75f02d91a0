"""Virtual objects in frames: lit by the room, with shadows, behind real things.

`Compositor` (`compositor.py`) composites one frame after the other, `recordings.py` whole recordings. An object
gets its picture in this order:

1. `objects`: its meshes, materials and textures, from a file (`loading.py`) or a shape.
2. `placement`: the scene's description, the room's surfaces, and the object's place on them (`placed_object.py`).
3. `light`: panoramas at its probes, changed to what objects need, eased over time, as tables to
   draw directions from (`lighting.py`).
4. `rendering`: the object's radiance (`renderer.py`), and the ratio of light with and without it on real surfaces
   (`shadows.py`).
5. `picture`: which part real things hide, the camera's blur and noise, and the layers of the result.

`kernels` holds the compiled loops of all of them.
"""
