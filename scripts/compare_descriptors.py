#!/usr/bin/env python3
"""Compares the rows of a recorded traverse with the same networks run by Python's onnxruntime on the same frames.

Prints the largest absolute difference per member; exits with 1 where one is above 1e-4, or where nothing could be
compared. Members of built-in extractors are left out, by name. Needs Python 3.11, onnxruntime, numpy and pillow
(.cache/export-venv of scripts/export_models.py has them).

    evpr events reconstruct drive.h5 --method event_count --window 250ms --tick 1s --out ec250.npy
    scripts/compare_descriptors.py --models models/models.toml --map drive.map --frames event_count@250ms=ec250.npy

The frames must be those of the traverse: the same recording, tick, alignment, origin and filters. A folder of pictures
as written by `evpr events render` serves for one-channel frames too; the .npy is exact for all.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import onnxruntime

import model_registry
import preprocess

TOLERANCE = 1e-4


def fail(text):
    print(f"compare_descriptors: {text}", file=sys.stderr)
    sys.exit(1)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, metavar="TOML", help="the registry the traverse was made with")
    parser.add_argument("--map", type=Path, required=True, metavar="DIR", help="the traverse")
    parser.add_argument(
        "--frames",
        action="append",
        required=True,
        metavar="[RECONSTRUCTION@WINDOW=]PATH",
        help="frames, an .npy stack or a folder; the name may be left out where the traverse has one only",
    )
    return parser.parse_args()


def members(folder):
    """Member → its file of rows."""
    rows = folder / "rows"
    files = sorted(file for file in rows.rglob("*.npy") if not file.name.endswith(".present.npy"))
    return {file.relative_to(rows).as_posix().removesuffix(".npy"): file for file in files}


def named_frames(given, names):
    """Reconstruction@window → path."""
    frames = {}
    for text in given:
        name, separator, path = text.partition("=")
        if not separator:
            if len(names) != 1:
                fail(f"--frames {text}: say of which: NAME={text}, with NAME one of {', '.join(names)}")
            name, path = names[0], text
        if name not in names:
            fail(f"--frames {text}: the traverse has no '{name}', but {', '.join(names)}")
        frames[name] = path
    return frames


def open_network(model):
    if model["kind"] != "extractor":
        fail(f"{model['id']} is a reconstruction in the registry, and an extractor in the traverse")
    if model_registry.sha256_of(model["path"]) != model["sha256"]:
        fail(f"{model['path']} is not the file that the registry describes: its SHA-256 differs")
    session = onnxruntime.InferenceSession(model["path"], providers=["CPUExecutionProvider"])
    shape = session.get_inputs()[0].shape[2:]
    return session, shape if all(isinstance(length, int) for length in shape) else None


def compare(model, rows_file, frames):
    """(largest absolute difference, rows compared)."""
    session, shape = open_network(model)
    rows = np.load(rows_file, mmap_mode="r")
    present = np.load(rows_file.with_suffix(".present.npy"))
    worst, count = 0.0, 0
    for tick, frame in preprocess.read_frames(frames):
        if tick >= len(present) or not present[tick]:
            continue
        image = preprocess.tensor(frame, model, shape)[None]
        descriptor = session.run([model["output"]], {session.get_inputs()[0].name: image})[0][0].astype(np.float64)
        # A row has length one.
        descriptor /= max(np.linalg.norm(descriptor), 1e-12)
        row = rows[tick].astype(np.float64)
        if row.shape != descriptor.shape:
            raise ValueError(f"rows have {row.size} values, the network gives {descriptor.size}")
        difference = np.abs(row - descriptor).max()
        worst = max(worst, difference if np.isfinite(difference) else np.inf)
        count += 1
    return worst, count


def main():
    options = arguments()
    try:
        models = model_registry.read(options.models)
        rows = members(options.map)
        if not rows:
            fail(f"{options.map}: no rows: is it a finished traverse?")
        names = sorted({member.rpartition("/")[0] for member in rows})
        frames = named_frames(options.frames, names)
        compared, bad = 0, 0
        for member, file in rows.items():
            source, _, extractor = member.rpartition("/")
            if extractor not in models:
                print(f"{member}: left out: {extractor} is not in {options.models}")
            elif source not in frames:
                print(f"{member}: left out: no --frames {source}=…")
            else:
                worst, count = compare(models[extractor], file, frames[source])
                if count == 0:
                    fail(f"{member}: none of its ticks has a frame in {frames[source]}")
                verdict = "" if worst <= TOLERANCE else f": above {TOLERANCE:g}"
                print(f"{member}: largest difference {worst:.2e} over {count} rows{verdict}")
                compared += 1
                bad += worst > TOLERANCE
    except (OSError, ValueError, KeyError) as error:
        fail(str(error))
    if compared == 0:
        fail("nothing was compared")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
