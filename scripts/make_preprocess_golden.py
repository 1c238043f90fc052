#!/usr/bin/env python3
"""Makes tests/models/golden/preprocess: frames, and what networks are fed of them, by PIL and torchvision.

Run by hand, with the Python of scripts/export_models.py; what it writes is committed.

    .cache/export-venv/bin/python scripts/make_preprocess_golden.py
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torchvision.transforms import functional as T

import model_registry
import preprocess

OUT = Path(__file__).parent.parent / "tests" / "models" / "golden" / "preprocess"
# What the published networks take: see `input` and `resize` in model_registry.py.
IMAGENET = {"color": "rgb", "range": 1.0, "mean": model_registry.IMAGENET_MEAN, "std": model_registry.IMAGENET_STD}
CAFFE = {"color": "bgr", "range": 255.0, "mean": [103.939, 116.779, 123.68], "std": [1.0, 1.0, 1.0]}
GREY = {"color": "grey", "range": 1.0, "mean": [0.5], "std": [0.25]}
# case: (frame, how, resized to (height, width) or None)
CASES = {
    "imagenet_bgr": ("bgr", IMAGENET, None),
    "imagenet_one_channel": ("one_channel", IMAGENET, None),
    "imagenet_bgr_32x20": ("bgr", IMAGENET, (32, 20)),
    "imagenet_one_channel_14x14": ("one_channel", IMAGENET, (14, 14)),
    "imagenet_large_28x42": ("large", IMAGENET, (28, 42)),
    "caffe_bgr": ("bgr", CAFFE, None),
    "caffe_large_20x31": ("large", CAFFE, (20, 31)),
    "grey_bgr": ("bgr", GREY, None),
    "grey_one_channel_13x40": ("one_channel", GREY, (13, 40)),
}


def frames():
    """Noise over a slope, with black patches, as event frames have."""
    random = np.random.RandomState(11)

    def frame(*shape):
        levels = random.randint(0, 120, shape) + np.linspace(0, 135, shape[1]).reshape(1, -1, *[1] * (len(shape) - 2))
        levels[random.uniform(size=shape) < 0.2] = 0
        return levels.astype(np.uint8)

    return {"bgr": frame(26, 35, 3), "one_channel": frame(26, 35), "large": frame(104, 139, 3)}


def fed(frame, how, size):
    """By PIL and torchvision: image → tensor in 0…1 → resized → range → mean and std."""
    image = Image.fromarray(frame[:, :, ::-1] if frame.ndim == 3 else frame)
    if how["color"] == "grey":
        tensor = T.to_tensor(image.convert("L"))
    else:
        tensor = T.to_tensor(image.convert("RGB"))
    if how["color"] == "bgr":
        tensor = tensor.flip(0)
    if size:
        tensor = T.resize(tensor, list(size), T.InterpolationMode.BILINEAR, antialias=True)
    return T.normalize(tensor * how["range"], how["mean"], how["std"]).numpy()


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    inputs = frames()
    for name, frame in inputs.items():
        np.save(OUT / f"frame_{name}.npy", frame)
    torch.set_num_threads(1)
    rows = []
    for case, (name, how, size) in CASES.items():
        golden = fed(inputs[name], how, size)
        np.save(OUT / f"{case}.npy", golden)
        entry = how | {"id": case, "resize": "antialiased_bilinear" if size else "none", "input": "{}x{}".format(*size or "--")}
        difference = np.abs(preprocess.tensor(inputs[name], entry, None) - golden).max() / max(how["range"], 1)
        # PIL's grey of three colours is rounded to a whole level.
        allowed = 0.5 / 255 / min(how["std"]) * 1.01 if case == "grey_bgr" else 1e-5
        print(f"{case}: {golden.shape}, differs from preprocess.py by {difference:.1e}")
        if difference > allowed:
            raise SystemExit(f"{case}: two independent ways differ by {difference:.1e}, more than {allowed:.1e}")
        said = f"{how['color']}, {how['range']:g}, {how['mean']}, {how['std']}"
        rows.append(f"| `{case}.npy` | `frame_{name}` | {said} | {golden.shape} |")
    (OUT / "README.md").write_text(README + "\n".join(rows) + "\n")


README = """# Frames, and what networks are fed of them

Written by `scripts/make_preprocess_golden.py` with PIL and torchvision. `frame_bgr.npy` (26, 35, 3) and `frame_large.npy`
(104, 139, 3) are u8 in the order blue, green, red; `frame_one_channel.npy` (26, 35) is u8. The others are f32 (channels,
height, width): level / 255, resized by antialiased bilinear interpolation where the size differs from the frame's, times
range, less mean, over standard deviation. Grey of three colours is rounded to whole levels, as PIL does (`grey_bgr.npy`:
half a level of difference is right). The published networks are those called `imagenet`.

| file | frame | colour, range, mean, standard deviation | shape |
|---|---|---|---|
"""

if __name__ == "__main__":
    main()
