#!/usr/bin/env python3
"""Recomputes with NumPy what `evpr evaluate` and its sequence methods and rules give, from the rows of traverses.

    check_evaluate.py REFERENCE QUERY GROUND_TRUTH RESULTS.json

REFERENCE and QUERY are traverses, GROUND_TRUTH is a file of query_id,reference_id or "positions:METRES". Every row of
RESULTS.json, which `evpr evaluate` wrote for this pair, is recomputed: the formulas here are written from their
definitions, over whole matrices, and share nothing with evpr. Answers that differ are looked at again: they may only
where two places have scores that rounding cannot tell apart. Exit code 1 when a recall differs otherwise.
"""
import argparse
import json
import pathlib
import sys

import numpy as np

KS = (1, 5, 10, 20)
# Scores closer than this, relative to the spread of their row, are the same but for rounding.
ROUNDING = 1e-6


def member_rows(folder, name):
    rows = np.load(folder / "rows" / f"{name}.npy").astype(np.float64)
    return rows, np.load(folder / "rows" / f"{name}.present.npy")


def similarity(q, r, kind):
    if kind == "sad":
        return -np.stack([np.abs(one - r).sum(1) for one in q])
    if kind == "cosine":
        norm = lambda x: x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
        return norm(q) @ norm(r).T
    squared = np.stack([((one - r) ** 2).sum(1) for one in q])
    return -squared if kind == "l2_squared" else -np.sqrt(squared)


def z_rows(c):
    return (c - c.mean(1, keepdims=True)) / (c.std(1, keepdims=True) + 1e-8)


def z_columns(c):
    deviation = c.std(0) + 1e-8
    return (c - c.mean(0)) / np.where(deviation < 1e-4, 1.0, deviation)


def local_contrast(s, window=20):
    k = max(1, min(window, s.shape[1] // 4))
    padded = lambda a: np.pad(a, ((0, 0), (k // 2, k - 1 - k // 2)), mode="symmetric")
    mean = lambda a: np.lib.stride_tricks.sliding_window_view(padded(a), k, axis=1).mean(2)
    difference = s - mean(s)
    return difference / (np.sqrt(mean(difference**2)) + 1e-8)


def label(text):
    """The name and the parameters of `seqslam:window=10:velocities=0.9..1.1`; numbers of a list as a list."""
    name, *parameters = text.split(":")
    numbers = lambda value: [float(number) for number in value.replace("..", "/").split("/")]
    return name, {key: numbers(value) for key, value in (p.split("=") for p in parameters)}


def matched(s, present, valid, method, length):
    """Scores (Q, R), NaN rows where the member sits out; and which queries have history enough."""
    method, parameters = label(method)
    queries, references = s.shape
    out = np.full(s.shape, np.nan)
    history = present.copy()
    if not valid.any():
        return out, history & False
    if method == "none" or method in ("paper", "rows") and length == 1:
        out[present] = np.where(valid, s[present], s[present][:, valid].mean(1, keepdims=True))
        return out, history
    spread = np.zeros(s.shape)
    if method == "filter":
        spread[np.ix_(present, valid)] = z_rows(s[np.ix_(present, valid)])
        out[present] = spread[present]
        return out, history
    if method == "seqslam":
        spread[np.ix_(present, valid)] = local_contrast(s[np.ix_(present, valid)], int(parameters.get("window", [20])[0]))
        steps = int(parameters.get("velocity_steps", [10])[0])
        velocities = np.linspace(*parameters.get("velocities", [0.8, 1.2]), steps)
        places = np.arange(references)
        for q in range(queries):
            history[q] &= q >= length - 1
            if not present[q]:
                continue
            out[q] = -np.inf
            for v in velocities if q >= length - 1 else ():
                total = np.zeros(references)
                for lag in reversed(range(length)):
                    # Rounded towards zero: a line that begins less than one place before the map still lies on it.
                    line = np.trunc(places - lag * v).astype(int)
                    total += spread[q - lag, np.clip(line, 0, None)]
                on_map = (places >= length - 1) & (places - (length - 1) * v > -1)
                out[q] = np.where(on_map, np.maximum(out[q], total), out[q])
            out[q, ~valid & (out[q] > -np.inf)] = 0
        return out, history
    for q in range(queries):
        if not present[q]:
            continue
        ticks = [t for t in range(max(0, q - length + 1), q + 1) if present[t]]
        c = s[np.ix_(ticks, valid)]
        if method == "paper":
            history[q] = len(ticks) > 1
            c = z_columns(c)
        z = np.zeros((len(ticks), references))
        z[:, valid] = z_rows(c)
        out[q] = 0
        for t, row in zip(ticks, z):
            lag = q - t
            if lag < references:
                out[q, lag:] += row[: references - lag]
        out[q, ~valid] = 0
    return out, history


def log_softmax(x):
    if x.max() == -np.inf:  # nothing can be scored yet
        return x
    x = x - x.max()
    return x - np.log(np.exp(x).sum())


def fuse(scores, valid, rule):
    """One score per place of members' scores (M, R); places without a row of a member are left to the others."""
    rule, parameters = label(rule)
    trim = parameters.get("trim", [0.25])[0]
    if rule == "sum":
        return scores.sum(0)
    if rule == "product":
        total = np.zeros(scores.shape[1])
        for x, there in zip(scores, valid):
            log = np.full(len(x), -np.log(there.sum()))
            log[there] = log_softmax(x[there])
            total += log
        return total
    out = np.zeros(scores.shape[1])
    # Places that the same members have a row for are fused together.
    patterns, which = np.unique(valid, axis=1, return_inverse=True)
    for at, there in enumerate(patterns.T):
        places = np.flatnonzero(which.ravel() == at)
        x = np.sort(scores[np.ix_(there, places)], axis=0)
        if not len(x):
            continue
        cut = int(trim * len(x))
        out[places] = {
            "mean": lambda: x.mean(0),
            "max": lambda: x.max(0),
            "median": lambda: np.median(x, axis=0),
            "trimmed_mean": lambda: x[cut : len(x) - cut].mean(0),
        }[rule]()
    return out


def forward(z, beta=(1.5,), transition=(0.2, 0.5, 0.2, 0.1), restart=(0.02,)):
    """One step of the hidden Markov filter after another; z is None where no member had a row."""
    p, beta, restart = None, beta[0], restart[0]
    for row in z:
        row = np.zeros(row[1]) if row[0] is None else row[0]
        if p is None:
            p = np.full(len(row), 1 / len(row))
        moved = np.zeros(len(row))
        for step, weight in enumerate(transition):
            if step < len(row):
                moved[step:] += weight * p[: len(row) - step]
        p = ((1 - restart) * moved + restart / len(row)) * np.exp(beta * (row - row.max()))
        p /= p.sum()
        yield p


def recalls(members, names, truth, method, length, rule):
    """Per query the rank of the best right place (ties by place), how rounding could change it, and the answer."""
    chosen = [members[name] for name in names]
    queries, references = chosen[0][0].shape
    fused, counts, eligible = [], [], []
    for q in range(queries):
        there = [m for m in chosen if m[1][q]]
        scores = np.array([m[2][q] for m in there]).reshape(len(there), references)
        valid = np.array([m[3] for m in there]).reshape(len(there), references)
        fused.append((fuse(scores, valid, rule) if there else None, references))
        counts.append(any(m[4][q] for m in there))
        eligible.append(valid.any(0))
    method, parameters = label(method)
    rows = forward(fused, **parameters) if method == "filter" else (f[0] for f in fused)
    ranks, low, high, answers = [], [], [], []
    for q, row in enumerate(rows):
        may = eligible[q] if row is None else eligible[q] & (row > -np.inf)
        right = np.array([j for j in truth.get(q, ()) if may[j]], int)
        answered = counts[q] and may.any()
        answers.append(int(np.flatnonzero(may)[row[may].argmax()]) if answered else None)
        if not answered or not len(right):
            ranks.append(None), low.append(None), high.append(None)
            continue
        best = row[right].max()
        first = right[row[right] == best].min()
        wrong = may.copy()
        wrong[right] = False
        slack = ROUNDING * max(np.ptp(row[may]), abs(best), 1e-300)
        ranks.append(int((wrong & (row > best)).sum() + (wrong & (row == best))[:first].sum()))
        low.append(int((wrong & (row > best + slack)).sum()))
        high.append(int((wrong & (row >= best - slack)).sum()))
    return ranks, low, high, answers


def read_truth(text, reference, query):
    if not text.startswith("positions:"):
        pairs = np.loadtxt(text, delimiter=",", skiprows=1, dtype=int, ndmin=2)
        truth = {}
        for q, r in pairs:
            truth.setdefault(int(q), set()).add(int(r))
        return {q: sorted(r) for q, r in truth.items()}
    metres = float(text.split(":")[1])
    position = lambda folder: np.genfromtxt(folder / "ticks.csv", delimiter=",", skip_header=1)[:, 3:5]
    r = position(reference)
    near = (np.flatnonzero(np.hypot(*(r - one).T) <= metres) for one in position(query))
    return {q: places.tolist() for q, places in enumerate(near) if len(places)}


def subset_names(row, all_names):
    fits = lambda name: all(p in ("*", n) for p, n in zip(parts(row["subset"]), parts(name)))
    return [name for name in all_names if fits(name)]


def parts(name):
    reconstruction, rest = name.split("@")
    window, extractor = rest.split("/")
    return reconstruction, window, extractor


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reference", type=pathlib.Path)
    parser.add_argument("query", type=pathlib.Path)
    parser.add_argument("ground_truth")
    parser.add_argument("results", type=pathlib.Path)
    args = parser.parse_args()
    truth = read_truth(args.ground_truth, args.reference, args.query)
    names = [m["name"] for m in json.loads((args.reference / "traverse.json").read_text())["members"]]
    rows = json.loads(args.results.read_text())["rows"]
    kept, wrong, by_rounding = {}, 0, 0
    for row in rows:
        if row["kind"] == "named" or row["weights"] != "equal":
            print(f"not checked: {row['key']}")
            continue
        key = (row["similarity"], row["method"], row["length"])
        if key not in kept:
            kept[key] = {}
            for name in names:
                (r, valid), (q, present) = member_rows(args.reference, name), member_rows(args.query, name)
                s = similarity(q, r, row["similarity"])
                scores, history = matched(s, present, valid, row["method"], row["length"])
                kept[key][name] = (s, present, scores, valid, history)
        ranks, low, high, answers = recalls(
            kept[key], subset_names(row, names), truth, row["method"], row["length"], row["rule"]
        )
        count = lambda some, k: sum(rank is not None and rank < k for rank in some)
        queries, matchable = len(ranks), sum(bool(truth.get(q)) for q in range(len(ranks)))
        measured = row["measures"]
        if (measured["queries"], measured["matchable"]) != (queries, matchable):
            wrong += 1
            print(f"{row['key']}: {measured['queries']} queries, {measured['matchable']} matchable, not {queries}, {matchable}")
        if measured["answered"] != sum(answer is not None for answer in answers):
            wrong += 1
            print(f"{row['key']}: {measured['answered']} answered, not {sum(a is not None for a in answers)}")
        for k, share in zip(KS, measured["recall_at"]):
            got = round(share["of_all"] * queries)
            if abs(share["of_matchable"] * matchable - got) > 1e-6:
                wrong += 1
                print(f"{row['key']}: the two denominators of recall@{k} do not fit")
            if got == count(ranks, k):
                continue
            if count(high, k) <= got <= count(low, k):
                by_rounding += 1
            else:
                wrong += 1
                print(f"{row['key']}: recall@{k} is {got}/{queries}, NumPy has {count(ranks, k)}/{queries}")
    print(f"{len(rows)} rows, {wrong} wrong, {by_rounding} of {len(rows) * len(KS)} recalls differ within rounding")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
