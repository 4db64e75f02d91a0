"""Camera walks through a lit room, rendered as a phone records them.

Start at `render.render_room`. `walk` moves the camera, `probes` places the probes, `exposure` and `sensor` model the
phone; `with_object` renders a view with and without an object.
"""
