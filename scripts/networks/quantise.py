"""8-bit networks: static for convolutions, dynamic for the transformer."""

import logging
import tempfile
from pathlib import Path

import numpy as np
import onnx
import torch
from onnxruntime.quantization import (
    CalibrationDataReader,
    CalibrationMethod,
    QuantFormat,
    QuantType,
    quantize_dynamic,
    quantize_static,
)
from onnxruntime.quantization.shape_inference import quant_pre_process

import preprocess
from . import Failure, note, onnx_file

# Frames that settle the ranges; more change little.
FRAMES = 64


def frames(module, entry, options):
    """Calibration images for an extractor, spread over the frames given."""
    shape = module.inputs["image"][2:]
    every = [frame for _, frame in preprocess.read_frames(options.calibration) if frame.any()]
    if not every:
        raise Failure(f"{options.calibration}: no frames with events in it")
    chosen = np.linspace(0, len(every) - 1, min(FRAMES, len(every))).astype(int)
    try:
        return [{"image": preprocess.tensor(every[i], entry, shape)[None]} for i in chosen]
    except ValueError as error:
        raise Failure(f"{options.calibration}: {error}") from error


def grids(module, options):
    """Calibration inputs for a reconstruction: voxel grids in order, each with the states that the ones before left."""
    voxels = np.load(options.calibration, mmap_mode="r")
    want = module.inputs["voxel"]
    if voxels.ndim != 4 or voxels.shape[1:] != want[1:]:
        raise Failure(f"{options.calibration}: {voxels.shape}, not (T, {', '.join(map(str, want[1:]))})")
    states = [torch.zeros(shape) for name, shape in module.inputs.items() if name != "voxel"]
    feeds = []
    with torch.no_grad():
        for voxel in voxels[:FRAMES]:
            inputs = [torch.tensor(voxel[None], dtype=torch.float32), *states]
            feeds.append({name: value.numpy() for name, value in zip(module.inputs, inputs)})
            outputs = module(*inputs)
            states = list(outputs[1:]) if isinstance(outputs, tuple) else []
    return feeds


def calibration(module, entry, options):
    return frames(module, entry, options) if entry["kind"] == "extractor" else grids(module, options)


class Reader(CalibrationDataReader):
    def __init__(self, feeds):
        self.feeds = iter(feeds)

    def get_next(self):
        return next(self.feeds, None)


def quantise(model, module, entry, options):
    """The model with u8 activations and s8 weights, per channel; megaloc with its matrix products quantised as they run."""
    logging.getLogger().setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        whole, clean, small = (Path(folder) / name for name in ("whole.onnx", "clean.onnx", "int8.onnx"))
        whole.write_bytes(model.SerializeToString())
        if options.network == "megaloc":
            quantize_dynamic(
                whole, small, op_types_to_quantize=["MatMul", "Gemm"], per_channel=True, weight_type=QuantType.QInt8
            )
        else:
            feeds = calibration(module, entry, options)
            note(f"calibrating with {len(feeds)} inputs")
            quant_pre_process(str(whole), str(clean), skip_symbolic_shape=True)
            quantize_static(
                clean,
                small,
                Reader(feeds),
                quant_format=QuantFormat.QDQ,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                per_channel=True,
                calibrate_method=CalibrationMethod.MinMax,
                op_types_to_quantize=["Conv", "ConvTranspose", "Gemm", "MatMul", "Relu", "Add", "MaxPool", "Clip"],
            )
        model = onnx.load(small)
    onnx_file.forget_origins(model)
    return model


def compare(module, path, entry, options):
    """Says how far the 8-bit outputs are from PyTorch's; equal they cannot be."""
    feeds = calibration(module, entry, options) if options.calibration else None
    if feeds is None:
        feeds = [dict(zip(module.inputs, (t.numpy() for t in onnx_file.example(module, seed=1))))]
    runtime = onnx_file.session(path)
    differences, cosines = [], []
    for feed in feeds[:8]:
        with torch.no_grad():
            want = module(*(torch.from_numpy(value) for value in feed.values()))
        want = (want[0] if isinstance(want, tuple) else want).numpy().ravel()
        got = runtime.run(module.outputs[:1], feed)[0].ravel()
        if not np.isfinite(got).all():
            raise Failure(f"{path}: the 8-bit network gives NaN")
        differences.append(np.abs(got - want).max())
        cosines.append(got @ want / (np.linalg.norm(got) * np.linalg.norm(want)))
    note(f"8 bit against PyTorch: largest difference {max(differences):.3g}, least cosine {min(cosines):.5f}")
