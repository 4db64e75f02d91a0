"""The session server: HTTP and WebSocket in front of the engine. Start at `serving.serve`.

`app` makes the FastAPI application; CONTRIBUTING.md lists the folders. Messages are specified in `docs/wire.md`; their
models are in `roomlight.wire`.
"""
