"""LightNet: incoming radiance at each position, as 12 spherical Gaussians per cell of a 30 x 40 grid, in the local frame of `hemisphere.frame`.

The network is scale-equivariant: its input is the light divided by the light's mean, and its output is multiplied by that mean."""

import torch
import torch.nn.functional as F
from torch import nn

import augment
import hemisphere
from gather import gather
from layers import HEIGHT, WIDTH, UNet, unit_scale

LOBES = 12
CELL = 4  # pixels of the half plane
GRID = (HEIGHT // CELL, WIDTH // CELL)


class LightNet(nn.Module):
    """geometry [1, 6, 120, 160]: normal, xyz (m); albedo [1, 3, ..]; rough [1, 1, ..]; light [1, 1, ..]: 1 at pixels of visible lights; shading [1,
    3, ..]: E of all light, at pixels of visible lights their own radiance -> axis [1, 36, 30, 40] (12 unit vectors), sharpness [1, 12, 30, 40],
    weight [1, 36, 30, 40] (12 colors, in the unit of `shading`)."""

    outputs = ["axis", "sharpness", "weight"]
    judged_by = "log L2"
    needs = "map"  # data.rooms_of reads it
    targets = [
        ("log L2 / constant map", lambda m: m["network"]["log L2"] / m["constant"]["log L2"], 1.0),
        ("log L2 / gathered maps", lambda m: m["network"]["log L2"] / m["gathered"]["log L2"], 1.0),
    ]

    def __init__(self):
        super().__init__()
        self.unet = UNet(14, [56, 80, 96, 104], CELL)
        self.head = nn.Conv2d(56, 7 * LOBES, 3, padding=1)
        start = torch.arange(LOBES) + 0.5  # a spiral over the hemisphere
        z, phi = 1 - start / LOBES, start * 2.399963
        self.register_buffer("start", torch.stack([(1 - z * z).sqrt() * phi.cos(), (1 - z * z).sqrt() * phi.sin(), z], -1).view(1, LOBES, 3, 1, 1))

    def forward(self, geometry, albedo, rough, light, shading):
        surface = 1 - light
        scale = (shading * surface).mean((1, 2, 3), keepdim=True) / (surface.mean((1, 2, 3), keepdim=True) + 1e-6) + 1e-6
        # What arrives at a cell is proportional to its own E, but for where that is dark or unseen.
        local = F.avg_pool2d(shading * surface, CELL) / (F.avg_pool2d(surface, CELL) + 1e-6) + 0.05 * scale
        x = torch.cat([unit_scale(geometry), albedo, rough, light, torch.log(1 + 3 * shading / scale) / 3], 1)
        y = self.head(self.unet(x)[0]).float()
        axis = self.start + torch.tanh(y[:, : 3 * LOBES]).reshape(-1, LOBES, 3, *GRID)
        axis = axis / torch.sqrt((axis * axis).sum(2, keepdim=True) + 1e-6)
        sharpness = torch.exp(2 + 2.5 * torch.tanh(y[:, 3 * LOBES : 4 * LOBES]))
        weight = torch.exp(9 * torch.tanh((y[:, 4 * LOBES :] - 1) / 9)).reshape(-1, LOBES, 3, *GRID) * local[:, None]
        return axis.reshape(-1, 3 * LOBES, *GRID), sharpness, weight.reshape(-1, 3 * LOBES, *GRID)

    @staticmethod
    def batch(rooms, g, size):
        items = [(room, None) for room in torch.randint(len(rooms), (size,), generator=g).tolist()]
        x = room_planes(rooms, items)
        maps = torch.stack([rooms.get("maps", room) for room, _ in items])
        valid = torch.stack([rooms.get("maps_valid", room) for room, _ in items])
        down, right = torch.randint(2, (2,), generator=g).tolist()  # every second cell: to draw them costs more than the network
        fov = torch.stack([rooms.get("fov_x", room) for room, _ in items])
        flip = augment.uniform(g, fov) < 0.5
        x = {name: torch.where(flip, augment.mirrored(v, name == "normal"), v) for name, v in x.items()}
        maps = torch.where(flip[..., None, None], augment.mirrored_maps(maps), maps)
        valid = torch.where(flip[:, 0], valid.flip(-1), valid)
        albedo = augment.choose(g, 0.5, augment.worse_albedo(g, x["albedo"]), x["albedo"])
        geometry = augment.geometry(g, x["depth"], x["normal"], fov, 0.3)  # the truth's frame is that of the true normal
        cells = lambda x: x[:, down::2, right::2]
        return {
            "inputs": (geometry, albedo, x["rough"], x["light"], x["shading"]),
            "maps": cells(maps).flatten(3, 4),
            "valid": cells(valid),
            "cells": (down, right),
        }

    def loss(self, batch):
        """Log L2 weighted by solid angle + 0.1 L1 of the shading that the maps imply; with the reference's 0.01 the maps lose half of their light."""
        down, right = batch["cells"]
        valid = batch["valid"] > 0
        got, want = self.maps(*(x[..., down::2, right::2] for x in self(*batch["inputs"])))[valid], batch["maps"][valid]
        return log_l2(got, want).mean() + 0.1 * (hemisphere.shading(got) - hemisphere.shading(want)).abs().mean()

    @staticmethod
    def maps(axis, sharpness, weight):
        """[B, rows, columns, 128, 3]."""
        cells = lambda x: x.unflatten(1, (LOBES, -1)).permute(0, 3, 4, 1, 2)
        return hemisphere.draw(cells(axis), cells(sharpness)[..., 0], cells(weight))

    @staticmethod
    def inputs(rooms, room):
        x = room_planes(rooms, [(room, None)])
        geometry = torch.cat([x["normal"], augment.xyz(x["depth"], rooms.get("fov_x", room))], 1)
        return {"geometry": geometry, "albedo": x["albedo"], "rough": x["rough"], "light": x["light"], "shading": x["shading"]}

    @staticmethod
    def floors(rooms):
        """The mean map of up to 200 rooms, each cell relative to its own shading, scaled so that its shading is 1."""
        total = torch.zeros(128, 3)
        for room in range(min(len(rooms), 200)):
            maps = rooms.get("maps", room).flatten(2, 3)[rooms.get("maps_valid", room) > 0]
            total += (maps / (hemisphere.shading(maps)[:, None] + 1e-3)).mean(0)
        return {"map": total / hemisphere.shading(total)}

    def score(self, rooms, room, floors=None):
        """Per room: log L2, and L1 of the implied shading over its mean."""
        x = self.inputs(rooms, room)
        valid = rooms.get("maps_valid", room).flatten() > 0
        want = rooms.get("maps", room).flatten(2, 3).flatten(0, 1)[valid]
        estimates = {"network": self.maps(*self(**x))[0].flatten(0, 1)}
        if floors is not None:
            mean = lambda plane: F.avg_pool2d(plane[..., 1:-1, 1:-1], 2, CELL)[0].flatten(1).T  # of the 2 x 2 pixels about a cell's center
            estimates["constant"] = floors["map"] * mean(x["shading"] * (1 - x["light"]))[:, None]
            estimates["gathered"] = gather(x["geometry"][0, 3:], rooms.get("photo", room), mean(x["geometry"]), float(rooms.get("fov_x", room)))
        truth = hemisphere.shading(want)
        measures = lambda e: {
            "log L2": log_l2(e, want).mean().item(),
            "shading L1": ((hemisphere.shading(e) - truth).abs().mean() / truth.mean()).item(),
        }
        return [{k: measures(e[valid]) for k, e in estimates.items()}]

    def pictures(self, rooms, room):
        """Maps of every fifth cell in a mosaic, tone-mapped by x / (1 + x)."""
        x = self.inputs(rooms, room)
        photo = rooms.get("photo", room)
        mosaic = lambda maps: maps.unflatten(2, (8, 16))[2::5, 2::5].permute(4, 0, 2, 1, 3).flatten(3, 4).flatten(1, 2)
        planes = {
            "photo": photo,
            "E": x["shading"][0],
            "network": mosaic(self.maps(*self(**x))[0]),
            "truth": mosaic(rooms.get("maps", room).flatten(2, 3)),
        }
        return rooms.names[room], {k: (v / (1 + v)).numpy() for k, v in planes.items()}


def log_l2(got, want):
    """Mean over the hemisphere of squared differences of log(1 + x), [N] of [N, 128, 3]."""
    _, angle = hemisphere.texels()
    return (((torch.log1p(got) - torch.log1p(want)) ** 2).mean(-1) * angle).sum(-1) / angle.sum()


def room_planes(rooms, items):
    x = {name: rooms.stack(name, items) for name in ["depth", "normal", "albedo", "rough", "light", "shading", "photo"]}
    x["shading"] = torch.where(x["light"] > 0, x.pop("photo"), x["shading"])
    return x
