#!/usr/bin/env python3
"""Measures what each stage of the graph takes of the time from the closing of a window to the answer.

    scripts/bench_stages.py [--evpr FILE] [--corridor DIR] [--seconds S] [STREAM…]

STREAM: corridor (a real recording, 128×128), 346x260 (the simulated street by day, its second drive against a map of the
first), 1280x720 (random events, 5 M per second). All run at their own pace, latest delivery, half-second ticks, three
reconstructions, two windows and two extractors. Prints a table for docs/performance.md: p50 and p99 per stage, and its share of the sum of medians.
Needs Python 3 and nothing else, and for 1280x720 the example make_events
(cargo build --release -p evpr-events --example make_events) and 65 MB per second in the temporary folder.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

STAGES = """
[[reconstruction]]
id = "event_count"
[[reconstruction]]
id = "event_count_no_polarity"
[[reconstruction]]
id = "time_surface"
[[extractor]]
id = "patch_norm"
[[extractor]]
id = "hog"
[fuse]
sequence = { method = "paper", length = 10 }
"""
STREET = """
[sensor]
height = 260
width = 346
[source]
kind = "street"
[source.street]
length_m = {length}
speed_m_s = 5.0
[slicing]
tick = "500ms"
windows = ["250ms", "500ms"]
"""
RECORDING = """
[slicing]
tick = "500ms"
windows = ["250ms", "500ms"]
"""
STAGE_NAMES = ("reconstruct", "extract", "fuse", "total")


def quantile(values, q):
    values = sorted(values)
    return values[min(int(q * len(values)), len(values) - 1)]


def evpr(arguments, *words):
    done = subprocess.run([arguments.evpr, *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"bench_stages: evpr {words[0]} failed with {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def measure(arguments, stream, folder):
    config = folder / f"{stream}.toml"
    if stream == "corridor":
        config.write_text(RECORDING + STAGES)
        reference, query = arguments.corridor / "reference_events.h5", arguments.corridor / "query_events.h5"
    elif stream == "1280x720":
        config.write_text("[sensor]\nheight = 720\nwidth = 1280\n" + RECORDING + STAGES)
        reference = query = folder / "random.npy"
        make = arguments.evpr.parent / "examples/make_events"
        subprocess.run([make, query, "5000000", str(arguments.seconds), "720", "1280"], check=True, capture_output=True)
    else:
        config.write_text(STREET.format(length=5 * arguments.seconds) + STAGES)
        reference, query = "day", "day2"
    name = f"stages{os.getpid()}"
    built = folder / stream
    evpr(arguments, "map", "build", "-q", "--name", name, "-c", config, "-i", reference, "-o", built)
    live = ["--pace", "realtime", "--delivery", "latest"]
    out = evpr(arguments, "run", "-q", "--name", name, "-c", config, "-i", query, "-m", built, *live)
    answers = [json.loads(line) for line in out.splitlines()]
    # The first ticks wake everything up.
    latencies = [a["latency_us"] for a in answers[10:] if a.get("latency_us")]
    missing = sum(1 for a in answers if a["missing"])
    middle = {s: quantile([l[s] for l in latencies], 0.5) / 1e3 for s in STAGE_NAMES}
    worst = {s: quantile([l[s] for l in latencies], 0.99) / 1e3 for s in STAGE_NAMES}
    whole = sum(middle[s] for s in STAGE_NAMES if s != "total")
    print(f"\n{stream}: {len(answers)} ticks, {missing} with something missing\n")
    print("| stage | p50 ms | p99 ms | share |\n|---|---|---|---|")
    for s in STAGE_NAMES:
        share = "" if s == "total" else f"{100 * middle[s] / whole:.0f} %"
        label = "window closed → answer" if s == "total" else s
        print(f"| {label} | {middle[s]:.2f} | {worst[s]:.2f} | {share} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", nargs="*", metavar="STREAM")
    parser.add_argument("--evpr", type=Path, default=ROOT / "target/release/evpr", metavar="FILE")
    parser.add_argument("--corridor", type=Path, default=ROOT.parent / "shared/data/corridor", metavar="DIR")
    parser.add_argument("--seconds", type=int, default=30, help="length of the simulated streams")
    given = parser.parse_args()
    streams = given.streams or ["corridor", "346x260", "1280x720"]
    for stream in streams:
        if stream not in ("corridor", "346x260", "1280x720"):
            parser.error(f"{stream}: no such stream")
    if not given.evpr.exists():
        parser.error(f"{given.evpr} is not there: cargo build --release")
    with tempfile.TemporaryDirectory() as folder:
        for stream in streams:
            measure(given, stream, Path(folder))


if __name__ == "__main__":
    main()
