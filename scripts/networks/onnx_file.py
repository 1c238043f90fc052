"""A PyTorch module as an ONNX file, and the two compared."""

import logging
import warnings

import numpy as np
import onnx
import onnxruntime
import torch

from . import Failure, note

OPSET = 20
# The largest absolute difference allowed, and the largest relative to an output's root mean square: a descriptor of
# 32768 values has small ones.
TOLERANCE = 1e-4
RELATIVE = 1e-2
THREADS = 2


def example(module, batch=1, seed=0):
    """Random inputs: images as normalised levels, voxel grids two thirds zero, states from the first step of a network."""
    generator = torch.Generator().manual_seed(seed)
    tensors = []
    for name, shape in module.inputs.items():
        tensor = torch.randn(batch, *shape[1:], generator=generator)
        if name == "image":
            tensor = tensor.clamp(-2, 2.6)
        elif name == "voxel":
            tensor = tensor * (torch.rand(tensor.shape, generator=generator) < 1 / 3)
        else:
            tensor = tensor.clamp(-1, 1) * 0.5
        tensors.append(tensor)
    return tuple(tensors)


def export(module, batch):
    """The ONNX model, without its metadata. batch: whether the first dimension may be any."""
    module = module.eval()
    dynamic = [{0: torch.export.Dim("batch")} for _ in module.inputs] if batch else None
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            example(module, batch=2 if batch else 1),
            dynamo=True,
            external_data=False,
            optimize=True,
            opset_version=OPSET,
            input_names=list(module.inputs),
            output_names=module.outputs,
            dynamic_shapes=tuple(dynamic) if dynamic and len(dynamic) == 1 else dynamic,
            verbose=False,
        )
    model = program.model_proto
    forget_origins(model)
    return model


def forget_origins(model):
    """Removes what the exporter says of its own source lines (local paths among it), so that equal weights give equal bytes."""
    model.doc_string = model.graph.doc_string = ""
    for holder in (model, model.graph):
        del holder.metadata_props[:]
    graph = model.graph
    for item in (*graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        item.doc_string = ""
        del item.metadata_props[:]
    del graph.value_info[:]


def save(model, metadata, path):
    """Writes the model with its metadata beside `path`, to be given that name once it has been checked."""
    onnx.helper.set_model_props(model, metadata)
    temporary = path.with_suffix(".onnx.new")
    temporary.write_bytes(model.SerializeToString(deterministic=True))
    return temporary


def session(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def compare(module, path, batch):
    """The largest absolute difference between PyTorch and ONNX Runtime over all outputs; fails above TOLERANCE."""
    worst = relative = 0.0
    runtime = session(path)
    for count in (1, 3) if batch else (1,):
        inputs = example(module, batch=count, seed=1)
        with torch.no_grad():
            expected = module(*inputs)
        expected = expected if isinstance(expected, tuple) else (expected,)
        feeds = {name: tensor.numpy() for name, tensor in zip(module.inputs, inputs)}
        for name, want, got in zip(module.outputs, expected, runtime.run(module.outputs, feeds), strict=True):
            if got.shape != tuple(want.shape) or not np.isfinite(got).all():
                raise Failure(f"{path}: output {name} is {got.shape}, PyTorch's {tuple(want.shape)}, or holds NaN")
            difference = float(np.abs(got - want.numpy()).max())
            worst = max(worst, difference)
            relative = max(relative, difference / float(want.square().mean().sqrt() + 1e-12))
    note(f"PyTorch and ONNX Runtime differ by at most {worst:.2e} ({relative:.1e} of an output's root mean square)")
    if worst > TOLERANCE or relative > RELATIVE:
        raise Failure(f"{path}: PyTorch and ONNX Runtime differ by {worst:.2e}, more than {TOLERANCE}: the file is not to be used")


def count(module):
    """Parameters, and multiplications of one forward pass (of one image)."""
    from torch.utils.flop_counter import FlopCounterMode

    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        module(*example(module))
    return sum(p.numel() for p in module.parameters()), counter.get_total_flops() // 2


def zero_states(module, voxel):
    """States for voxel grids of this shape, which may be another than the module is exported for."""
    whole = module.inputs["voxel"]
    shapes = [shape for name, shape in module.inputs.items() if name != "voxel"]
    return [torch.zeros(1, c, h * voxel[2] // whole[2], w * voxel[3] // whole[3]) for _, c, h, w in shapes]


def check_steps(module, file):
    """Feeds x (steps, 1, bins, H, W) in order from zero states and compares the images with y: the file's own outputs."""
    try:
        with np.load(file) as arrays:
            x, y = (torch.from_numpy(arrays[key]) for key in ("x", "y"))
    except (KeyError, ValueError) as error:
        raise Failure(f"{file}: {error}: --check takes an .npz with x (steps, 1, bins, H, W) and y (steps, 1, 1, H, W)") from error
    states = None
    worst = 0.0
    with torch.no_grad():
        for voxel, want in zip(x, y):
            if states is None:
                states = zero_states(module, voxel.shape)
            image, *states = module(voxel, *states)
            worst = max(worst, (image - want).abs().max().item())
    note(f"{file}: the images differ by at most {worst:.2e} over {len(x)} steps")
    if worst > TOLERANCE:
        raise Failure(f"{file}: the images differ by {worst:.2e}, more than {TOLERANCE}: are these the weights it was made with?")
