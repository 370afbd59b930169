"""Resampling to equal angles in numpy: the same windowed sinc, vectorised over all samples of a turn, one
`bincount` a tap; the kernel interpolated in the same table.

Arguments: file (of each turn the number of samples, the angles, the values), angles a revolution. Prints
seconds, then the first whole revolution of each turn from angle 0 on.
"""

import sys
import time

import numpy as np

HALF, BETA, DENSITY = 6, 10.06, 2048


def kernel():
    u = np.arange(HALF * DENSITY + 2) / DENSITY
    window = np.i0(BETA * np.sqrt(np.maximum(0.0, 1.0 - (u / HALF) ** 2))) / np.i0(BETA)
    return u, np.sinc(u) * window


def resampled(table, angle, value, steps):
    """Number of the first angle, and the values; meaningless within half a kernel of the ends."""
    position = angle * steps / (2 * np.pi)
    length = np.empty_like(position)
    length[1:-1] = (position[2:] - position[:-2]) / 2
    length[0], length[-1] = (position[1] - position[0]) / 2, (position[-1] - position[-2]) / 2
    base = np.floor(position).astype(np.int64)
    first = int(base[0]) - HALF
    count = int(base[-1]) + HALF + 2 - first
    sums, weights = np.zeros(count), np.zeros(count)
    for tap in range(-HALF, HALF + 2):
        number = base + tap
        weight = length * np.interp(np.abs(number - position), *table, right=0.0)
        sums += np.bincount(number - first, weight * value, count)
        weights += np.bincount(number - first, weight, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return first, sums / weights, position


def main():
    data, steps = np.fromfile(sys.argv[1]), int(sys.argv[2])
    turns, at = [], 0
    while at < len(data):
        n = int(data[at])
        turns.append((data[at + 1 : at + 1 + n], data[at + 1 + n : at + 1 + 2 * n]))
        at += 1 + 2 * n
    best, results = np.inf, None
    for _ in range(3):
        begin = time.perf_counter()
        table = kernel()
        results = [resampled(table, angle, value, steps) for angle, value in turns]
        best = min(best, time.perf_counter() - begin)
    print(f"# numpy {np.__version__}")
    print(best)
    for first, values, position in results:
        begin = int(np.ceil(position[0])) + HALF
        numbers = begin + (np.arange(steps) - begin) % steps
        for value in values[numbers - first]:
            print(repr(float(value)))


main()
