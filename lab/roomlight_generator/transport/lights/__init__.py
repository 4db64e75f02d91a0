"""Lights of a room, and the direct light from them at points.

Start at `direct.DirectLight`. `emitters` collects lamps and openings into clusters, `outdoors` the sky and the sun;
`sun_spots` turns sunlit surfaces into lights; `coat` tabulates glossy surfaces; `light_visibility` and
`visibility_variance` learn from shadow rays.
"""
