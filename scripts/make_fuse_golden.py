#!/usr/bin/env python3
"""Makes the golden arrays of the fuse crate from the independent NumPy formulas in ../shared/oracle.

    scripts/make_fuse_golden.py                    writes tests/golden_fuse/*.npy
    scripts/make_fuse_golden.py --match DIR --length L
                                                   matches s.npy, present.npy, valid.npy in DIR: masked.npy, and
                                                   whole.npy where nothing is missing; for comparing on the spot

Similarity: q.npy (4, 37) and r.npy (9, 37) in f32, similarity_<kind>.npy (4, 9).
Sequences, R references: seq_<R>_s.npy (Q, R), seq_<R>.npy (lengths, Q, R) for L = 2, 10, 30 (L = 1 is S itself).
With holes: masked_<R>_present.npy (Q,), masked_<R>_valid.npy (R,), masked_<R>.npy (lengths, Q, R) on the same S.
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
