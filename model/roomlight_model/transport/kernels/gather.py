# pyright: reportMissingParameterType=false
"""Gather rays of the records: by cosine, and into cones about the lights, where the brightest surfaces are.

A lamp's housing and a window's reveals are small, and a hundred times as bright as the walls: by cosine alone they are
met by chance. Both kinds of rays are weighted by the balance heuristic.
"""

import math

import numpy as np
from numba import njit

from roomlight_model.transport.kernels.common import (
    JIT,
    PHI1,
    PHI2,
    cosine_direction,
    fraction,
    in_table,
    mixed,
    tangents,
    unit,
)
from roomlight_model.transport.kernels.lights import estimate

WIDER = 1.25
WIDER_M = 0.03  # a light's cone takes in so much about its cluster


@njit(**JIT)
def gather_rays(
    lights, vis, position, normal, wound, alpha, row, number, through, cosine_rays, cone_rays, seed,
    origin, direction, weight, passed,
):  # fmt: skip
    """Write cosine_rays + cone_rays rays for each point. weight turns radiance into irradiance (the sum over a
    point's rays), passed is what a coat lets through of each."""
    rays = cosine_rays + cone_rays
    clusters = lights.real
    axis = np.empty((max(clusters, 1), 5))  # direction, cosine of the half angle, density
    chance = np.empty(max(clusters, 1))
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        gx, gy, gz = wound[i, 0], wound[i, 1], wound[i, 2]
        cones, total = 0, 0.0
        for which in range(clusters):
            share = estimate(lights, which, px, py, pz, nx, ny, nz)
            if row[i] >= 0:
                share *= max(vis[row[i], which], 40) / 255.0
            c = lights.centre[which]
            x, y, z = c[0] - px, c[1] - py, c[2] - pz
            d = math.sqrt(x * x + y * y + z * z)
            r = WIDER * lights.radius[which] + WIDER_M
            if share <= 0 or d <= 1.05 * r:
                continue
            total += share
            chance[cones] = share
            cosine = math.sqrt(1 - (r / d) ** 2)
            axis[cones, 0], axis[cones, 1], axis[cones, 2], axis[cones, 3] = x / d, y / d, z / d, cosine
            # 1 - cosine without cancellation
            axis[cones, 4] = share * (1 + cosine) / (2 * math.pi * (r / d) ** 2)
            cones += 1
        guided = cone_rays if cones > 0 else 0
        if cones > 0:
            for k in range(cones):
                axis[k, 4] /= total
        plain = rays - guided
        state = mixed(np.uint64(number[i]) ^ mixed(np.uint64(seed)))
        turn1 = unit(state)
        state = mixed(state)
        turn2 = unit(state)
        turn3 = unit(mixed(state))
        which, running = 0, 0.0
        if cones > 0:
            running = chance[0]
        for k in range(rays):
            at = i * rays + k
            r1, r2 = fraction(turn1 + PHI1 * k), fraction(turn2 + PHI2 * k)
            if k < plain:
                x, y, z, _ = cosine_direction(nx, ny, nz, r1, r2)
            else:
                aim = (k - plain + turn3) / guided * total
                while which < cones - 1 and running <= aim:
                    which += 1
                    running += chance[which]
                a = axis[which]
                cosine = 1 - r1 * (1 - a[3])
                sine = math.sqrt(max(1 - cosine * cosine, 0.0))
                s, t = sine * math.cos(2 * math.pi * r2), sine * math.sin(2 * math.pi * r2)
                ux, uy, uz, vx, vy, vz = tangents(a[0], a[1], a[2])
                x = cosine * a[0] + s * ux + t * vx
                y = cosine * a[1] + s * uy + t * vy
                z = cosine * a[2] + s * uz + t * vz
            under = x * gx + y * gy + z * gz
            if under < 0 and k < plain:
                # A shading normal leans so far that the ray starts into its own surface: it is turned up about it.
                x, y, z = x - 2 * under * gx, y - 2 * under * gy, z - 2 * under * gz
            cosine = x * nx + y * ny + z * nz
            for c in range(3):
                origin[at, c] = position[i, c]
            if cosine <= 0 or (under < 0 and k >= plain):
                weight[at], passed[at] = 0.0, 1.0
                direction[at, 0], direction[at, 1], direction[at, 2] = gx, gy, gz
                continue
            density = 0.0
            for j in range(cones):
                if x * axis[j, 0] + y * axis[j, 1] + z * axis[j, 2] > axis[j, 3]:
                    density += axis[j, 4]
            weight[at] = cosine / (plain * cosine / math.pi + guided * density)
            direction[at, 0], direction[at, 1], direction[at, 2] = x, y, z
            passed[at] = in_table(through, alpha[i], cosine) if alpha[i] > 0 else 1.0


@njit(**JIT)
def gather_sum(radiance, weight, passed, face, distance, rays, irradiance, clear):
    """Irradiance of each point from its rays, and the harmonic mean of the distances to what it sees."""
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
