"""Light as renderers take it: spherical harmonics, a main light, cube maps, specular mips, image files, coverage.

Every form is made of one panorama (see `roomlight.conventions`: world frame, y up, linear relative RGB, 1.0 is white
at the session's reference exposure) and keeps its units: multiply each form by the same number to set a scene's
exposure. Sizes, shapes and numbers that a form cannot be made of are a ValueError that names value and rule.
"""
