#!/usr/bin/env python3
"""Times networks in the running graph beside Python's onnxruntime on the same file, threads and spinning setting.

For each pair of a reconstruction and an extractor the recording is mapped, and then recognised at a pace slow enough that
no tick waits for another one. Printed are the medians over ticks, in ms: what Python's onnxruntime takes for one image of
each network, what the processes take (from `latency_us` of the answers), what they add to it, and window close → answer
beside the sum of its stages. Python runs the networks one after the other at the
graph's pace, and rounds of Python and of the graph alternate, so that both see the same machine and the same caches.

    scripts/bench_networks.py --evpr target/release/evpr --models models/models.toml --recording drive.aedat4 \
        --tick 6ms --tick-seconds 1 --pair event_count/cosplace --pair e2vid/cosplace

Needs Python 3.11 with numpy and onnxruntime (.cache/export-venv of scripts/export_models.py has them).
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import onnxruntime

import model_registry


def fail(text):
    print(f"bench_networks: {text}", file=sys.stderr)
    sys.exit(1)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evpr", type=Path, required=True, metavar="FILE")
    parser.add_argument("--models", type=Path, required=True, metavar="TOML")
    parser.add_argument("--recording", type=Path, required=True, metavar="FILE")
    parser.add_argument("--tick", default="100ms", help="period of the ticks, and the window")
    parser.add_argument("--tick-seconds", type=float, required=True, help="host time per tick: longer than one takes")
    parser.add_argument("--pair", action="append", required=True, metavar="RECONSTRUCTION/EXTRACTOR")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--spinning", action="store_true")
    parser.add_argument("--rounds", type=int, default=3)
    return parser.parse_args()


def seconds(text):
    for unit, scale in (("ms", 1e-3), ("us", 1e-6), ("s", 1.0)):
        if text.endswith(unit):
            return float(text[: -len(unit)]) * scale
    fail(f"{text} is no duration; write 100ms")


class Python:
    """One network in Python's onnxruntime, with threads and spinning as given."""

    def __init__(self, path, threads, spinning):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning else "0")
        self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        shapes = {i.name: [d if isinstance(d, int) else 1 for d in i.shape] for i in self.session.get_inputs()}
        random = np.random.default_rng(1)
        self.inputs = {name: random.standard_normal(shape).astype(np.float32) for name, shape in shapes.items()}
        self.times = []

    def run(self):
        started = time.perf_counter()
        self.session.run(None, self.inputs)
        self.times.append((time.perf_counter() - started) * 1e3)


def in_turns(networks, ticks, period):
    """As in the graph: one network after the other, begun once per `period` seconds, and nothing in between."""
    for _ in range(ticks):
        ends = time.perf_counter() + period
        for network in networks:
            network.run()
        time.sleep(max(ends - time.perf_counter(), 0.0))


def configuration(arguments, reconstruction, extractor):
    threads = f"threads = {arguments.threads}\n"
    models = model_registry.read(arguments.models)
    return (
        f'[slicing]\ntick = "{arguments.tick}"\nwindows = ["{arguments.tick}"]\n'
        f'[inference]\nmodels = "{arguments.models.resolve()}"\nspinning = {str(arguments.spinning).lower()}\n'
        f'[[reconstruction]]\nid = "{reconstruction}"\n{threads if reconstruction in models else ""}'
        f'[[extractor]]\nid = "{extractor}"\n{threads if extractor in models else ""}'
    )


def answers(arguments, folder, pace):
    """The latencies of one run, in ms per stage, without its first tick."""
    run = [arguments.evpr, "run", "-q", "--name", f"bench{os.getpid()}", "-c", folder / "graph.toml", "-i", arguments.recording]
    out = subprocess.run([*run, "-m", folder / "map", "--pace", str(pace)], check=True, capture_output=True, text=True).stdout
    latencies = [json.loads(line)["latency_us"] for line in out.splitlines()]
    return [{stage: us / 1e3 for stage, us in latency.items()} for latency in latencies[1:] if latency]


def measure(arguments, pair):
    reconstruction, _, extractor = pair.partition("/")
    models = model_registry.read(arguments.models)
    python = {
        name: Python(models[name]["path"], arguments.threads, arguments.spinning)
        for name in (reconstruction, extractor)
        if name in models
    }
    pace = seconds(arguments.tick) / arguments.tick_seconds
    latencies = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "graph.toml").write_text(configuration(arguments, reconstruction, extractor))
        build = [arguments.evpr, "map", "build", "-q", "--name", f"bench{os.getpid()}", "-c", folder / "graph.toml"]
        subprocess.run([*build, "-i", arguments.recording, "-o", folder / "map"], check=True)
        in_turns(python.values(), 2, 0.0)
        for network in python.values():
            network.times.clear()
        for _ in range(arguments.rounds):
            in_turns(python.values(), 10, arguments.tick_seconds)
            latencies += answers(arguments, folder, pace)
    middle = lambda stage: statistics.median(latency[stage] for latency in latencies)
    print(f"{pair}, {arguments.threads} thread(s), {len(latencies)} ticks:")
    for stage, name in (("reconstruct", reconstruction), ("extract", extractor)):
        if name in python:
            alone, here = statistics.median(python[name].times), middle(stage)
            added = f"{here - alone:+.2f} ms, {100 * (here / alone - 1):+.1f} %"
            print(f"  {name:<22} Python {alone:8.2f}   process {here:8.2f}   added {added}")
        else:
            print(f"  {name:<22} process {middle(stage):8.2f}")
    stages = sum(middle(stage) for stage in ("reconstruct", "extract", "fuse"))
    between = statistics.median(l["total"] - l["reconstruct"] - l["extract"] - l["fuse"] for l in latencies)
    print(f"  window close → answer {middle('total'):.2f}, stages {stages:.2f}, between them {between:.2f} (median over ticks)")


def main():
    given = arguments()
    for path in (given.evpr, given.models, given.recording):
        if not path.exists():
            fail(f"{path} is not there")
    given.evpr = given.evpr.resolve()
    for pair in given.pair:
        try:
            measure(given, pair)
        except subprocess.CalledProcessError as error:
            said = error.stderr if isinstance(error.stderr, str) else ""
            fail(f"{pair}: evpr failed with {error.returncode}: {said.strip()}")


if __name__ == "__main__":
    main()
