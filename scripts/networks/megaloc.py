"""MegaLoc: DINOv2 ViT-B/14, SALAD aggregation, one linear layer.

Berton, Masone: MegaLoc, CVPR Workshops 2025, https://arxiv.org/abs/2502.17237; SALAD: Izquierdo, Civera, CVPR 2024,
https://arxiv.org/abs/2311.15937, section 3; DINOv2: https://arxiv.org/abs/2304.07193. Parameter names as published at
https://github.com/gmberton/MegaLoc and https://github.com/facebookresearch/dinov2.
"""

import math

import torch
from torch import nn
from torch.nn import functional as F

import model_registry

from . import Failure
from .layers import Resize, extractor_io
from .weights import load_strictly, state_of

PATCH, WIDTH, HEADS, DEPTH, GRID = 14, 768, 12, 12, 37
CLUSTERS, CLUSTER_WIDTH, TOKEN_WIDTH, HIDDEN, DIMENSION, SINKHORN_STEPS = 64, 256, 256, 512, 8448, 3


class Attention(nn.Module):
    def __init__(self):
        super().__init__()
        self.qkv = nn.Linear(WIDTH, 3 * WIDTH)
        self.proj = nn.Linear(WIDTH, WIDTH)

    def forward(self, x):
        tokens = x.shape[1]
        qkv = self.qkv(x).reshape(-1, tokens, 3, HEADS, WIDTH // HEADS).permute(2, 0, 3, 1, 4)
        query, key, value = qkv[0] * (WIDTH // HEADS) ** -0.5, qkv[1], qkv[2]
        mixed = F.softmax(query @ key.transpose(-2, -1), dim=-1) @ value
        return self.proj(mixed.transpose(1, 2).reshape(-1, tokens, WIDTH))


class Mlp(nn.Module):
    def __init__(self):
        super().__init__()
        self.fc1 = nn.Linear(WIDTH, 4 * WIDTH)
        self.fc2 = nn.Linear(4 * WIDTH, WIDTH)

    def forward(self, x):
        return self.fc2(F.gelu(self.fc1(x)))


class Scale(nn.Module):
    def __init__(self):
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(WIDTH))

    def forward(self, x):
        return x * self.gamma


class Block(nn.Module):
    def __init__(self):
        super().__init__()
        self.norm1, self.attn, self.ls1 = nn.LayerNorm(WIDTH, eps=1e-6), Attention(), Scale()
        self.norm2, self.mlp, self.ls2 = nn.LayerNorm(WIDTH, eps=1e-6), Mlp(), Scale()

    def forward(self, x):
        x = x + self.ls1(self.attn(self.norm1(x)))
        return x + self.ls2(self.mlp(self.norm2(x)))


class Patches(nn.Module):
    def __init__(self):
        super().__init__()
        self.proj = nn.Conv2d(3, WIDTH, PATCH, stride=PATCH)

    def forward(self, x):
        return self.proj(x).flatten(2).transpose(1, 2)


class Dino(nn.Module):
    """ViT-B/14 for images of a fixed size in patches."""

    def __init__(self, grid):
        super().__init__()
        self.grid = grid
        self.cls_token = nn.Parameter(torch.randn(1, 1, WIDTH) * 1e-6)
        self.pos_embed = nn.Parameter(nn.init.trunc_normal_(torch.empty(1, 1 + GRID * GRID, WIDTH), std=0.02))
        self.mask_token = nn.Parameter(torch.zeros(1, WIDTH))
        self.patch_embed = Patches()
        self.blocks = nn.ModuleList(Block() for _ in range(DEPTH))
        self.norm = nn.LayerNorm(WIDTH, eps=1e-6)

    def fix_positions(self):
        """The trained 37×37 position codes at this grid: bicubic, the scale 0.1 of a patch too large, as published."""
        token, codes = self.pos_embed.data[:, :1], self.pos_embed.data[:, 1:]
        if self.grid != (GRID, GRID):
            codes = codes.reshape(1, GRID, GRID, WIDTH).permute(0, 3, 1, 2)
            scale = tuple((cells + 0.1) / GRID for cells in self.grid)
            codes = F.interpolate(codes, scale_factor=scale, mode="bicubic").permute(0, 2, 3, 1).reshape(1, -1, WIDTH)
        if codes.shape[1] != self.grid[0] * self.grid[1]:
            raise AssertionError(f"{codes.shape[1]} position codes for {self.grid} patches")
        self.register_buffer("positions", codes.contiguous(), persistent=False)
        self.register_buffer("first", self.cls_token.data + token, persistent=False)

    def forward(self, x):
        x = self.patch_embed(x) + self.positions
        x = torch.cat([self.first.expand(x.shape[0], -1, -1), x], dim=1)
        for block in self.blocks:
            x = block(x)
        x = self.norm(x)
        return x[:, 1:].transpose(1, 2).reshape(-1, WIDTH, *self.grid), x[:, 0]


class Backbone(nn.Module):
    def __init__(self, grid):
        super().__init__()
        self.model = Dino(grid)

    def forward(self, x):
        return self.model(x)


def assign(scores, dust_bin):
    """The log of SALAD's assignment, (N, clusters, patches): Sinkhorn in the log domain with a dust bin as one more cluster,
    each patch of mass 1 and each cluster of mass 1, the dust bin taking the rest."""
    clusters, patches = scores.shape[1:]
    dust = (dust_bin + torch.zeros_like(scores[:, :1]))
    scores = torch.cat([scores, dust], dim=1)
    unit = -math.log(clusters + patches)
    rest = unit + math.log(patches - clusters)
    rows = torch.tensor([unit] * clusters + [rest]).reshape(1, -1, 1)
    columns_log = torch.zeros_like(scores[:, :1])
    for _ in range(SINKHORN_STEPS):
        rows_log = rows - torch.logsumexp(scores + columns_log, dim=2, keepdim=True)
        columns_log = unit - torch.logsumexp(scores + rows_log, dim=1, keepdim=True)
    return (scores + rows_log + columns_log - unit)[:, :-1]


class Salad(nn.Module):
    def __init__(self):
        super().__init__()
        pointwise = lambda target: nn.Sequential(
            nn.Conv2d(WIDTH, HIDDEN, 1), nn.Identity(), nn.ReLU(), nn.Conv2d(HIDDEN, target, 1)
        )
        self.token_features = nn.Sequential(nn.Linear(WIDTH, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, TOKEN_WIDTH))
        self.cluster_features = pointwise(CLUSTER_WIDTH)
        self.score = pointwise(CLUSTERS)
        self.dust_bin = nn.Parameter(torch.tensor(1.0))

    def forward(self, features):
        patches, token = features
        shares = assign(self.score(patches).flatten(2), self.dust_bin).exp()
        local = torch.bmm(self.cluster_features(patches).flatten(2), shares.transpose(1, 2))
        parts = [F.normalize(self.token_features(token), dim=1), F.normalize(local, dim=1).flatten(1)]
        return F.normalize(torch.cat(parts, dim=1), dim=1)


class Aggregator(nn.Module):
    def __init__(self):
        super().__init__()
        self.agg = Salad()
        self.linear = nn.Linear(CLUSTERS * CLUSTER_WIDTH + TOKEN_WIDTH, DIMENSION)

    def forward(self, x):
        return self.linear(self.agg(x))


class MegaLoc(nn.Module):
    def __init__(self, size, whole):
        super().__init__()
        self.resize = nn.Identity() if size == whole else Resize(size, whole)
        self.backbone = Backbone((whole[0] // PATCH, whole[1] // PATCH))
        self.aggregator = Aggregator()

    def forward(self, image):
        return F.normalize(self.aggregator(self.backbone(self.resize(image))), dim=1)


def build(options, checkpoint):
    whole = tuple(round(length / PATCH) * PATCH for length in options.size)
    if whole[0] * whole[1] // PATCH**2 <= CLUSTERS:
        raise Failure(f"--size {options.size[0]}x{options.size[1]}: MegaLoc needs more than {CLUSTERS} patches of {PATCH}×{PATCH}")
    size = whole if options.resize_outside else options.size
    module = MegaLoc(size, whole)
    if checkpoint is not None:
        load_strictly(module, state_of(checkpoint), options.weights)
    module.backbone.model.fix_positions()
    return extractor_io(module, size)


def entry(options, module, licence, source):
    outside = {}
    if options.resize_outside:
        outside = {"input": "x".join(map(str, module.inputs["image"][2:])), "resize": "antialiased_bilinear"}
    return model_registry.extractor(dimension=DIMENSION, licence=licence, source=source, **outside)
