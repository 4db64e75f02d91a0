"""The session server: HTTP and WebSocket in front of the engine. `serving.serve` starts one."""
