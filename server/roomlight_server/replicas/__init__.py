"""Several replicas of the server under Ray Serve (extra `ray`)."""
