"""Blocks and the scale of geometry, shared by the networks.

Only operators that ONNX Runtime and rten both run; group norm is exported as Reshape + InstanceNormalization."""

import torch
import torch.nn.functional as F
from torch import nn

HEIGHT, WIDTH = 120, 160  # the planes that networks see


def block(inputs, outputs, stride=1):
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.GroupNorm(outputs // 8, outputs), nn.ReLU())


def upsample(x, factor=2):
    """Bilinear, hence linear and non-negative."""
    return F.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)


class UNet(nn.Module):
    """A U-net. Its first level has 1/`shuffle` of the picture's size (pixels move into channels, so that nothing is lost), each further one half of
    that.

    Returns the decoder's maps, finest first: [B, widths[k], HEIGHT / shuffle / 2^k, WIDTH / shuffle / 2^k], sizes rounded up."""

    def __init__(self, inputs, widths, shuffle=2):
        super().__init__()
        self.shuffle = shuffle
        self.stem = nn.Sequential(block(inputs * shuffle**2, widths[0]), block(widths[0], widths[0]))
        self.down = nn.ModuleList(nn.Sequential(block(a, b, 2), block(b, b)) for a, b in zip(widths, widths[1:]))
        self.up = nn.ModuleList(block(a + b, a) for a, b in zip(widths, widths[1:]))

    def forward(self, x):
        levels = [self.stem(F.pixel_unshuffle(x, self.shuffle))]
        for down in self.down:
            levels.append(down(levels[-1]))
        for k in reversed(range(len(self.up))):
            height, width = levels[k].shape[-2:]
            levels[k] = self.up[k](torch.cat([upsample(levels[k + 1])[..., :height, :width], levels[k]], 1))
        return levels


def luminance(x):
    """Rec.709, [B, 1, h, w] of [B, 3, h, w]."""
    return (x * x.new_tensor([0.2126, 0.7152, 0.0722]).view(1, 3, 1, 1)).sum(1, keepdim=True)


def unit_scale(geometry):
    """`geometry` [B, 6, h, w] (normal, xyz in meters) with lengths divided by a third of the mean depth."""
    normal, xyz = geometry[:, :3], geometry[:, 3:]
    return torch.cat([normal, xyz / (xyz[:, 2:].mean((1, 2, 3), keepdim=True) / -3)], 1)


def count(net):
    return sum(p.numel() for p in net.parameters())
