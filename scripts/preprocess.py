"""Frames as evpr makes them → what a network is fed, in NumPy. Used to compare and to calibrate; needs Pillow.

A frame is u8, (H, W) or (H, W, 3) in the order blue, green, red.
"""

from pathlib import Path

import numpy as np
from PIL import Image


def read_frames(path):
    """(number of the frame's tick, frame) for each frame of an .npy stack (ticks, H, W[, 3]), or of a folder of .npy or .png."""
    path = Path(path)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix in (".npy", ".png"))
    else:
        files = [path]
    tick = 0
    for file in files:
        frames = np.load(file, mmap_mode="r") if file.suffix == ".npy" else read_png(file)[None]
        if frames.dtype != np.uint8:
            raise ValueError(f"{file}: {frames.dtype}, not u8")
        # (H, W) or (H, W, 3) is one frame.
        if frames.ndim == 2 or (frames.ndim == 3 and frames.shape[2] == 3):
            frames = frames[None]
        numbered = path.is_dir() and file.stem.isdigit()
        for frame in frames:
            yield int(file.stem) if numbered else tick, np.asarray(frame)
            tick += 1


def read_png(file):
    with Image.open(file) as image:
        if image.mode == "L":
            return np.asarray(image)
        return np.asarray(image.convert("RGB"))[:, :, ::-1]


# Parts of blue, green and red in grey: ITU-R BT.601.
GREY = np.float32([0.114, 0.587, 0.299])


def tensor(frame, entry, shape):
    """The frame as f32 (channels, H, W) for the network of this registry entry; shape: the network's (H, W), None where any.

    Level / 255 · range, resized, less mean, over std.
    """
    levels = frame.astype(np.float32)
    if entry["color"] == "grey":
        levels = levels @ GREY if frame.ndim == 3 else levels
        planes = [levels]
    else:
        planes = [levels[:, :, c] for c in range(3)] if frame.ndim == 3 else [levels] * 3
        planes = planes[::-1] if entry["color"] == "rgb" else planes
    planes = [plane / np.float32(255) * np.float32(entry["range"]) for plane in planes]
    if entry["resize"] == "antialiased_bilinear":
        height, width = (int(part) for part in entry["input"].split("x"))
        images = [Image.fromarray(np.ascontiguousarray(plane)) for plane in planes]
        planes = [np.asarray(image.resize((width, height), Image.Resampling.BILINEAR)) for image in images]
    if shape and tuple(planes[0].shape) != tuple(shape):
        raise ValueError(f"frames are {planes[0].shape[0]}x{planes[0].shape[1]}, the network takes {shape[0]}x{shape[1]}")
    normal = zip(planes, entry["mean"], entry["std"], strict=True)
    return np.stack([(plane - np.float32(mean)) / np.float32(std) for plane, mean, std in normal])
