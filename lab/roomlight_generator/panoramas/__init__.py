"""Rooms lit by real HDR panoramas: a panorama is projected from its centre onto a room's shell.

Start at `render.render_room`. `library` lists and splits a folder's panoramas, `shell` draws shells, `furniture` and
`furnished` place furniture and light it, `room` renders.
"""
