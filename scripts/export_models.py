#!/usr/bin/env python3
"""Exports networks as ONNX files for evpr, each with an entry in the models.toml beside it.

Needs Python 3.11 and PyTorch. On its first call it makes a virtual environment in .cache/export-venv (EVPR_CACHE_DIR takes
the place of .cache) with the packages of export-requirements.txt, and runs itself there; with --python in front of the
network's name it runs in the Python it was called with.

    scripts/export_models.py mobilenet --size 260x346
    scripts/export_models.py cosplace --weights ResNet50_2048_cosplace.pth
    scripts/export_models.py e2vid --random 1 --stateless
"""

import argparse
import hashlib
import os
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

from networks import NETWORKS, SIZE, Failure, note

SCRIPTS = Path(__file__).resolve().parent
ROOT = SCRIPTS.parent
REQUIREMENTS = SCRIPTS / "export-requirements.txt"
TORCH_CPU = "https://download.pytorch.org/whl/cpu"


def fail(text):
    print(f"export_models: {text}", file=sys.stderr)
    sys.exit(1)


def cpu_index_answers():
    try:
        with urllib.request.urlopen(f"{TORCH_CPU}/torch/", timeout=10):
            return True
    except OSError:
        return False


def cache():
    return Path(os.environ.get("EVPR_CACHE_DIR") or ROOT / ".cache").absolute()


def into_environment():
    """Makes the virtual environment where it is not there yet, and runs this script in it."""
    environment = cache() / "export-venv"
    python = environment / "bin" / "python"
    if Path(sys.prefix).resolve() == environment.resolve():
        return
    stamp = environment / "requirements.sha256"
    wanted = hashlib.sha256(REQUIREMENTS.read_bytes()).hexdigest()
    if not stamp.exists() or stamp.read_text() != wanted:
        command = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--requirement", str(REQUIREMENTS)]
        if cpu_index_answers():
            command += ["--extra-index-url", TORCH_CPU]
        else:
            print(f"{TORCH_CPU} cannot be reached: PyTorch comes with CUDA, 3 GB to fetch and 6 GB on disk", file=sys.stderr)
        try:
            subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True, stdout=sys.stderr)
            subprocess.run(command, check=True, stdout=sys.stderr)
        except (OSError, subprocess.CalledProcessError):
            fail(f"{environment} could not be made (pip's words are above): install {REQUIREMENTS} yourself and pass --python")
        stamp.write_text(wanted)
    os.execv(python, [str(python), str(Path(__file__).resolve()), *sys.argv[1:]])


def size(text):
    try:
        height, width = (int(part) for part in text.split("x"))
        if min(height, width) < 8 or max(height, width) > 4096:
            raise ValueError
        return height, width
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not HEIGHTxWIDTH in pixels, 8 to 4096") from None


def arguments():
    parser = argparse.ArgumentParser(
        prog="export_models.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", action="store_true", help="run in this Python, without a virtual environment")
    commands = parser.add_subparsers(dest="network", required=True, metavar="NETWORK")
    for network in NETWORKS.values():
        weights = f"Weights: {network.url}\nLicence: {network.licence}"
        command = commands.add_parser(
            network.name,
            help=network.about,
            description=f"{network.about}\n\n{weights}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        seen = "frames: an .npy stack, or a folder of .npy or .png"
        if not network.extractor:
            seen = "voxel grids (T, bins, H, W): an .npy"
        one = command.add_mutually_exclusive_group()
        one.add_argument("--weights", type=Path, metavar="FILE", help="the authors' weights")
        one.add_argument("--random", type=int, metavar="SEED", help="random weights, for tests and timing")
        command.add_argument("--unpickle", action="store_true", help="read FILE as any pickle: this runs what is in it")
        command.add_argument("--size", type=size, default=SIZE, metavar="HxW", help="of the frames; default 260x346")
        command.add_argument("--out", type=Path, default=ROOT / "models", metavar="DIR", help="default: models/ of this checkout")
        command.add_argument("--id", help="the entry's id and the file's name; default: the network's name and variant")
        command.add_argument("--int8", action="store_true", help="quantise to 8 bit; needs --calibration, but for megaloc")
        command.add_argument("--calibration", type=Path, metavar="PATH", help=seen)
        if not network.extractor:
            said = "compare with a file's outputs y for its inputs x, in order"
            command.add_argument("--check", type=Path, metavar="NPZ", help=said)
        else:
            command.add_argument("--batch", action="store_true", help="any number of images at once")
        if network.name == "e2vid":
            command.add_argument("--stateless", action="store_true", help="every image from a zero state, with fewer operations")
        if network.name == "netvlad":
            command.add_argument("--whiten", action="store_true", help="whitened to 4096 values")
        if network.name in ("mixvpr", "megaloc"):
            command.add_argument("--resize-outside", action="store_true", help="leave the resizing of frames to whoever feeds it")
    return parser.parse_args()


def find_weights(network, options):
    """What identifies the weights, their licence and their source; fails where no weights are named."""
    if options.random is not None:
        return f"random:{options.random}", "none needed", f"random weights, seed {options.random}"
    if options.weights is None:
        digest = f"SHA-256 {network.sha256}" if network.sha256 else "its SHA-256 is not known here; the export records it"
        raise Failure(
            f"{network.name} needs its weights: download {network.url} and pass --weights FILE, or --random SEED "
            f"(licence: {network.licence}; {digest})"
        )
    if not options.weights.is_file():
        raise Failure(f"{options.weights}: no such file")
    with open(options.weights, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if network.sha256 and digest != network.sha256:
        note(f"{options.weights} has SHA-256 {digest}, not the {network.sha256} that is known")
    return digest, network.licence, network.url


def refuse_early(network, options):
    if options.int8 and network.name == "firenet":
        raise Failure("firenet gains nothing from 8 bit: leave out --int8")
    if options.int8 and network.name != "megaloc" and options.calibration is None:
        raise Failure("--int8 needs --calibration PATH: frames, or voxel grids, of the kind the network will see")
    if options.id and not re.fullmatch(r"[a-z0-9_-]{1,64}", options.id):
        raise Failure(f"--id '{options.id}': write 1 to 64 of a-z, 0-9, _ and -")


def variant_id(options):
    parts = [options.network]
    parts += [name for name in ("stateless", "whiten", "int8") if getattr(options, name, False)]
    return "_".join(parts)


def export(network, options):
    import torch

    import model_registry
    from networks import onnx_file, quantise, weights

    torch.set_num_threads(onnx_file.THREADS)
    builder = network.builder()
    if options.weights is None and options.random is None and hasattr(builder, "packaged"):
        options.weights = builder.packaged(cache())
    identity, licence, source = find_weights(network, options)
    if options.random is None:
        checkpoint = getattr(builder, "read", weights.read_torch)(options.weights, options.unpickle)
    else:
        torch.manual_seed(options.random)
        checkpoint = None
    module = builder.build(options, checkpoint).eval()
    entry = builder.entry(options, module, licence, source)
    parameters, multiplications = onnx_file.count(module)
    note(f"{options.network}: {parameters / 1e6:.2f} M parameters, {multiplications / 1e9:.2f} GMAC")
    if getattr(options, "check", None):
        onnx_file.check_steps(module, options.check)

    name = options.id or variant_id(options)
    path = options.out / f"{name}.onnx"
    options.out.mkdir(parents=True, exist_ok=True)
    batch = getattr(options, "batch", False)
    model = onnx_file.export(module, batch)
    if options.int8:
        model = quantise.quantise(model, module, entry, options)
        entry["source"] += "; 8 bit by scripts/export_models.py"
    temporary = onnx_file.save(model, model_registry.metadata(entry, identity, multiplications), path)
    try:
        if options.int8:
            quantise.compare(module, temporary, entry, options)
        else:
            onnx_file.compare(module, temporary, batch)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    model_registry.put(options.out / "models.toml", name, path, entry)
    note(f'{path}: {path.stat().st_size / 1e6:.1f} MB, entry "{name}" in {options.out / "models.toml"}')


def main():
    if sys.version_info < (3, 11):
        fail(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    options = arguments()
    network = NETWORKS[options.network]
    try:
        refuse_early(network, options)
        if options.random is not None or options.weights is not None or not network.packaged:
            find_weights(network, options)
        if not options.python:
            into_environment()
        export(network, options)
    except ImportError as error:
        fail(f"{error}: install {REQUIREMENTS}, or leave out --python")
    except (Failure, OSError) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
