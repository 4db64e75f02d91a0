"""Forms of light for renderers, each computed from one panorama.

    light, sources       the light at a point, with all of its forms: start here; where it comes from
    spherical_harmonics  nine coefficients a channel, in the signs and orders of ARCore, ARKit and three.js
    main_light           the directional light that casts the shadows
    cube, cube_geometry  cube maps; resample maps panoramas to them and back
    prefilter            specular mips: a cube map for each roughness
    encode, ktx2         image files: EXR, Radiance HDR, PNG; KTX 2.0
    coverage             how much of the light was observed
    prior                the default light before the first frame

Panoramas are as in `roomlight.conventions` (world frame, y up, linear relative RGB, 1.0 is white at the session's
reference exposure), and every form keeps their unit: multiply all forms by one number to set a scene's exposure. An
option out of range raises OptionError, an array of the wrong shape or with values that are not finite ValueError.
"""
