"""Below and around routes: connections, TLS, tokens, request bodies, disconnects, the end of a stopping server."""
