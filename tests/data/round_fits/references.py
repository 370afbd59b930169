#!/usr/bin/env python3
"""Least-squares circles and spheres to 60 digits: makes references.json, which tests/numerics/round_fits.rs
reads. Needs mpmath. python3 references.py > references.json

The minimum of sum((|p - c| - r)^2) by Newton's method with the full second derivative, at 100 digits,
on the very numbers that stand in the table (the doubles, without rounding), from a start found by
minimising the algebraic distance. The gradient at the end is below 1e-60 of the radius. The covariance
is the inverse of J'J at that minimum, J the derivative of the radial deviations.
"""
import json
import random

import mpmath as mp

mp.mp.dps = 100
random.seed(20190604)


def algebraic(points):
    """Centre of the algebraic fit."""
    d, n = len(points[0]), len(points)
    mean = [sum(p[k] for p in points) / n for k in range(d)]
    local = [[p[k] - mean[k] for k in range(d)] for p in points]
    a = mp.matrix([q + [mp.mpf(1)] for q in local])
    y = mp.matrix([sum(t * t for t in q) / 2 for q in local])
    x = mp.lu_solve(a.T * a, a.T * y)
    return [mean[k] + x[k] for k in range(d)]


def parts(points, centre):
    """Unit vectors and distances."""
    rows = []
    for p in points:
        offset = [a - b for a, b in zip(p, centre)]
        distance = mp.sqrt(sum(t * t for t in offset))
        rows.append(([t / distance for t in offset], distance))
    return rows


def fit(points):
    """Centre, radius, covariance."""
    d = len(points[0])
    m = d + 1
    centre = algebraic(points)
    r = sum(t for _, t in parts(points, centre)) / len(points)
    for _ in range(200):
        gradient, hessian, normal = mp.zeros(m, 1), mp.zeros(m), mp.zeros(m)
        for unit, distance in parts(points, centre):
            e = distance - r
            row = [-t for t in unit] + [mp.mpf(-1)]
            for i in range(m):
                gradient[i] += row[i] * e
                for j in range(m):
                    normal[i, j] += row[i] * row[j]
                    if i < d and j < d:
                        bend = ((1 if i == j else 0) - unit[i] * unit[j]) / distance
                        hessian[i, j] += e * bend
        # The second derivative need not be positive far off; its first part always is.
        full = normal + hessian
        try:
            mp.cholesky(full)
        except ValueError:
            full = normal
        step = mp.lu_solve(full, gradient)
        centre = [c - step[k] for k, c in enumerate(centre)]
        r -= step[d]
        if mp.norm(step) < mp.mpf(10) ** -75 * r:
            break
    assert mp.norm(gradient) < mp.mpf(10) ** -60 * r, "no minimum found"
    return centre, r, mp.inverse(normal)


def noisy(unit_vectors, centre, radius, noise):
    """Doubles."""
    return [
        [c + radius * t + random.gauss(0, noise) for c, t in zip(centre, u)] for u in unit_vectors
    ]


def direction(azimuth, elevation):
    a, e = mp.radians(azimuth), mp.radians(elevation)
    return [float(mp.cos(e) * mp.cos(a)), float(mp.cos(e) * mp.sin(a)), float(mp.sin(e))]


def arc(start, span, count):
    at = [mp.radians(start + span * k / mp.mpf(count - 1)) for k in range(count)]
    return [[float(mp.cos(t)), float(mp.sin(t))] for t in at]


def five(elevation):
    round_ = [direction(a, elevation) for a in (45, -135, -45, 135)]
    return round_ + [direction(0, 90)]


def cap(half_angle, count):
    """Points inside a cap about an oblique axis: the pole of it and turns of the golden angle."""
    w = direction(30, 50)
    u = direction(120, 0)
    v = [w[1] * u[2] - w[2] * u[1], w[2] * u[0] - w[0] * u[2], w[0] * u[1] - w[1] * u[0]]
    points = []
    for k in range(count):
        t = mp.radians(half_angle) * mp.sqrt(k / mp.mpf(count - 1))
        f = mp.radians(mp.mpf("137.508") * k)
        a, b, c = mp.sin(t) * mp.cos(f), mp.sin(t) * mp.sin(f), mp.cos(t)
        points.append([float(a * u[i] + b * v[i] + c * w[i]) for i in range(3)])
    return points


def cases():
    """Name, points."""
    near, far = [0.3, -0.2], [1e4, -7e3]
    for radius in (1e-2, 1.0, 12.5, 1e3):
        for place in (near, far):
            where = f"radius {radius:g} at {place[0]:g}"
            yield f"circle, {where}", noisy(arc(0, 315, 8), place, radius, 1e-4 * radius)
            yield f"three points, {where}", noisy(arc(10, 200, 3), place, radius, 0)
    for span in (60, 20, 5, 1):
        noise = 1e-4 * (span / 60) ** 2
        yield f"arc of {span} deg", noisy(arc(15, span, 12), [250.0, -400.0], 80.0, 80 * noise)
    yield "rough circle", noisy(arc(0, 300, 6), near, 1.0, 0.2)
    near, far = [0.3, -0.2, 0.1], [1e4, -7e3, 3e3]
    for radius in (1e-2, 1.0, 15.0, 1e3):
        for place in (near, far):
            for elevation in (0, 10, 30, -20):
                points = noisy(five(elevation), place, radius, 1e-4 * radius)
                yield f"five touches at {elevation} deg, radius {radius:g} at {place[0]:g}", points
    for half in (90, 40, 10, 2):
        noise = 15 * 1e-4 * (half / 90) ** 2
        points = noisy(cap(half, 15), [412.0, -87.0, 305.0], 15.0, noise)
        yield f"cap of {half} deg", points
    yield "four points", noisy(five(20)[1:], near, 12.0, 0)
    yield "rough sphere", noisy(cap(140, 9), near, 1.0, 0.1)


def main():
    table = []
    for name, points in cases():
        exact = [[mp.mpf(t) for t in p] for p in points]
        centre, r, covariance = fit(exact)
        m = covariance.rows
        digits = lambda value, count: mp.nstr(value, count)
        table.append(
            {
                "name": name,
                "points": points,
                "centre": [digits(c, 60) for c in centre],
                "radius": digits(r, 60),
                "covariance": [[digits(covariance[i, j], 20) for j in range(m)] for i in range(m)],
            }
        )
    rows = ",\n".join(json.dumps(row) for row in table)
    print(f"[\n{rows}\n]")


main()
