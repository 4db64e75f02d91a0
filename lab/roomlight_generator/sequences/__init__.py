"""Camera walks through a lit room, rendered as a phone records them.

Start at `render`; `walk` moves the camera, `exposure` and `sensor` are the phone's.
"""
