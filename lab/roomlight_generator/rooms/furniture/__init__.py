"""Furniture libraries of Sweet Home 3D (.sh3f) as furniture models: read, classified, simplified, kept in a compact
cache."""

from roomlight_generator.rooms.furniture.build import build_cache
from roomlight_generator.rooms.furniture.catalogue import Catalogue, load_catalogue
from roomlight_generator.rooms.furniture.fallbacks import fallback_models

__all__ = ["Catalogue", "build_cache", "fallback_models", "load_catalogue"]
