"""Answers: light in its forms, composites, objects, the room's mesh and USDZ packages. No sessions, no routes."""
