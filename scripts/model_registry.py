"""What is said of a network, twice: in the ONNX file (`metadata_props`, keys beginning `evpr.`) and in its registry (`models.toml`).

Used by export_models.py, make_fixture_models.py and compare_descriptors.py. Needs Python 3.11.
"""

import hashlib
import re
import tomllib
from pathlib import Path

IMAGENET_MEAN = [0.485, 0.456, 0.406]
IMAGENET_STD = [0.229, 0.224, 0.225]


def extractor(*, dimension, licence, source, input="native", resize="none", color="rgb", range=1.0, mean=None, std=None):
    """An extractor's entry, without id, file and sha256.

    input: "native", "HxW" or "multiple:N"; resize: "none" (the network takes the frame as it is) or
    "antialiased_bilinear" (whoever feeds it resizes to `input`); range: what level 255 becomes before mean and std.
    """
    return {
        "kind": "extractor",
        "input": input,
        "resize": resize,
        "color": color,
        "range": float(range),
        "mean": mean or IMAGENET_MEAN,
        "std": std or IMAGENET_STD,
        "output": "descriptor",
        "dimension": dimension,
        "licence": licence,
        "source": source,
    }


def reconstruction(*, multiple, states, licence, source, bins=5):
    """A reconstruction's entry, without id, file and sha256. states: the names of the state inputs; each output is NAME_out."""
    return {
        "kind": "reconstruction",
        "bins": bins,
        "multiple": multiple,
        "states": list(states),
        "output": "image",
        "licence": licence,
        "source": source,
    }


def metadata(entry, weights_sha256, multiplications=None):
    """The `metadata_props` of the file that `entry` describes; weights_sha256: of the weights' file, or "random:<seed>"; multiplications: with additions, for one image."""
    numbers = lambda values: ",".join(f"{v:g}" for v in values)
    props = {"kind": entry["kind"], "weights_sha256": weights_sha256, "source": entry["source"], "licence": entry["licence"]}
    if entry["kind"] == "extractor":
        props |= {
            "input_size": entry["input"],
            "resize": entry["resize"],
            "color": entry["color"],
            "range": f"{entry['range']:g}",
            "mean": numbers(entry["mean"]),
            "std": numbers(entry["std"]),
            "dimension": str(entry["dimension"]),
        }
    else:
        props |= {"bins": str(entry["bins"]), "multiple": str(entry["multiple"]), "states": ",".join(entry["states"])}
    if multiplications is not None:
        props["gmacs"] = f"{multiplications / 1e9:.4g}"
    return {f"evpr.{key}": value for key, value in props.items()}


def sha256_of(path):
    """The file's SHA-256, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _value(value):
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)


def stanza(name, file, sha256, entry):
    """The registry's `[[model]]` stanza of a network."""
    ordered = {"id": name, "kind": entry["kind"], "file": file, "sha256": sha256}
    ordered |= {key: value for key, value in entry.items() if key != "kind"}
    return "[[model]]\n" + "".join(f"{key} = {_value(value)}\n" for key, value in ordered.items())


def put(registry, name, path, entry):
    """Writes the entry of the file at `path` into `registry`, in the place of one with the same id; the others stay as they are."""
    registry, path = Path(registry), Path(path)
    head = "# Networks. Written by scripts/export_models.py; other entries may be added by hand.\n"
    text = registry.read_text() if registry.exists() else head
    before, *stanzas = re.split(r"(?m)^[ \t]*\[\[[ \t]*model[ \t]*\]\][ \t]*(?:#[^\n]*)?\r?\n", text)
    new = stanza(name, path.relative_to(registry.parent).as_posix(), sha256_of(path), entry)
    kept, replaced = [], False
    for old in stanzas:
        old = "[[model]]\n" + old.rstrip("\n") + "\n"
        if tomllib.loads(old)["model"][0]["id"] == name:
            old, replaced = new, True
        kept.append(old)
    if not replaced:
        kept.append(new)
    text = "\n".join([before.rstrip("\n") + "\n", *kept])
    tomllib.loads(text)
    temporary = registry.with_suffix(".toml.new")
    temporary.write_text(text)
    temporary.replace(registry)


def read(registry):
    """The registry's entries by id, each with the key `path`."""
    registry = Path(registry)
    models = tomllib.loads(registry.read_text())["model"]
    return {model["id"]: model | {"path": registry.parent / model["file"]} for model in models}
