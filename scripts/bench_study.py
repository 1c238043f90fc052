#!/usr/bin/env python3
"""Times `evpr evaluate` on a study of the paper's size, over traverses of random rows.

    scripts/bench_study.py --ticks 600 [--pairs 10] [--evpr target/release/evpr] [--memory MIB] [--folder DIR [--make]]

Makes as few traverses as give so many pairs (five give ten), of 64 members each: 4 reconstructions × 4 windows × 4
extractors (NetVLAD 4096, CosPlace 512, MixVPR 4096, MegaLoc 8448 values, f32). A row is the place's own noise and the
drive's, half and half, of length 1. Places are 10 m apart, right is what lies within 25 m. Then runs the method paper with
lengths 10, 20 and 30 over the ensembles of the paper (64 single ones, 16 of each kind of four, all 64), and prints time,
processor time and the most memory: anonymous memory, without the rows, which are mapped from the disk. With --folder the
traverses are kept there; --make only makes them.
"""
import argparse
import itertools
import json
import pathlib
import resource
import shutil
import subprocess
import tempfile
import time

import numpy as np

EXTRACTORS = {"netvlad": 4096, "cosplace": 512, "mixvpr": 4096, "megaloc": 8448}
RECONSTRUCTIONS = ("event_count", "event_count_no_polarity", "time_surface", "e2vid")
WINDOWS = {"100ms": 100, "250ms": 250, "500ms": 500, "1s": 1000}
# Rows that are made at a time.
AT_ONCE = 500


def write_rows(path, ticks, dim, member, drive):
    """The rows of a member: noise of the place, the same on every drive, and as much of the drive."""
    rows = np.lib.format.open_memmap(path, mode="w+", dtype="<f4", shape=(ticks, dim))
    for start in range(0, ticks, AT_ONCE):
        shape = (min(AT_ONCE, ticks - start), dim)
        noise = lambda *seed: np.random.default_rng(seed).random(shape, dtype=np.float32) - np.float32(0.5)
        block = noise(member, start) + noise(member, start, drive + 1)
        rows[start : start + shape[0]] = block / np.linalg.norm(block, axis=1, keepdims=True)
    rows.flush()


def write_traverse(folder, ticks, drive):
    members = []
    for at, (r, w, x) in enumerate(itertools.product(RECONSTRUCTIONS, WINDOWS, EXTRACTORS)):
        name = f"{r}@{w}/{x}"
        path = folder / "rows" / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_rows(path, ticks, EXTRACTORS[x], at, drive)
        np.save(path.with_suffix(".present.npy"), np.ones(ticks, bool))
        members.append({"name": name, "dim": EXTRACTORS[x], "dtype": "f32", "present": ticks, "fingerprint": {"made": "up"}})
    second = 1_000_000
    lines = (f"{t},{t * second},{(t + 1) * second},{10 * t},0" for t in range(ticks))
    (folder / "ticks.csv").write_text("tick,start_us,end_us,east_m,north_m\n" + "\n".join(lines) + "\n")
    windows = [1_000_000 * ms for ms in WINDOWS.values()]
    slicing = {"mode": "time", "tick": 1_000_000_000, "windows": windows, "align": "start", "origin": "first_event"}
    manifest = {
        "format": "evpr-traverse", "version": 1, "created_by": "bench_study.py", "complete": True,
        "sensor": {"height": 260, "width": 346}, "slicing": slicing, "members": members, "ticks": ticks,
        "source": "random rows", "notes": "",
    }
    (folder / "traverse.json").write_text(json.dumps(manifest))


def anonymous_kib(pid):
    """Memory of a process that is not a file's, KiB; 0 when it has ended."""
    try:
        status = pathlib.Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    values = dict(line.split(":", 1) for line in status.splitlines() if ":" in line)
    return int(values.get("RssAnon", "0 kB").split()[0])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, required=True)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--evpr", default="target/release/evpr")
    parser.add_argument("--folder", type=pathlib.Path)
    parser.add_argument("--memory", type=int, default=2048, metavar="MIB")
    parser.add_argument("--make", action="store_true")
    args = parser.parse_args()
    if args.folder:
        args.folder.mkdir(parents=True, exist_ok=True)
        return study(args, args.folder)
    with tempfile.TemporaryDirectory() as folder:
        study(args, pathlib.Path(folder))


def study(args, folder):
    drives = next(n for n in itertools.count(2) if n * (n - 1) // 2 >= args.pairs)
    for drive in range(drives):
        if not (folder / f"drive{drive}" / "traverse.json").exists():
            write_traverse(folder / f"drive{drive}", args.ticks, drive)
    size = sum(f.stat().st_size for f in folder.rglob("*.npy"))
    print(f"{drives} traverses of {args.ticks} ticks, {size / 2**30:.1f} GiB", flush=True)
    if args.make:
        return
    pairs = itertools.islice(itertools.combinations(range(drives), 2), args.pairs)
    pair = '[[pair]]\nreference = "drive{}"\nquery = "drive{}"\nground_truth = "positions"\n'
    (folder / "pairs.toml").write_text("".join(pair.format(*p) for p in pairs))
    shutil.rmtree(folder / "out", ignore_errors=True)
    command = [args.evpr, "evaluate", "--quiet", "--pairs", folder / "pairs.toml", "-l", "10,20,30"]
    command += ["--memory", str(args.memory), "-o", folder / "out"]
    start, most = time.perf_counter(), 0
    process = subprocess.Popen(command)
    while process.poll() is None:
        most = max(most, anonymous_kib(process.pid))
        time.sleep(0.05)
    wall = time.perf_counter() - start
    if process.returncode:
        raise SystemExit(process.returncode)
    rows = json.loads((folder / "out" / "results.json").read_text())["rows"]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    compared = args.pairs * args.ticks**2 * 16 * sum(EXTRACTORS.values())
    print(f"{args.pairs} pairs, {len(rows)} configurations: {wall:.1f} s")
    print(f"processor time: {used.ru_utime:.1f} s, and {used.ru_stime:.1f} s of the system")
    print(f"{compared / wall / 1e9:.1f} billion values compared per second, everything else included")
    print(f"at most {most / 2**10:.0f} MiB of memory besides the mapped rows")
    recalls = lambda kind: [r["measures"]["recall_at"][0]["of_all"] for r in rows if r["kind"] == kind]
    print(f"Recall@1, mean: single {np.mean(recalls('single')):.3f}, combined {np.mean(recalls('combined')):.3f}")


if __name__ == "__main__":
    main()
