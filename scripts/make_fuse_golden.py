#!/usr/bin/env python3
"""Makes the golden arrays of the fuse crate from the independent NumPy formulas in ../shared/oracle.

    scripts/make_fuse_golden.py                    writes tests/golden_fuse/*.npy
    scripts/make_fuse_golden.py --match DIR --length L
                                                   matches s.npy, present.npy, valid.npy in DIR: masked.npy, and
                                                   whole.npy where nothing is missing; for comparing on the spot

Similarity: q.npy (4, 37) and r.npy (9, 37) in f32, similarity_<kind>.npy (4, 9).
Sequences, R references: seq_<R>_s.npy (Q, R), seq_<R>.npy (lengths, Q, R) for L = 2, 10, 30 (L = 1 is S itself).
With holes: masked_<R>_present.npy (Q,), masked_<R>_valid.npy (R,), masked_<R>.npy (lengths, Q, R) on the same S.
Other methods on the same S and holes, R = 7 and 100, <method>_<R>.npy and masked_<method>_<R>.npy (cases, Q, R): rows
with L = 1, 2, 10; seqslam with L = 1, 5, 10 and the authors' parameters, last L = 4, window 6, velocities 0, 1, 2; filter
with its defaults, last beta 0.5, transition 0, 1, restart 0.2.
Rules: rule_scores.npy (members, R), rule_weights.npy (members,), rule_valid.npy (members, R), rule_<rule>.npy (R,) with
equal weights and everything there, masked_rule_<rule>.npy with weights and holes.
"""
import argparse
import pathlib
import sys

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.dont_write_bytecode = True
sys.path.insert(0, str(ROOT.parent / "shared" / "oracle"))
import oracle  # noqa: E402

KINDS = ["l2", "l2_squared", "cosine", "sad"]
LENGTHS = [2, 10, 30]
MASKED_LENGTHS = {7: [1, 2, 10, 30], 100: [1, 10]}
TICKS = 34


def similarity_case(rng, queries, references, dim):
    """Rows with nearly identical pairs: those are where |q|²+|r|²−2qr and direct differences part."""
    q = rng.normal(size=(queries, dim)).astype(np.float32)
    r = rng.normal(size=(references, dim)).astype(np.float32)
    r[1] = q[0] + rng.normal(size=dim).astype(np.float32) * np.float32(1e-3)
    r[2] = q[1] * np.float32(1.0001)
    return q, r


def sequence_case(rng, ticks, references):
    """Similarities with one constant column in three and
    some that change by less and a little more than the threshold of 1e-4."""
    s = -np.abs(rng.normal(size=(ticks, references)))
    s[:, 1::3] = s[0, 1::3]
    for first, spread in ((5, 1e-5), (6, 3e-4)):
        s[:, first::8] = s[0, first::8] + spread * rng.normal(size=s[:, first::8].shape)
    return s


def holes(rng, ticks, references):
    present, valid = rng.random(ticks) > 0.25, rng.random(references) > 0.2
    present[0], present[4:7], valid[references // 2] = True, False, True
    return present, valid


def spread(columns, valid):
    """Values of the valid references among zeros."""
    out = np.zeros((len(columns), len(valid)))
    out[:, valid] = columns
    return out


def contrast(s, window):
    """The first step of seqslam alone, by windows cut out one by one."""
    k = max(1, min(window, s.shape[1] // 4))
    pad = ((0, 0), (k // 2, k - 1 - k // 2))

    def local(a):
        return np.lib.stride_tricks.sliding_window_view(np.pad(a, pad, mode="symmetric"), k, axis=1).mean(2)

    d = s - local(s)
    return d / (np.sqrt(local(d * d)) + 1e-8)


def seqslam_masked(s, length, present, valid, window, velocities):
    """seqslam with holes: contrasts over valid references only; absent terms are 0; lines are those of the oracle."""
    e = spread(contrast(s[:, valid], window), valid) * present[:, None]
    out = np.full(s.shape, -np.inf)
    for q in range(length - 1, len(s)):
        for j in range(length - 1, s.shape[1]):
            for v in velocities:
                line = [int(j - lag * v) for lag in range(length - 1, -1, -1)]
                if min(j - (length - 1) * v, 0) > -1:
                    total = sum(e[q - length + 1 + i, r] for i, r in enumerate(line))
                    out[q, j] = max(out[q, j], total)
    out[:, ~valid] = np.where(np.isneginf(out[:, ~valid]), -np.inf, 0)
    out[~present] = np.nan
    return out


def filter_masked(s, present, valid, beta, steps, restart):
    """forward_filter with holes: z over valid references, 0 elsewhere; absent ticks are predicted only (z = 0)."""
    z = spread(oracle.row_z(s[:, valid]), valid) * present[:, None]
    return oracle.forward_filter(z, beta, steps, restart)


def methods(folder, s, present, valid, references):
    """Golden arrays of rows, seqslam and filter."""
    authors = np.linspace(0.8, 1.2, 10)
    seqslam = [(1, 20, authors), (5, 20, authors), (10, 20, authors), (4, 6, np.array([0.0, 1.0, 2.0]))]
    filters = [(1.5, (0.2, 0.5, 0.2, 0.1), 0.02), (0.5, (0.0, 1.0), 0.2)]
    everywhere, always = np.ones(references, bool), np.ones(len(s), bool)
    write(folder, f"rows_{references}", np.stack([oracle.rows(s, n) for n in (1, 2, 10)]))
    masked = [oracle.seq_match_masked(s, n, present, valid, columns=False) for n in (1, 2, 10)]
    write(folder, f"masked_rows_{references}", np.stack(masked))
    whole = [seqslam_masked(s, n, always, everywhere, w, v) for n, w, v in seqslam]
    if references >= 8:  # a window of at least 2: the oracle takes no other
        for (n, w, v), ours in zip(seqslam, whole):
            np.testing.assert_allclose(ours, oracle.seqslam(s, n, w, v), rtol=1e-9, atol=1e-9)
        whole = [oracle.seqslam(s, n, w, v) for n, w, v in seqslam]
    write(folder, f"seqslam_{references}", np.stack(whole))
    masked = [seqslam_masked(s, n, present, valid, w, v) for n, w, v in seqslam]
    write(folder, f"masked_seqslam_{references}", np.stack(masked))
    write(folder, f"filter_{references}", np.stack([oracle.forward_filter(oracle.row_z(s), *f) for f in filters]))
    write(folder, f"masked_filter_{references}", np.stack([filter_masked(s, present, valid, *f) for f in filters]))


def weighted_median(x, w):
    """The middle of the x that halve the weight, by repeating each as often as its weight says in quarters."""
    return np.median(np.repeat(x, np.rint(w * 4).astype(int)))


def trimmed(x, w, trim=0.25):
    order = np.argsort(x)
    kept = order[int(trim * len(x)) : len(x) - int(trim * len(x))]
    return np.average(x[kept], weights=w[kept])


def log_softmax(x, axis):
    m = x.max(axis, keepdims=True)
    return x - m - np.log(np.exp(x - m).sum(axis, keepdims=True))


def rules(folder):
    rng = np.random.default_rng(11)
    members, references = 6, 60
    x = rng.normal(size=(members, references)) * 3
    w = np.array([1.0, 0.5, 2.25, 1.0, 0.25, 1.0])
    valid = rng.random(x.shape) > 0.3
    valid[:, 7] = False
    for name, array in (("scores", x), ("weights", w), ("valid", valid)):
        write(folder, f"rule_{name}", array)
    write(folder, "rule_mean", x.mean(0))
    write(folder, "rule_max", x.max(0))
    write(folder, "rule_median", np.median(x, 0))
    write(folder, "rule_trimmed_mean", np.array([trimmed(column, np.ones(members)) for column in x.T]))
    write(folder, "rule_product", log_softmax(x, 1).sum(0))
    by_place = {
        "mean": lambda x, w: np.average(x, weights=w),
        "max": lambda x, w: x.max(),
        "median": weighted_median,
        "trimmed_mean": trimmed,
    }
    for name, rule in by_place.items():
        there = [(x[valid[:, j], j], w[valid[:, j]]) for j in range(references)]
        write(folder, f"masked_rule_{name}", np.array([rule(*there[j]) if len(there[j][0]) else 0 for j in range(references)]))
    logs = np.empty_like(x)
    for m in range(members):
        logs[m] = -np.log(valid[m].sum())
        logs[m, valid[m]] = log_softmax(x[m, valid[m]], 0)
    write(folder, "masked_rule_product", w @ logs)


def write(folder, name, array):
    np.save(folder / f"{name}.npy", np.ascontiguousarray(array))


def golden(folder):
    rng = np.random.default_rng(7)
    q, r = similarity_case(rng, 4, 9, 37)
    write(folder, "q", q)
    write(folder, "r", r)
    for kind in KINDS:
        write(folder, f"similarity_{kind}", oracle.similarity(q, r, kind))
    for references in (1, 2, 7, 100):
        s = sequence_case(rng, TICKS, references)
        write(folder, f"seq_{references}_s", s)
        write(folder, f"seq_{references}", np.stack([oracle.seq_match(s, n) for n in LENGTHS]))
        if references in MASKED_LENGTHS:
            present, valid = holes(rng, TICKS, references)
            out = [oracle.seq_match_masked(s, n, present, valid) for n in MASKED_LENGTHS[references]]
            write(folder, f"masked_{references}_present", present)
            write(folder, f"masked_{references}_valid", valid)
            write(folder, f"masked_{references}", np.stack(out))
            methods(folder, s, present, valid, references)
    rules(folder)


def match(folder, length):
    s, present, valid = (np.load(folder / f"{name}.npy") for name in ("s", "present", "valid"))
    write(folder, "masked", oracle.seq_match_masked(s, length, present, valid))
    if present.all() and valid.all():
        write(folder, "whole", oracle.seq_match(s, length))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--match", type=pathlib.Path, help="match the arrays in this folder instead")
    parser.add_argument("--length", type=int, default=10, help="L in ticks, with --match")
    args = parser.parse_args()
    if args.match:
        match(args.match, args.length)
    else:
        folder = ROOT / "tests" / "golden_fuse"
        folder.mkdir(parents=True, exist_ok=True)
        golden(folder)


if __name__ == "__main__":
    main()
