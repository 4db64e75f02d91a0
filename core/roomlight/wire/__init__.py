"""The wire format: messages that carry frames to a server and light back, specified in `docs/wire.md`.

These modules build, parse and check messages; they open no sockets. Start at `frame_message` (a frame as bytes) and
`messages` (the JSON bodies). `light_message` packs light; `decoding` makes a `roomlight.frame.Frame` of a parsed frame.
"""
