#!/usr/bin/env python3
"""Measures the whole process graph on this machine: throughput, latency, processor time and memory.

    scripts/bench_graph.py [throughput] [paced] [soak] [--folder DIR]

Builds evpr, writes recordings of random events (346x260) into the folder (default: a temporary one), runs them through
real processes, and prints what docs/performance.md states. Needs Python 3 and nothing else.

throughput  maps a recording unpaced: 5 M and 25 k events per second of sensor time, 3 methods, 4 windows. Two lengths
            are run; the rate is that of their difference, so that starting processes does not count.
paced       1 M events per second in real time: latency per stage, processor time and memory with 24 members.
soak        the same, ten minutes of sensor time at four times the pace: memory at each minute.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
EVPR = TARGET / "release" / "evpr"
MAKE = TARGET / "release" / "examples" / "make_events"
TICK_S = os.sysconf("SC_CLK_TCK")

CONFIG = """
[run]
name = "bench-{name}"
[sensor]
height = 260
width = 346
[source]
path = "{source}"
[slicing]
tick = "1s"
windows = ["100ms", "250ms", "500ms", "1s"]
[[reconstruction]]
id = "event_count"
[[reconstruction]]
id = "event_count_no_polarity"
[[reconstruction]]
id = "time_surface"
{extractors}
[fuse]
sequence = {{ method = "paper", length = 10 }}
"""


def config(folder, name, source, extractors):
    path = folder / f"{name}.toml"
    stanzas = "".join(f'[[extractor]]\nid = "{e}"\n' for e in extractors)
    path.write_text(CONFIG.format(name=name, source=source, extractors=stanzas))
    return path


def recording(folder, rate, seconds):
    path = folder / f"{rate}x{seconds}.npy"
    if not path.exists():
        subprocess.run([MAKE, path, str(rate), str(seconds)], check=True)
    return path


def build_map(folder, name, source, extractors):
    """Maps a recording; returns the map and the wall time, s."""
    out = folder / f"map-{name}"
    subprocess.run(["rm", "-rf", out], check=True)
    path = config(folder, name, source, extractors)
    started = time.monotonic()
    run = subprocess.run([EVPR, "map", "build", "-c", path, "-o", out, "--quiet"], capture_output=True, text=True)
    took = time.monotonic() - started
    if run.returncode != 0:
        sys.exit(f"evpr map build failed: {run.stderr}")
    return out, took


def throughput(folder):
    for rate, lengths in ((5_000_000, (6, 30)), (25_000, (400, 2_000))):
        best = None
        for _ in range(3):
            took = []
            for seconds in lengths:
                source = recording(folder, rate, seconds)
                subprocess.run(["cat", source], stdout=subprocess.DEVNULL, check=True)  # into the page cache
                took.append(build_map(folder, "throughput", source, ["raw_pixels"])[1])
            events = rate * (lengths[1] - lengths[0])
            figure = events / (took[1] - took[0])
            best = max(best or 0, figure)
            print(f"  {rate:>9} events/s of sensor time: {figure / 1e6:8.2f} M events/s, "
                  f"{figure / rate:7.0f} times real time ({took[0]:.2f} s and {took[1]:.2f} s in all)")
        print(f"  best: {best / 1e6:.2f} M events/s through the processes")


def children(pid):
    found, todo = [], [pid]
    while todo:
        parent = todo.pop()
        for task in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                kids = [int(k) for k in task.read_text().split()]
            except OSError:
                continue
            found += kids
            todo += kids
    return found


def sample(pid):
    """Processor time, s, and memory, MiB, of a process and its children: in all, and without pages of files."""
    cpu, memory, files = {}, 0.0, 0.0
    for one in [pid, *children(pid)]:
        try:
            stat = Path(f"/proc/{one}/stat").read_text()
            rollup = Path(f"/proc/{one}/smaps_rollup").read_text()
            arguments = Path(f"/proc/{one}/cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        fields = stat.rsplit(")", 1)[1].split()
        name = arguments[2].decode() if arguments[1:2] == [b"service"] else "supervisor"
        cpu[f"{name} {one}"] = (int(fields[11]) + int(fields[12])) / TICK_S
        # Shared pages are divided among those who share them.
        pss = {line.split(":")[0]: int(line.split()[1]) for line in rollup.splitlines()[1:]}
        memory += pss["Pss"] / 1024
        files += pss.get("Pss_File", 0) / 1024
    return cpu, memory, files


def follow(folder, name, source, pace, every_s):
    """Runs a recording against the map of itself, paced; samples what its processes take."""
    extractors = ["patch_norm", "hog"]
    place, _ = build_map(folder, name, recording(folder, 1_000_000, 60), extractors)
    path = config(folder, name, source, extractors)
    out = folder / f"{name}.jsonl"
    command = [EVPR, "run", "-c", path, "-m", place, "--pace", str(pace), "--delivery", "latest", "--out", out, "--quiet"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    samples, started = [], time.monotonic()
    while True:
        try:
            process.wait(every_s)
            break
        except subprocess.TimeoutExpired:
            samples.append((time.monotonic() - started, *sample(process.pid)))
    if process.returncode != 0:
        sys.exit(f"evpr run failed with {process.returncode}")
    return samples, [json.loads(line) for line in out.read_text().splitlines()]


def quantile(values, q):
    values = sorted(values)
    return values[min(len(values) - 1, int(q * len(values)))]


def latency(lines):
    whole = [line for line in lines if not line["missing"]]
    print(f"  {len(lines)} ticks answered, {len(whole)} of all {len(lines[-1]['members'])} members; load {os.getloadavg()[0]:.2f}")
    for stage in ("reconstruct", "extract", "fuse", "total"):
        values = [line["latency_us"][stage] / 1e3 for line in whole if line["latency_us"][stage] is not None]
        print(f"  {stage:<12} p50 {quantile(values, 0.5):7.3f} ms   p99 {quantile(values, 0.99):7.3f} ms")


def paced(folder):
    samples, lines = follow(folder, "paced", recording(folder, 1_000_000, 60), 1, 2)
    latency(lines)
    first, last = samples[2], samples[-1]
    wall = last[0] - first[0]
    for name, cpu in last[1].items():
        print(f"  {name:<22} {(cpu - first[1].get(name, 0)) / wall * 100:5.1f} % of a core")
    total = sum(last[1].values()) - sum(first[1].values())
    print(f"  all processes          {total / wall * 100:5.1f} % of a core; memory at most "
          f"{max(s[2] for s in samples):.0f} MiB, of it {max(s[3] for s in samples):.0f} MiB pages of the executable and the map")


def soak(folder):
    samples, lines = follow(folder, "soak", recording(folder, 1_000_000, 600), 4, 5)
    latency(lines)
    for at, _, memory, files in samples[:: max(1, len(samples) // 10)]:
        print(f"  at {at * 4:5.0f} s of the recording: {memory:6.1f} MiB, without pages of files {memory - files:6.1f} MiB")


PARTS = {"throughput": throughput, "paced": paced, "soak": soak}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="throughput, paced, soak (default: all)")
    parser.add_argument("--folder", type=Path, help="where recordings and maps are kept")
    arguments = parser.parse_args()
    unknown = [p for p in arguments.parts if p not in PARTS]
    if unknown:
        parser.error(f"there is no part {unknown[0]}; there are {', '.join(PARTS)}")
    os.chdir(ROOT)
    subprocess.run(["cargo", "build", "--release", "--quiet", "-p", "evpr"], check=True)
    subprocess.run(["cargo", "build", "--release", "--quiet", "-p", "evpr-events", "--example", "make_events"], check=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for part in arguments.parts or PARTS:
            print(part)
            PARTS[part](folder.resolve())


if __name__ == "__main__":
    main()
