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


def tensor(frame, entry, shape):
    """The frame as f32 (3, H, W) for the network of this registry entry; shape: the network's (H, W), None where any."""
    channels = np.repeat(frame[:, :, None], 3, axis=2) if frame.ndim == 2 else frame
    if entry["color"] == "rgb":
        channels = channels[:, :, ::-1]
    elif entry["color"] != "bgr":
        raise ValueError(f"{entry['id']}: color '{entry['color']}' is not known here")
    mean, std = np.float32(entry["mean"]), np.float32(entry["std"])
    levels = channels.astype(np.float32) * np.float32(entry["range"] / 255)
    levels = ((levels - mean) / std).transpose(2, 0, 1)
    if entry["resize"] == "antialiased_bilinear":
        height, width = (int(part) for part in entry["input"].split("x"))
        resized = [Image.fromarray(plane).resize((width, height), Image.Resampling.BILINEAR) for plane in levels]
        levels = np.stack([np.asarray(plane) for plane in resized])
    if shape and tuple(levels.shape[1:]) != tuple(shape):
        raise ValueError(f"frames are {levels.shape[1]}x{levels.shape[2]}, the network takes {shape[0]}x{shape[1]}")
    return np.ascontiguousarray(levels, np.float32)
