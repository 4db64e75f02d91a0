"""Furniture libraries of Sweet Home 3D (.sh3f) as furniture models.

Start at `catalogue.load_catalogue`, which reads the cache that `build.build_cache` writes. `files` reads the
libraries, `classify` gives each model its role, `assemble` and `simplify` make its mesh, `splits` divides the models
into train and test; `fallbacks` are plain models for roles that the library lacks.
"""

from roomlight_generator.rooms.furniture.build import build_cache
from roomlight_generator.rooms.furniture.catalogue import Catalogue, load_catalogue
from roomlight_generator.rooms.furniture.fallbacks import fallback_models

__all__ = ["Catalogue", "build_cache", "fallback_models", "load_catalogue"]
