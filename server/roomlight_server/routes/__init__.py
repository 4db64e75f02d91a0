"""Routes of the HTTP and WebSocket interface, one module for each resource."""
