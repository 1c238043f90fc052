#!/usr/bin/env python3
"""Makes tests/golden: what an independent NumPy version of the formulas says about seeded and recorded events.

Needs numpy and h5py, ../shared/oracle/oracle.py and ../shared/data/corridor (from the project's root). Run it from
anywhere: scripts/make_golden.py. It writes the same bytes every time; the tests that read them are
services/{reconstruct,extract}/tests/golden.rs, which make the same streams and images with the same generator.

Files:
  frame_digests.csv          SHA-256 of every frame of the counting methods
  frames_<stream>_<method>.npy   whole frames (frames, H, W[, 3]) of the small stream
  time_surface_<stream>.npy  every `step`-th pixel of each row and column of the frames (frames, H', W', 3)
  rows_<case>.npy            descriptors (f64) of seeded images
Frames are ordered by tick, then by window; windows without a frame are left out.
"""
import csv
import hashlib
import pathlib
import sys

import h5py
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
GOLDEN = ROOT / "tests" / "golden"
sys.path.insert(0, str(SHARED / "oracle"))
import oracle  # noqa: E402


def split_mix(seed, count):
    """The first `count` numbers of SplitMix64 (Steele, Lea, Flood 2014) from this seed."""
    with np.errstate(over="ignore"):
        z = np.uint64(seed) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))


def below(r, n):
    """A number below n that favours the small ones: the product of two uniform numbers, times n."""
    low, high = r & np.uint64(0xFFFFFFFF), r >> np.uint64(32)
    return ((((low * high) >> np.uint64(32)) * np.uint64(n)) >> np.uint64(32)).astype(np.int64)


def stream(seed, count, height, width, spread_us):
    """Events x, y, t (µs), p: three numbers of the generator each, the third for polarity and the time step."""
    a, b, c = split_mix(seed, 3 * count).reshape(count, 3).T
    t = 1_000_000_007 + np.cumsum(((c >> np.uint64(2)) % np.uint64(spread_us)).astype(np.int64))
    return below(a, width), below(b, height), t, (c & np.uint64(3) != 0).astype(np.int64)


def windows(t, unit, tick, lengths, align, ticks=None):
    """Slices of the events in each window of each whole tick; tick 0 begins with the first event."""
    t0, end = int(t[0]), int(t[-1])
    for k in range((end - t0) // tick if ticks is None else ticks):
        start = t0 + k * tick
        for length in lengths:
            first = start if align == "start" else start + tick - length
            if first < t0:
                continue
            lo, hi = np.searchsorted(t, [first, first + length], side="left")
            if hi > lo:
                yield k, length // unit, slice(lo, hi)


# name: (seed, events, height, width, spread µs, tick µs, windows µs, align, pixel step of the time surface)
STREAMS = {
    "small": (1, 4000, 24, 32, 100, 50_000, [20_000, 50_000], "start", 1),
    "davis": (2, 200_000, 260, 346, 10, 200_000, [50_000, 200_000], "start", 8),
    "hd": (3, 400_000, 720, 1280, 5, 200_000, [100_000, 300_000], "end", 24),
}
CORRIDOR_TICKS = 20


def frames(name, x, y, seconds, p, cuts, height, width, step, digests):
    surfaces, whole = [], {"event_count": [], "event_count_no_polarity": []}
    for tick, window_us, cut in cuts:
        x_, y_, p_ = x[cut], y[cut], p[cut]
        made = {
            "event_count": oracle.event_count(x_, y_, p_, width, height),
            "event_count_no_polarity": oracle.event_count_no_polarity(x_, y_, width, height),
        }
        for method, frame in made.items():
            digests.writerow([name, method, tick, window_us, hashlib.sha256(frame.tobytes()).hexdigest()])
            whole[method].append(frame)
        surfaces.append(oracle.time_surface(x_, y_, seconds[cut], p_, width, height)[::step, ::step])
    np.save(GOLDEN / f"time_surface_{name}.npy", np.stack(surfaces))
    if name == "small":
        for method, made in whole.items():
            np.save(GOLDEN / f"frames_{name}_{method}.npy", np.stack(made))


def make_frames():
    with open(GOLDEN / "frame_digests.csv", "w", newline="") as file:
        digests = csv.writer(file, lineterminator="\n")
        digests.writerow(["stream", "method", "tick", "window_us", "sha256"])
        for name, (seed, count, height, width, spread, tick, lengths, align, step) in STREAMS.items():
            x, y, t, p = stream(seed, count, height, width, spread)
            cuts = windows(t, 1, tick, lengths, align)
            frames(name, x, y, t / 1e6, p, cuts, height, width, step, digests)
        with h5py.File(SHARED / "data" / "corridor" / "query_events.h5") as h5:
            e = h5["events"]
            t, height, width = e["timestamps"][:600_000], int(e.attrs["height"]), int(e.attrs["width"])
            x, y, p = (e[key][:600_000].astype(np.int64) for key in ("x_coordinates", "y_coordinates", "polarities"))
        t = t.astype(np.int64)
        assert t[-1] > t[0] + CORRIDOR_TICKS * 500_000_000, "read more events"
        cuts = windows(t, 1000, 500_000_000, [250_000_000, 500_000_000], "start", CORRIDOR_TICKS)
        frames("corridor", x, y, (t - t[0]) / 1e9, p, cuts, height, width, 6, digests)


def image(seed, height, width, channels):
    """Seeded bytes, dark ones more often; the third channel 0."""
    r = split_mix(seed, height * width * channels).astype(np.uint64)
    high, low = r >> np.uint64(56), (r >> np.uint64(48)) & np.uint64(255)
    out = ((high * low) >> np.uint64(8)).astype(np.uint8).reshape(height, width, channels)
    out[: height // 2] //= 3
    if channels == 1:
        return out[..., 0]
    out[..., 2] = 0
    return out


def hog(frame, height=32, width=48, reach=4):
    """The extractor of this name, from its definition: every sum over a neighbourhood is one over shifted copies."""
    small = oracle.area_resize(oracle.grey(frame), height, width)
    small = (small - small.mean()) / (small.std() + 1e-6)

    def local_mean(a):
        inside = np.zeros((height + 2 * reach, width + 2 * reach))
        values, ones = inside.copy(), inside
        values[reach : reach + height, reach : reach + width] = a
        ones[reach : reach + height, reach : reach + width] = 1
        squares = [np.lib.stride_tricks.sliding_window_view(v, (2 * reach + 1, 2 * reach + 1)) for v in (values, ones)]
        return squares[0].sum((2, 3)) / squares[1].sum((2, 3))

    centred = small - local_mean(small)
    local = centred / (np.sqrt(local_mean(centred**2)) + 0.3)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(local, 2, mode="symmetric"), (5, 5))
    v, u = np.mgrid[-2:3, -2:3]
    responses = []
    for angle in np.arange(8) * np.pi / 4:
        weights = (u * np.cos(angle) + v * np.sin(angle)) * np.exp(-0.5 * (u**2 + v**2))
        responses.append(np.maximum(0, np.einsum("yxvu,vu->yx", around, weights / np.abs(weights).sum())))
    cells = [np.stack([oracle.area_resize(r, *grid) for r in responses], -1) for grid in ((8, 10), (2, 3))]
    cells = np.concatenate([c.reshape(-1, 8) for c in cells])
    row = (cells / (np.linalg.norm(cells, axis=1, keepdims=True) + 0.01)).ravel()
    return oracle.l2(row - row.mean())


# name: (seed, height, width, channels, extractor)
ROWS = {
    "hog_upscaled": (18, 10, 13, 3, hog),
    "hog_davis": (19, 260, 346, 3, hog),
    "hog_hd": (20, 720, 1280, 1, hog),
    "patch_norm_small": (11, 24, 32, 1, lambda f: oracle.patch_norm(f, side=8, patch=4)),
    "patch_norm_upscaled": (12, 10, 13, 3, lambda f: oracle.patch_norm(f, side=16, patch=2)),
    "patch_norm_davis": (13, 260, 346, 3, oracle.patch_norm),
    "patch_norm_hd": (14, 720, 1280, 1, oracle.patch_norm),
    "raw_pixels_davis": (15, 260, 346, 1, oracle.raw_pixels),
    "raw_pixels_log1p": (16, 128, 128, 3, lambda f: oracle.raw_pixels(f, h=7, w=7, transform="log1p")),
    "raw_pixels_hd": (17, 720, 1280, 3, oracle.raw_pixels),
}


def make_rows():
    for name, (seed, height, width, channels, extract) in ROWS.items():
        np.save(GOLDEN / f"rows_{name}.npy", extract(image(seed, height, width, channels)))


if __name__ == "__main__":
    GOLDEN.mkdir(parents=True, exist_ok=True)
    make_frames()
    make_rows()
    total = sum(f.stat().st_size for f in GOLDEN.iterdir())
    print(f"{GOLDEN}: {len(list(GOLDEN.iterdir()))} files, {total} bytes")
