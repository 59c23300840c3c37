"""ShadowNet: the visibility of a light behind what the photo does not show.

Rays to the light end lit, blocked or unknown (behind a depth edge, outside the view). The network tells which share of the unknown ones is lit:
    S = (traced - unknown) + unknown x lit,        traced counts unknown rays as lit,
so where nothing is unknown the ray-traced value stands."""

import torch
import torch.nn.functional as F
from torch import nn

import augment
from layers import UNet, unit_scale

GAPS = (1, 2, 4, 8)


class ShadowNet(nn.Module):
    """visibility [1, 3, 120, 160]: traced, unknown, unshadowed direct shading of that lobe (any unit); geometry [1, 6, 120, 160]: normal, xyz (m)
    -> lit [1, 1, 120, 160] in 0..1."""

    outputs = ["lit"]
    targets = [
        ("error / ray-traced error, all", lambda m: m["network"]["all"] / m["traced"]["all"], 0.5),
        ("error / ray-traced error, unknown region", lambda m: m["network"]["unknown"] / m["traced"]["unknown"], 0.5),
        ("error / ray-traced error, known region", lambda m: m["network"]["known"] / m["traced"]["known"], 1.0),
    ]

    def __init__(self):
        super().__init__()
        self.unet = UNet(9, [32, 48, 64, 96])
        self.head = nn.Conv2d(32, 4, 3, padding=1)

    def forward(self, visibility, geometry):
        direct = visibility[:, 2:] / (visibility[:, 2:].mean((1, 2, 3), keepdim=True) + 1e-6)
        x = torch.cat([visibility[:, :2], direct / (1 + direct), unit_scale(geometry)], 1)
        return torch.sigmoid(F.pixel_shuffle(self.head(self.unet(x)[0]), 2))

    @staticmethod
    def batch(rooms, g, size):
        """Sources are drawn by the root of how much of their light is unknown: those without unknown rays teach nothing."""
        items = []
        for room in torch.randint(len(rooms), (size,), generator=g).tolist():
            doubt = rooms.get("doubt", room).sqrt() + 1e-4
            items.append((room, torch.multinomial(doubt, 1, generator=g).item()))
        x = {name: rooms.stack(name, items) for name in ["traced", "unknown", "traced_direct", "direct", "shadow", "depth", "normal"]}
        fov = torch.stack([rooms.get("fov_x", room) for room, _ in items])
        flip = augment.uniform(g, fov) < 0.5
        x = {name: torch.where(flip, augment.mirrored(v, name == "normal"), v) for name, v in x.items()}
        geometry = augment.geometry(g, x["depth"], x["normal"], fov)
        visibility = torch.cat([x["traced"], x["unknown"], x["traced_direct"]], 1)
        return {"inputs": (visibility, geometry), "shadow": x["shadow"], "weight": brightness(x["direct"])}

    def loss(self, batch):
        """Weighted squares for the level, after least-squares scaling (a light's radiance is fitted to the photo later), and scale-invariant gradients; both
        where something is unknown."""
        visibility, shadow, weight = batch["inputs"][0], batch["shadow"], batch["weight"]
        got = combine(visibility, self(*batch["inputs"]).float())
        unknown = (visibility[:, 1:2] > 0.02).float()
        sums = lambda x: (weight * x).sum((1, 2, 3), keepdim=True).detach()
        got = got * (sums(got * shadow) / sums(got * got).clamp(min=1e-6)).clamp(0.25, 4)
        level = (weight * unknown * (got - shadow) ** 2).sum() / (weight * unknown).sum().clamp(min=1)
        edges = 0
        for gap in GAPS:
            for dim in (-1, -2):
                near, far = lambda x: x.narrow(dim, 0, x.shape[dim] - gap), lambda x: x.narrow(dim, gap, x.shape[dim] - gap)
                change = lambda x: (near(x) - far(x)) / (near(x) + far(x) + 0.1)
                pair = torch.maximum(near(unknown), far(unknown)) * torch.minimum(near(weight), far(weight))
                edges = edges + (pair * (change(got) - change(shadow)) ** 2).sum() / pair.sum().clamp(min=1)
        return level + 0.01 * edges

    @staticmethod
    def inputs(rooms, room):
        """As the product gives them, for all sources of a room: [S, ..]."""
        items = [(room, s) for s in range(len(rooms.sources[room]))]
        geometry = torch.cat([rooms.stack("normal", items), augment.xyz(rooms.stack("depth", items), rooms.get("fov_x", room))], 1)
        return {"visibility": torch.cat([rooms.stack(k, items) for k in ["traced", "unknown", "traced_direct"]], 1), "geometry": geometry}

    @staticmethod
    def floors(rooms):
        """The constant share of unknown rays that is best called lit: least squares over up to 200 rooms."""
        top = bottom = 0.0
        for room in range(min(len(rooms), 200)):
            t, u, s, d = (rooms.get(k, room) for k in ["traced", "unknown", "shadow", "direct"])
            w = brightness(d[:, None])[:, 0]
            top += (w * u * (s - t + u)).sum()
            bottom += (w * u * u).sum()
        return {"constant": float(top / max(bottom, 1e-6))}

    def score(self, rooms, room, floors=None):
        """Per source: mean squared error after least-squares scaling; `weighted`: by direct light. Regions with less than 50 lit pixels do not
        count."""
        x = self.inputs(rooms, room)
        lit, visibility = self(**x), x["visibility"]
        estimates = {"network": lit}
        if floors is not None:
            blocked, unknown = torch.zeros_like(lit), visibility[:, 1:2]
            best = (rooms.get("shadow", room)[:, None] - combine(visibility, blocked)) / unknown.clamp(min=1e-3)
            estimates |= {
                "traced": blocked + 1,
                "unknown is blocked": blocked,
                "unknown is constant": blocked + floors["constant"],
                "best possible": best.clamp(0, 1),
            }
        estimates = {k: combine(visibility, v)[:, 0] for k, v in estimates.items()}
        items = []
        for s in range(len(lit)):
            shadow, direct = rooms.get("shadow", room, s), rooms.get("direct", room, s)
            valid, weight, unknown = direct > 0.05 * direct.mean(), brightness(direct[None, None])[0, 0], visibility[s, 1] > 0.02
            item = {}
            for name, estimate in estimates.items():
                e = estimate[s]
                scale = lambda w: (w * e * shadow).sum() / (w * e * e).sum().clamp(min=1e-6)
                mean = lambda w, x: ((w * x).sum() / w.sum()).item() if (w > 0).sum() >= 50 else float("nan")
                plain, heavy = (scale(valid.float()) * e - shadow) ** 2, (scale(weight) * e - shadow) ** 2
                item[name] = {
                    "all": mean(valid.float(), plain),
                    "unknown": mean((valid & unknown).float(), plain),
                    "known": mean((valid & ~unknown).float(), plain),
                    "all weighted": mean(weight, heavy),
                    "unknown weighted": mean(weight * unknown, heavy),
                    "known weighted": mean(weight * ~unknown, heavy),
                }
            items.append(item)
        return items

    def pictures(self, rooms, room):
        """The source with the most unknown light."""
        x = self.inputs(rooms, room)
        s = int(rooms.get("doubt", room).argmax())
        got = combine(x["visibility"], self(**x))
        planes = {
            "traced": x["visibility"][s, 0],
            "unknown": x["visibility"][s, 1],
            "direct": brightness(x["visibility"][s : s + 1, 2:])[0, 0],
            "network": got[s, 0],
            "truth": rooms.get("shadow", room, s),
        }
        return f"{rooms.names[room]} {rooms.sources[room][s]}", {k: v.numpy() for k, v in planes.items()}


def combine(visibility, lit):
    traced, unknown = visibility[:, :1], visibility[:, 1:2]
    return traced - unknown + unknown * lit


def brightness(direct):
    """Weight 0..1 of the pixels of [B, 1, h, w]: in the dark a ratio of light is noise, and matters to nobody."""
    return (direct / direct.mean((1, 2, 3), keepdim=True).clamp(min=1e-8)).clamp(0, 1)
