"""The wire format: messages that carry frames to a server and light back, specified in `server/WIRE.md`.

These modules build, parse and check messages. They open no sockets.
"""
