#!/usr/bin/env python3
"""Makes tests/models: networks of a few kilobytes with random weights, their registry, and inputs with outputs.

Run by hand; what it writes is committed. The networks come out the same to the byte each time. The outputs are those of
onnx's own NumPy evaluator, so the runtime under test has no part in them.

    pip install onnx==1.23.2 numpy==2.4.6
    scripts/make_fixture_models.py
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

import model_registry

OUT = Path(__file__).parent.parent / "tests" / "models"
OPSET, IR = 20, 10
SEED = 7
NOTE = {"licence": "MIT OR Apache-2.0", "source": "random weights of scripts/make_fixture_models.py"}


def weights(seed, *shape, gain=1.0):
    """Normal f32 weights, scaled by their fan-in. RandomState's stream is frozen, unlike that of newer generators."""
    fan_in = int(np.prod(shape[1:])) or 1
    return (np.random.RandomState(seed).standard_normal(shape) * gain / np.sqrt(fan_in)).astype(np.float32)


def tensor(name, *shape):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


def save(name, nodes, constants, inputs, outputs, entry, opset=OPSET, ir=IR, said=None):
    """Writes NAME.onnx and its registry entry. `said`: an entry for the file's metadata that differs from the registry's."""
    constants = [numpy_helper.from_array(value, key) for key, value in constants.items()]
    graph = helper.make_graph(nodes, name, inputs, outputs, constants)
    model = helper.make_model(graph, ir_version=ir, opset_imports=[helper.make_opsetid("", opset)], producer_name="evpr")
    helper.set_model_props(model, model_registry.metadata(said or entry, f"random:{SEED}"))
    path = OUT / f"{name}.onnx"
    path.write_bytes(model.SerializeToString(deterministic=True))
    model_registry.put(OUT / "models.toml", name, path, entry)
    return model


def extractor(name, *, dimension=64, grid=(1, 1), size=("height", "width"), batch="batch", nan=False, **how):
    """3→8 convolution with stride 4, ReLU, generalised mean (p = 3) over a grid, linear layer. Not normalised."""
    cells = grid[0] * grid[1]
    constants = {
        "conv.weight": weights(SEED, 8, 3, 5, 5, gain=2.0),
        "conv.bias": weights(SEED + 1, 8),
        "grid": np.array(grid, np.int64),
        "p": np.array(3, np.float32),
        "p_inverse": np.array(1 / 3, np.float32),
        "fc.weight": weights(SEED + 2, dimension, 8 * cells),
        "fc.bias": weights(SEED + 3, dimension, gain=0.1),
    }
    if nan:
        constants["fc.bias"][3] = np.nan
    node = helper.make_node
    nodes = [
        node("Conv", ["image", "conv.weight", "conv.bias"], ["conv"], strides=[4, 4], pads=[2, 2, 2, 2]),
        node("Relu", ["conv"], ["relu"]),
        node("Pow", ["relu", "p"], ["cubes"]),
        node("Resize", ["cubes", "", "", "grid"], ["means"], axes=[2, 3], mode="linear", antialias=1),
        node("Pow", ["means", "p_inverse"], ["pooled"]),
        node("Flatten", ["pooled"], ["flat"]),
        node("Gemm", ["flat", "fc.weight", "fc.bias"], ["descriptor"], transB=1),
    ]
    return save(name, nodes, constants, [tensor("image", batch, 3, *size)], [tensor("descriptor", batch, dimension)], **how)


def tiny_e2vid(name, recurrent):
    """state' = tanh(conv(voxel) + conv(state)); image = σ(conv(state')). Without recurrence the state is zero."""
    shape = ("height", "width")
    constants = {
        "in.weight": weights(SEED + 4, 8, 5, 3, 3),
        "in.bias": weights(SEED + 5, 8, gain=0.2),
        "hidden.weight": weights(SEED + 6, 8, 8, 3, 3),
        "out.weight": weights(SEED + 7, 1, 8, 1, 1, gain=3.0),
        "out.bias": weights(SEED + 8, 1),
    }
    node = helper.make_node
    pads = {"pads": [1, 1, 1, 1]}
    nodes = [node("Conv", ["voxel", "in.weight", "in.bias"], ["drive"], **pads)]
    inputs, outputs, states = [tensor("voxel", 1, 5, *shape)], [tensor("image", 1, 1, *shape)], []
    if recurrent:
        nodes += [
            node("Conv", ["state0", "hidden.weight"], ["memory"], **pads),
            node("Add", ["drive", "memory"], ["sum"]),
            node("Tanh", ["sum"], ["state0_out"]),
        ]
        inputs.append(tensor("state0", 1, 8, *shape))
        outputs.append(tensor("state0_out", 1, 8, *shape))
        states = ["state0"]
    else:
        del constants["hidden.weight"]
        nodes.append(node("Tanh", ["drive"], ["state0_out"]))
    nodes += [
        node("Conv", ["state0_out", "out.weight", "out.bias"], ["level"]),
        node("Sigmoid", ["level"], ["image"]),
    ]
    entry = model_registry.reconstruction(multiple=8, states=states, **NOTE)
    return save(name, nodes, constants, inputs, outputs, entry)


def tiny_two_states():
    """Fixed at 16×24: state1 is half as high and wide as state0, as in a network with encoders."""
    constants = {
        "in.weight": weights(SEED + 9, 4, 5, 3, 3),
        "deep.weight": weights(SEED + 10, 6, 4, 3, 3),
        "out.weight": weights(SEED + 11, 1, 4, 1, 1, gain=3.0),
        "up.weight": weights(SEED + 12, 6, 1, 2, 2, gain=2.0),
        "half": np.array(0.5, np.float32),
    }
    node = helper.make_node
    pads = {"pads": [1, 1, 1, 1]}
    nodes = [
        node("Conv", ["voxel", "in.weight"], ["drive0"], **pads),
        node("Mul", ["state0", "half"], ["memory0"]),
        node("Add", ["drive0", "memory0"], ["sum0"]),
        node("Tanh", ["sum0"], ["state0_out"]),
        node("Conv", ["state0_out", "deep.weight"], ["drive1"], strides=[2, 2], **pads),
        node("Add", ["drive1", "state1"], ["sum1"]),
        node("Tanh", ["sum1"], ["state1_out"]),
        node("Conv", ["state0_out", "out.weight"], ["fine"]),
        node("ConvTranspose", ["state1_out", "up.weight"], ["coarse"], strides=[2, 2]),
        node("Add", ["fine", "coarse"], ["level"]),
        node("Sigmoid", ["level"], ["image"]),
    ]
    inputs = [tensor("voxel", 1, 5, 16, 24), tensor("state0", 1, 4, 16, 24), tensor("state1", 1, 6, 8, 12)]
    outputs = [tensor("image", 1, 1, 16, 24), tensor("state0_out", 1, 4, 16, 24), tensor("state1_out", 1, 6, 8, 12)]
    entry = model_registry.reconstruction(multiple=8, states=["state0", "state1"], **NOTE)
    return save("tiny_two_states", nodes, constants, inputs, outputs, entry)


def images(seed, *shape):
    """Random levels, normalised as the registry says."""
    mean, std = (np.array(v, np.float32).reshape(1, 3, 1, 1) for v in (model_registry.IMAGENET_MEAN, model_registry.IMAGENET_STD))
    levels = np.random.RandomState(seed).randint(0, 256, shape).astype(np.float32)
    return (levels / np.float32(255) - mean) / std


def voxels(seed, *shape):
    """Random voxel grids, two thirds of them zero."""
    random = np.random.RandomState(seed)
    return (random.standard_normal(shape) * (random.uniform(size=shape) < 1 / 3)).astype(np.float32)


def golden(name, **arrays):
    for key, array in arrays.items():
        np.save(OUT / "golden" / f"{name}.{key}.npy", np.ascontiguousarray(array))


def golden_extractor(name, model, image):
    golden(name, image=image, descriptor=ReferenceEvaluator(model).run(None, {"image": image})[0])


def golden_steps(name, model, voxel, states):
    """Feeds the voxel grids in order from zero states. Files: voxel and image (steps, 1, ·, H, W), and each state after the last."""
    evaluator = ReferenceEvaluator(model)
    seen = []
    for grid in voxel:
        values = dict(zip(evaluator.output_names, evaluator.run(None, {"voxel": grid, **states})))
        seen.append(values["image"])
        states = {state: values[f"{state}_out"] for state in states}
    golden(name, voxel=voxel, image=np.stack(seen), **{f"{state}_out": value for state, value in states.items()})


def main():
    (OUT / "golden").mkdir(parents=True, exist_ok=True)
    (OUT / "models.toml").write_text("# Small networks for tests. Written by scripts/make_fixture_models.py: change that, not this.\n")
    say = lambda dimension=64, **other: model_registry.extractor(dimension=dimension, **other, **NOTE)

    tiny = extractor("tiny_extractor", grid=(3, 4), entry=say())
    golden_extractor("tiny_extractor", tiny, images(1, 2, 3, 26, 35))
    fixed = extractor("tiny_fixed", grid=(3, 4), size=(64, 96), batch=1, entry=say(input="64x96", resize="antialiased_bilinear"))
    golden_extractor("tiny_fixed", fixed, images(2, 1, 3, 64, 96))

    voxel = voxels(3, 3, 1, 5, 16, 24)
    golden_steps("tiny_e2vid", tiny_e2vid("tiny_e2vid", True), voxel, {"state0": np.zeros((1, 8, 16, 24), np.float32)})
    golden_steps("tiny_e2vid_stateless", tiny_e2vid("tiny_e2vid_stateless", False), voxel, {})
    zeros = {"state0": np.zeros((1, 4, 16, 24), np.float32), "state1": np.zeros((1, 6, 8, 12), np.float32)}
    golden_steps("tiny_two_states", tiny_two_states(), voxel, zeros)

    # What is wrong with each is its name: a NaN in the descriptor, 32 values where 64 are promised, a mean in the file that
    # is not the registry's, a format that no library knows.
    extractor("nan", nan=True, entry=say())
    extractor("wrong_dim", dimension=32, entry=say())
    extractor("contradiction", entry=say(), said=say(mean=[0.5, 0.5, 0.5]))
    extractor("opset_too_new", entry=say(), opset=99, ir=99)


if __name__ == "__main__":
    main()
