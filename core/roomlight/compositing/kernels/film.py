# pyright: reportMissingParameterType=false
"""Samples of pixels averaged to pixels."""

from numba import njit


@njit(nogil=True, cache=True)
def average_samples(film, samples, out, start, stop):
    """Average the samples of pixels start..stop; the object is the nearest sample's, depth the covered ones' mean.

    Args:
        film: a value for each sample, `samples` a pixel; albedo and normal may be left out (no rows).
        out: the same for each pixel.
    """
    extra = len(film.albedo) > 0
    for i in range(start, stop):
        covered, depth, nearest, object_id = 0.0, 0.0, 1e30, -1
        red, green, blue = 0.0, 0.0, 0.0
        first = i * samples
        for s in range(first, first + samples):
            red += film.radiance[s, 0]
            green += film.radiance[s, 1]
            blue += film.radiance[s, 2]
            alpha = film.alpha[s]
            if alpha > 0:
                covered += alpha
                depth += alpha * film.depth_m[s]
                if film.depth_m[s] < nearest:
                    nearest, object_id = film.depth_m[s], film.object_id[s]
        out.radiance[i, 0], out.radiance[i, 1], out.radiance[i, 2] = red / samples, green / samples, blue / samples
        out.alpha[i] = covered / samples
        out.depth_m[i] = depth / max(covered, 1e-12)
        out.object_id[i] = object_id
        if extra:
            for axis in range(3):
                albedo, normal = 0.0, 0.0
                for s in range(first, first + samples):
                    albedo += film.albedo[s, axis]
                    normal += film.normal[s, axis]
                out.albedo[i, axis], out.normal[i, axis] = albedo / samples, normal / samples
