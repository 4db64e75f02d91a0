"""Procedural furniture and props: every role of a room without a furniture library. Meshes are built on demand."""

from roomlight_generator.rooms.props.procedural import procedural_models

__all__ = ["procedural_models"]
