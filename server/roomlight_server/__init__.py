"""The session server: HTTP and WebSocket in front of the engine. Start at `serving.serve`.

    settings          options, from flags and ROOMLIGHT_ variables
    app               the FastAPI application: routes, errors, documentation
    session_routes    open, join, list and close sessions; frames over HTTP
    light_routes      light of positions and probes
    stream            the WebSocket: frames in, light out
    live_session      one session: locks, queue, probes, cached light
    registry          all sessions: limits, expiry, owners
    workers           engine and decoding pools; decode_processes decode images
    connections       limits of headers, connections and slow clients

Messages are specified in `docs/wire.md`; their models are in `roomlight.wire`.
"""
