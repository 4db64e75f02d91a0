# pyright: reportMissingParameterType=false
"""Gather rays of the records of indirect light: by cosine, and into cones about the lights.

A lamp's housing and a window's reveals are small and a hundred times as bright as the walls: rays by cosine alone
would meet them by chance. Both kinds of rays are weighted by the balance heuristic.
"""

import math

import numpy as np
from numba import njit

from roomlight.kernels.common import mixed, tangents
from roomlight_generator.transport.kernels.common import JIT, PHI1, PHI2, cosine_direction, fraction, in_table, unit
from roomlight_generator.transport.kernels.lights import estimates

LEAST_SEEN = 40  # 255ths: a light that a patch never saw may still shine on surfaces that the patch sees
WIDER = 1.25
WIDER_M = 0.03  # factor by which a light's cone is wider than its cluster
_ZERO = np.float32(0)


@njit(**JIT)
def _within(cone, cones, x, y, z):
    """Sum the densities of the cones that contain a direction."""
    density = _ZERO
    for j in range(cones):
        inside = x * cone[0, j] + y * cone[1, j] + z * cone[2, j] > cone[3, j]
        density += cone[4, j] if inside else _ZERO
    return density


@njit(**JIT)
def gather_rays(lights, visibility, points, through, sampling, scratch, out):
    """Write the rays of indirect light that each point sends.

    Args:
        lights: Clusters of lights (`Lights`).
        visibility: Share of each cluster that each row sees, in 255ths, [rows, l].
        points: The points (`Points`).
        through: The coat's table: the share of light let through, by roughness and cosine.
        sampling: Numbers of rays and the seed (`GatherSampling`).
        scratch: Work space (`ConeScratch`).
        out: The rays (`GatherRays`), [n * (cosine_rays + cone_rays)].
    """
    position, normal, geometric_normal, alpha, row, stream = points
    cosine_rays, cone_rays, seed = sampling
    origin, direction, weight, passed = out
    rays = cosine_rays + cone_rays
    clusters = lights.real
    estimated, cone, chance = scratch
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2]
        # 1. Make a cone about each cluster that may shine on the point, with a chance in proportion to its estimate.
        cones, total = 0, 0.0
        estimates(lights, clusters, visibility, row[i], LEAST_SEEN, (px, py, pz), (nx, ny, nz), estimated)
        for which in range(clusters):
            share = np.float64(estimated[which])
            x, y, z = lights.centre[0, which] - px, lights.centre[1, which] - py, lights.centre[2, which] - pz
            d = math.sqrt(x * x + y * y + z * z)
            r = WIDER * lights.radius[which] + WIDER_M
            if share <= 0 or d <= 1.05 * r:
                continue
            total += share
            chance[cones] = share
            cosine = math.sqrt(1 - (r / d) ** 2)
            width = (r / d) ** 2 / (1 + cosine)  # 1 - cosine without cancellation
            cone[0, cones], cone[1, cones], cone[2, cones], cone[3, cones] = x / d, y / d, z / d, 1 - width
            cone[4, cones] = share / (2 * math.pi * width)
            cones += 1
        # 2. Share the rays between cosine and cones. The cones' shares become densities over solid angle.
        guided = cone_rays if cones > 0 else 0
        for k in range(cones):
            cone[4, k] /= total
        plain = rays - guided
        state = mixed(np.uint64(stream[i]) ^ mixed(np.uint64(seed)))
        shift1 = unit(state)
        state = mixed(state)
        shift2 = unit(state)
        shift3 = unit(mixed(state))
        which, running = 0, 0.0
        if cones > 0:
            running = chance[0]
        for k in range(rays):
            # 3. Draw a direction, by cosine first and then by cones.
            at = i * rays + k
            r1, r2 = fraction(shift1 + PHI1 * k), fraction(shift2 + PHI2 * k)
            if k < plain:
                x, y, z, _ = cosine_direction(nx, ny, nz, r1, r2)
            else:
                aim = (k - plain + shift3) / guided * total
                while which < cones - 1 and running <= aim:
                    which += 1
                    running += chance[which]
                ax, ay, az = cone[0, which], cone[1, which], cone[2, which]
                cosine = 1 - r1 * (1 - cone[3, which])
                sine = math.sqrt(max(1 - cosine * cosine, 0.0))
                s, t = sine * math.cos(2 * math.pi * r2), sine * math.sin(2 * math.pi * r2)
                ux, uy, uz, vx, vy, vz = tangents(ax, ay, az)
                x = cosine * ax + s * ux + t * vx
                y = cosine * ay + s * uy + t * vy
                z = cosine * az + s * uz + t * vz
            under = x * gx + y * gy + z * gz
            if under < 0 and k < plain:
                # The shading normal leans so far that the ray starts into its own surface: mirror it out.
                x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
            # 4. Weight the ray by the balance heuristic of both densities; a ray into the surface has weight 0.
            cosine = x * nx + y * ny + z * nz
            for c in range(3):
                origin[at, c] = position[i, c]
            if cosine <= 0 or (under < 0 and k >= plain):
                weight[at], passed[at] = 0.0, 1.0
                direction[at, 0], direction[at, 1], direction[at, 2] = gx, gy, gz
                continue
            density = _within(cone, cones, np.float32(x), np.float32(y), np.float32(z))
            weight[at] = cosine / (plain * cosine / math.pi + guided * density)
            direction[at, 0], direction[at, 1], direction[at, 2] = x, y, z
            passed[at] = in_table(through, alpha[i], cosine) if alpha[i] > 0 else 1.0


@njit(**JIT)
def gather_sum(sent, radiance, face, distance, rays, irradiance, clear):
    """Sum each point's irradiance over its rays.

    Args:
        sent: The rays (`GatherRays`), `rays` in a row for each point.
        radiance: Radiance along each ray, [n * rays, 3].
        face: Face that each ray met (-1: none), [n * rays].
        distance: Length of each ray in metres, [n * rays].
        rays: Rays of a point.
        irradiance: Receives the sums, [n, 3].
        clear: Receives the harmonic mean of the rays' lengths, [n].
    """
    weight, passed = sent.weight, sent.passed
    for p in range(len(clear)):
        red, green, blue, near, total = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(p * rays, (p + 1) * rays):
            t = weight[k] * passed[k]
            red, green, blue = red + t * radiance[k, 0], green + t * radiance[k, 1], blue + t * radiance[k, 2]
            total += weight[k]
            if face[k] >= 0:
                near += weight[k] / max(distance[k], 1e-3)
        irradiance[p, 0], irradiance[p, 1], irradiance[p, 2] = red, green, blue
        clear[p] = total / max(near, 1e-9)
