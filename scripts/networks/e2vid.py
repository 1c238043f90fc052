"""E2VID: events to video by a recurrent UNet.

Rebecq, Ranftl, Koltun, Scaramuzza: High Speed and High Dynamic Range Video with an Event Camera, TPAMI 2019,
https://arxiv.org/abs/1906.07165, section 3.3; parameter names as published at https://github.com/uzh-rpg/rpg_e2vid.
"""

import torch
from torch import nn

import model_registry

from . import Failure
from .layers import multiple_of
from .weights import load_strictly, state_of

BINS, BASE, ENCODERS, RESIDUALS = 5, 32, 3, 2
# E2VID_lightweight; a checkpoint carries its own.
CONFIG = {"num_bins": BINS, "base_num_channels": BASE, "num_encoders": ENCODERS, "num_residual_blocks": RESIDUALS}
CONFIG |= {"norm": None, "use_upsample_conv": False, "skip_type": "sum", "recurrent_block_type": "convlstm"}


class Step(nn.Module):
    """Convolution (or its transpose, or bilinear doubling first), optional batch or instance norm, optional ReLU."""

    def __init__(self, source, target, kernel, stride=1, norm=None, relu=True, kind="conv2d"):
        super().__init__()
        self.kind, self.relu = kind, relu
        how = {"stride": stride, "padding": kernel // 2, "bias": norm != "BN"}
        if kind == "transposed_conv2d":
            self.transposed_conv2d = nn.ConvTranspose2d(source, target, kernel, output_padding=1, **how)
        else:
            self.conv2d = nn.Conv2d(source, target, kernel, **how)
        if norm == "BN":
            self.norm_layer = nn.BatchNorm2d(target)
        elif norm == "IN":
            self.norm_layer = nn.InstanceNorm2d(target, track_running_stats=True)

    def forward(self, x):
        if self.kind == "upsample":
            x = nn.functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
        x = self.transposed_conv2d(x) if self.kind == "transposed_conv2d" else self.conv2d(x)
        if hasattr(self, "norm_layer"):
            x = self.norm_layer(x)
        return torch.relu(x) if self.relu else x


class Lstm(nn.Module):
    """Convolutional LSTM: the gates in, forget, out and cell from one convolution of input and hidden state."""

    def __init__(self, channels):
        super().__init__()
        self.Gates = nn.Conv2d(2 * channels, 4 * channels, 3, padding=1)

    def forward(self, x, hidden, cell):
        enter, keep, leave, candidate = self.Gates(torch.cat([x, hidden], 1)).chunk(4, 1)
        cell = torch.sigmoid(keep) * cell + torch.sigmoid(enter) * torch.tanh(candidate)
        return torch.sigmoid(leave) * torch.tanh(cell), cell


class LstmFromZero(nn.Module):
    """The same from a zero state: the hidden half of the convolution and the forget gate drop out exactly."""

    def __init__(self, lstm):
        super().__init__()
        weight, bias = lstm.Gates.weight, lstm.Gates.bias
        channels = weight.shape[0] // 4
        rows = [g * channels + c for g in (0, 2, 3) for c in range(channels)]
        self.gates = nn.Conv2d(channels, 3 * channels, 3, padding=1)
        self.gates.weight = nn.Parameter(weight[rows, :channels].clone())
        self.gates.bias = nn.Parameter(bias[rows].clone())

    def forward(self, x):
        enter, leave, candidate = self.gates(x).chunk(3, 1)
        return torch.sigmoid(leave) * torch.tanh(torch.sigmoid(enter) * torch.tanh(candidate))


class Encoder(nn.Module):
    def __init__(self, source, target, norm):
        super().__init__()
        self.conv = Step(source, target, 5, stride=2, norm=norm)
        self.recurrent_block = Lstm(target)


class Residual(nn.Module):
    """relu(conv(relu(conv x)) + x)."""

    def __init__(self, channels, norm=None):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1, bias=norm != "BN")
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1, bias=norm != "BN")
        if norm in ("BN", "IN"):
            kind = nn.BatchNorm2d if norm == "BN" else nn.InstanceNorm2d
            self.bn1, self.bn2 = kind(channels), kind(channels)

    def forward(self, x):
        y = self.conv1(x)
        y = torch.relu(self.bn1(y) if hasattr(self, "bn1") else y)
        y = self.conv2(y)
        y = self.bn2(y) if hasattr(self, "bn2") else y
        return torch.relu(y + x)


class UNet(nn.Module):
    def __init__(self, config):
        super().__init__()
        norm, base, encoders = config["norm"], int(config["base_num_channels"]), int(config["num_encoders"])
        widths = [base * 2**i for i in range(encoders + 1)]
        up = "upsample" if config["use_upsample_conv"] else "transposed_conv2d"
        up_stride = 1 if config["use_upsample_conv"] else 2
        self.head = Step(int(config["num_bins"]), base, 5)
        self.encoders = nn.ModuleList(Encoder(a, b, norm) for a, b in zip(widths, widths[1:]))
        self.resblocks = nn.ModuleList(Residual(widths[-1], norm) for _ in range(int(config["num_residual_blocks"])))
        self.decoders = nn.ModuleList(
            Step(b, a, 5, stride=up_stride, norm=norm, kind=up) for a, b in reversed(list(zip(widths, widths[1:])))
        )
        self.pred = Step(base, 1, 1, norm=norm, relu=False)

    def run(self, voxel, recur):
        """recur(i, x): the i-th recurrent block's output for x."""
        head = x = self.head(voxel)
        skips = []
        for i, encoder in enumerate(self.encoders):
            x = recur(i, encoder.conv(x))
            skips.append(x)
        for block in self.resblocks:
            x = block(x)
        for decoder, skip in zip(self.decoders, reversed(skips)):
            x = decoder(x + skip)
        return torch.sigmoid(self.pred(x + head))


class E2vid(nn.Module):
    """(voxel, hidden and cell state of each encoder) → (image, the new states). States in the order hidden0, cell0, hidden1, …"""

    def __init__(self, config):
        super().__init__()
        self.unetrecurrent = UNet(config)

    def forward(self, voxel, *states):
        after = []

        def recur(i, x):
            block = self.unetrecurrent.encoders[i].recurrent_block
            after.extend(block(x, states[2 * i], states[2 * i + 1]))
            return after[-2]

        return self.unetrecurrent.run(voxel, recur), *after


class E2vidFromZero(nn.Module):
    """Every voxel grid from a zero state, with 59 % of the multiplications."""

    def __init__(self, whole):
        super().__init__()
        self.unet = whole.unetrecurrent
        self.blocks = nn.ModuleList(LstmFromZero(encoder.recurrent_block) for encoder in self.unet.encoders)

    def forward(self, voxel):
        return self.unet.run(voxel, lambda i, x: self.blocks[i](x))


def config_of(checkpoint):
    config = CONFIG | {key: value for key, value in (checkpoint or {}).get("model", {}).items() if key in CONFIG}
    if config["norm"] in ("None", "none", ""):
        config["norm"] = None
    if config["skip_type"] != "sum" or config["recurrent_block_type"] != "convlstm":
        raise Failure("only sum skips and ConvLSTM, as in E2VID_lightweight, are known")
    return config


def build(options, checkpoint):
    config = config_of(checkpoint)
    module = E2vid(config)
    if checkpoint is not None:
        load_strictly(module, state_of(checkpoint), options.weights)
    encoders, base = int(config["num_encoders"]), int(config["base_num_channels"])
    step = 2**encoders
    height, width = (multiple_of(step, length) for length in options.size)
    inputs = {"voxel": (1, int(config["num_bins"]), height, width)}
    outputs = ["image"]
    if options.stateless:
        module = prove_equal(module.eval(), inputs["voxel"], encoders, base)
    else:
        for i in range(2 * encoders):
            scale = 2 ** (i // 2 + 1)
            inputs[f"state{i}"] = (1, base * scale, height // scale, width // scale)
            outputs.append(f"state{i}_out")
    module.inputs, module.outputs, module.multiple = inputs, outputs, step
    return module


def prove_equal(whole, shape, encoders, base):
    """The stateless network, after comparing it with the whole one from zero states."""
    short = E2vidFromZero(whole).eval()
    _, bins, height, width = shape
    voxel = torch.randn(1, bins, min(height, 64), min(width, 64))
    zeros = []
    for i in range(2 * encoders):
        scale = 2 ** (i // 2 + 1)
        zeros.append(torch.zeros(1, base * scale, voxel.shape[2] // scale, voxel.shape[3] // scale))
    with torch.no_grad():
        difference = (whole(voxel, *zeros)[0] - short(voxel)).abs().max().item()
    if difference > 1e-5:
        raise AssertionError(f"the stateless network differs from the whole one by {difference}")
    for encoder in whole.unetrecurrent.encoders:
        del encoder.recurrent_block
    return short


def entry(options, module, licence, source):
    states = [name for name in module.inputs if name != "voxel"]
    return model_registry.reconstruction(multiple=module.multiple, states=states, licence=licence, source=source)
