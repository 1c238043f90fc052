#!/usr/bin/env python3
"""Writes tests/golden_voxels: events, and the voxel grids that E2VID is fed of them, by NumPy.

From the published description (Rebecq et al., "High Speed and High Dynamic Range Video with an Event Camera", section 3)
and the behaviour of its reference code: bilinear in time over B bins between the first and the last event, hot pixels 0,
what is not 0 shifted and scaled to mean 0 and standard deviation 1, borders by reflection with the larger half first.
Run by hand (needs NumPy); what it writes is committed.
"""

from pathlib import Path

import numpy as np

OUT = Path(__file__).parent.parent / "tests" / "golden_voxels"
BINS, MULTIPLE = 5, 8


def voxels(t, x, y, on, height, width, hot):
    grid = np.zeros((BINS, height, width), np.float64)
    span = max(t[-1] - t[0], 1)
    position = (BINS - 1) * (t - t[0]) / span
    lower = np.floor(position).astype(int)
    weight = position - lower
    sign = np.where(on, 1.0, -1.0)
    np.add.at(grid, (lower, y, x), sign * (1 - weight))
    inside = lower + 1 < BINS
    np.add.at(grid, (lower[inside] + 1, y[inside], x[inside]), (sign * weight)[inside])
    for hot_x, hot_y in hot:
        grid[:, hot_y, hot_x] = 0
    # Where events cancel only rounding is left; the grid of the product is of f32.
    grid[np.abs(grid) < 1e-7] = 0
    some = grid != 0
    mean = grid[some].mean()
    deviation = np.sqrt((grid[some] ** 2).mean() - mean**2)
    grid[some] = (grid[some] - mean) / deviation
    more = lambda side: -side % MULTIPLE
    before = lambda side: -(-more(side) // 2)
    pad = [(0, 0)] + [(before(side), more(side) - before(side)) for side in (height, width)]
    return np.pad(grid, pad, mode="reflect").astype(np.float32)


def main():
    OUT.mkdir(exist_ok=True)
    random = np.random.RandomState(11)
    for name, height, width, count, hot in (("odd", 13, 21, 400, [(3, 4), (20, 12)]), ("whole", 16, 24, 3000, [])):
        t = np.sort(random.randint(0, 50_000, count)).astype(np.int64) + 1_000_000
        x, y = random.randint(0, width, count), random.randint(0, height, count)
        # Dyadic times, so that no weight is rounded and cancelling events cancel exactly.
        t = 1_000_000 + (t - t[0]) // 64 * 64
        t[-1] = t[0] + 65536
        on = random.randint(0, 2, count).astype(bool)
        np.save(OUT / f"{name}.events.npy", np.stack([t, x, y, on], axis=1).astype(np.int64))
        np.save(OUT / f"{name}.hot.npy", np.array(hot, np.int64).reshape(-1, 2))
        np.save(OUT / f"{name}.voxels.npy", voxels(t, x, y, on, height, width, hot))


if __name__ == "__main__":
    main()
