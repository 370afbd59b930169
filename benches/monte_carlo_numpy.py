"""The same million trials in numpy at its best: float64, chunks that stay in the cache, arrays
reused, two threads with a generator each, BLAS on one thread a piece. Chunk and generator are tried
out first; the best of three full runs counts.

Arguments: file (per unknown: estimate, gain row times sigma), trials, Gauss-Newton steps.
Prints seconds, then the standard deviations of the unknowns and of circle centre and radius.
"""

import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

THREADS = 2
N = 8


def solve(xx, xy, yy, gx, gy):
    determinant = xx * yy - xy * xy
    return (gx * yy - gy * xy) / determinant, (gy * xx - gx * xy) / determinant


def dot(a, b):
    return np.einsum("ij,ij->j", a, b)


def circles(x, y, steps):
    """Algebraic start, then Gauss-Newton on the centre with the radius eliminated."""
    mx, my = x.mean(0), y.mean(0)
    dx, dy = x - mx, y - my
    half = dx * dx
    half += dy * dy
    half *= 0.5
    sx, sy = solve(dot(dx, dx), dot(dx, dy), dot(dy, dy), dot(dx, half), dot(dy, half))
    cx, cy = mx + sx, my + sy
    distance = half
    ux, uy = np.empty_like(dx), np.empty_like(dy)
    for _ in range(steps):
        np.subtract(x, cx, out=dx)
        np.subtract(y, cy, out=dy)
        np.multiply(dx, dx, out=ux)
        np.multiply(dy, dy, out=uy)
        np.add(ux, uy, out=distance)
        np.sqrt(distance, out=distance)
        np.divide(dx, distance, out=ux)
        np.divide(dy, distance, out=uy)
        sum_x, sum_y, sum_d = ux.sum(0), uy.sum(0), distance.sum(0)
        mean_x, mean_y = sum_x / N, sum_y / N
        sx, sy = solve(
            dot(ux, ux) - sum_x * mean_x,
            dot(ux, uy) - sum_x * mean_y,
            dot(uy, uy) - sum_y * mean_y,
            dx.sum(0) - sum_d * mean_x,
            dy.sum(0) - sum_d * mean_y,
        )
        cx += sx
        cy += sy
    np.subtract(x, cx, out=dx)
    np.subtract(y, cy, out=dy)
    np.multiply(dx, dx, out=ux)
    np.multiply(dy, dy, out=uy)
    np.add(ux, uy, out=distance)
    np.sqrt(distance, out=distance)
    return cx, cy, distance.mean(0)


def worker(generator, gain, estimate, trials, chunk, steps):
    """Sums and sums of squares of the deviations from the estimate (for the circle, from 0)."""
    unknowns, rows = gain.shape
    noise, points = np.empty((rows, chunk)), np.zeros((2, N, chunk))
    values = np.empty((unknowns + 3, chunk))
    total, squares = np.zeros(unknowns + 3), np.zeros(unknowns + 3)
    for start in range(0, trials, chunk):
        count = min(chunk, trials - start)
        generator.standard_normal(out=noise)
        np.matmul(gain, noise, out=values[:unknowns])
        np.add(values[: N - 1], estimate[: N - 1, None], out=points[0, 1:])
        np.add(values[N - 1 : 2 * N - 2], estimate[N - 1 : 2 * N - 2, None], out=points[1, 1:])
        values[unknowns:] = circles(points[0], points[1], steps)
        used = values[:, :count]
        total += used.sum(1)
        squares += np.einsum("ij,ij->i", used, used)
    return total, squares


def run(bits, chunk, gain, estimate, trials, steps, seed):
    sources = np.random.SeedSequence(seed).spawn(THREADS)
    share = [trials // THREADS + (t < trials % THREADS) for t in range(THREADS)]
    start = time.perf_counter()
    with ThreadPoolExecutor(THREADS) as pool:
        jobs = [
            pool.submit(
                worker, np.random.Generator(bits(source)), gain, estimate, part, chunk, steps
            )
            for source, part in zip(sources, share)
        ]
        sums = [job.result() for job in jobs]
    total, squares = (sum(part) for part in zip(*sums))
    deviations = np.sqrt((squares - total * total / trials) / (trials - 1))
    return time.perf_counter() - start, deviations


def main():
    table = np.loadtxt(sys.argv[1])
    trials, steps = int(sys.argv[2]), int(sys.argv[3])
    estimate, gain = table[:, 0], np.ascontiguousarray(table[:, 1:])
    candidates = [
        (bits, chunk)
        for bits in (np.random.SFC64, np.random.PCG64)
        for chunk in (1024, 2048, 4096, 8192, 16384)
    ]
    trial = {
        (bits, chunk): min(
            run(bits, chunk, gain, estimate, trials // 5, steps, seed)[0] for seed in (1, 2)
        )
        for bits, chunk in candidates
    }
    bits, chunk = min(trial, key=trial.get)
    print(f"# {np.__version__}, {bits.__name__}, chunks of {chunk}, {THREADS} threads")
    results = [run(bits, chunk, gain, estimate, trials, steps, seed) for seed in (3, 4, 5)]
    seconds, deviations = min(results, key=lambda result: result[0])
    print(seconds)
    for deviation in deviations:
        print(deviation)


main()
