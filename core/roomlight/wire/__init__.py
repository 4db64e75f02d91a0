"""The wire format: messages that carry frames to a server and light back, specified in `docs/wire.md`.

These modules build, parse and check messages. They open no sockets.
"""
