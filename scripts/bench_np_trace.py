#!/usr/bin/env python3
"""Times sequence matching as published: NumPy, one np.trace per column of the similarity matrix.

    scripts/bench_np_trace.py [--length L] [--seconds S] R [R …]

prints a line per R: R, ms per query (the best of as many as fit into S seconds). One query is the z-scores of its
L x R window, columns then rows, and for each column the trace of the L x L block that ends there; the window's rows
are in the cache. The Rust bench (cargo bench -p evpr-fuse --bench per_query) runs it to state the ratio.
"""
import argparse
import time

import numpy as np


def standardise(window):
    """The z-scored window: columns first, where columns that hardly vary are only centred, then rows."""
    deviation = window.std(axis=0) + 1e-8
    deviation[deviation < 1e-4] = 1.0
    z = (window - window.mean(axis=0)) / deviation
    return (z - z.mean(axis=1, keepdims=True)) / (z.std(axis=1, keepdims=True) + 1e-8)


def match(window):
    """The scores of the newest row of a window of L rows: a trace per column, shorter at the left edge."""
    z = standardise(window)
    length, references = z.shape
    scores = np.zeros(references)
    for column in range(references):
        first = column - length + 1
        if first >= 0:
            scores[column] = np.trace(z[:, first : column + 1])
        else:
            scores[column] = np.trace(z[-first:, : column + 1])
    return scores


def by_shifting(window):
    """The same by whole rows: checks that the loop computes what it is timed for."""
    z = standardise(window)
    length, references = z.shape
    scores = np.zeros(references)
    for lag in range(min(length, references)):
        scores[lag:] += z[length - 1 - lag, : references - lag]
    return scores


def milliseconds(references, length, seconds):
    window = np.random.default_rng(0).normal(size=(length, references))
    assert np.allclose(match(window), by_shifting(window), atol=1e-9)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        match(window)
        best = min(best, time.perf_counter() - start)
    return best * 1e3


def main():
    parser = argparse.ArgumentParser(description="Times one np.trace per column.")
    parser.add_argument("--length", type=int, default=30, metavar="L")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S")
    parser.add_argument("references", type=int, nargs="+", metavar="R")
    arguments = parser.parse_args()
    for references in arguments.references:
        print(references, f"{milliseconds(references, arguments.length, arguments.seconds):.3f}")


if __name__ == "__main__":
    main()
