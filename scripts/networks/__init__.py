"""The networks that scripts/export_models.py can export, one file each. Needs PyTorch."""

from . import cosplace, e2vid, firenet, megaloc, mixvpr, mobilenet, netvlad

NETWORKS = {module.NETWORK.name: module.NETWORK for module in (e2vid, firenet, netvlad, cosplace, mixvpr, megaloc, mobilenet)}
