#!/usr/bin/env python3
"""Counts the events of services/reconstruct/benches/per_event.rs with NumPy, for the ratio.

Needs numpy. Prints ns per event, on one core, the median of several runs: `np.add.at` as in the paper's authors' code,
`np.bincount`, and the whole `event_count` frame by each (counts of both polarities, tanh, scaling). Run it next to
`cargo bench -p evpr-reconstruct --bench per_event`, on the same machine.
"""
import statistics
import time

import numpy as np

CASES = [(260, 346, 2_000_000), (720, 1280, 10_000_000)]
REPEATS = 5


def events(height, width, count):
    """Event i from number i of SplitMix64 (Steele, Lea, Flood 2014): low half x, high half y, lowest bit polarity."""
    with np.errstate(over="ignore"):
        z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    x = ((z & np.uint64(0xFFFFFFFF)) * np.uint64(width)) >> np.uint64(32)
    y = ((z >> np.uint64(32)) * np.uint64(height)) >> np.uint64(32)
    return x.astype(np.int64), y.astype(np.int64), (z & np.uint64(1)).astype(np.int64)


def count_add_at(x, y, height, width):
    counts = np.zeros((height, width), np.float32)
    np.add.at(counts, (y, x), 1)
    return counts


def count_bincount(x, y, height, width):
    return np.bincount(y * width + x, minlength=height * width).reshape(height, width).astype(np.float32)


def event_count(count, x, y, p, height, width):
    frame = np.zeros((height, width, 3), np.uint8)
    for polarity in (0, 1):
        chosen = p == polarity
        level = np.tanh(count(x[chosen], y[chosen], height, width))
        frame[..., polarity] = np.clip(level / (level.max() + np.float32(1e-6)) * 255, 0, 255).astype(np.uint8)
    return frame


def ns_per_event(run, count):
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times) * 1e9 / count


def main():
    print(f"NumPy {np.__version__}; ns per event")
    for height, width, count in CASES:
        x, y, p = events(height, width, count)
        assert (event_count(count_add_at, x, y, p, height, width) == event_count(count_bincount, x, y, p, height, width)).all()
        print(f"{width}×{height}, {count} events")
        for name, counting in (("np.add.at", count_add_at), ("np.bincount", count_bincount)):
            alone = ns_per_event(lambda: counting(x, y, height, width), count)
            whole = ns_per_event(lambda: event_count(counting, x, y, p, height, width), count)
            print(f"{name:>14} {alone:8.2f}   whole event_count {whole:8.2f}")


if __name__ == "__main__":
    main()
