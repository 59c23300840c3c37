"""ShadowNet: the visibility of a light where rays leave the visible part of the room.

Rays to the light are lit, blocked or unknown (behind a depth edge, outside the view). The network estimates the lit fraction of the unknown rays, and
the reliability of rays through the depth mesh (low at thin objects and edges), with a replacement where it is low:
    S = (1 - doubt) x (traced - unknown + unknown x lit) + doubt x instead,        traced counts unknown rays as lit.
The photo contains the shadows of the lights that are on in it. So an input is the photo's shading minus all other light, as ray-traced. Another input
is the position of the light."""

import torch
import torch.nn.functional as F
from torch import nn

import augment
import place as places
from layers import UNet, luminance, unit_scale

GAPS = (1, 2, 4, 8)
UNSEEN = 0.3  # share of the items to train on whose light is told not to burn in the photo
WHITE = 0.99  # a photo's pixel above it tells nothing


class ShadowNet(nn.Module):
    """visibility [1, 5, 120, 160]: traced, unknown, unshadowed direct shading per unit radiance of that lobe, its residual in the photo, its unshadowed
    fraction of the photo's shading (`evidence`; zeros for a light that is off in the photo); geometry [1, 6, 120, 160]: normal, xyz (m); place [1, 12,
    1, 1] of the light: center, half_x, half_y (m; zeros except for windows), direction to the sun (zeros except for suns) -> shares [1, 3, 120, 160] in
    0..1: lit, instead, doubt (`combine`)."""

    outputs = ["shares"]
    judged_by = "all"
    targets = [
        ("error / ray-traced error, all", lambda m: m["network"]["all"] / m["traced"]["all"], 0.5),
        ("error / ray-traced error, unknown region", lambda m: m["network"]["unknown"] / m["traced"]["unknown"], 0.5),
        ("error / ray-traced error, known region", lambda m: m["network"]["known"] / m["traced"]["known"], 1.0),
    ]

    def __init__(self):
        super().__init__()
        self.unet = UNet(23, [32, 48, 64, 96, 128])
        self.head = nn.Conv2d(32, 12, 3, padding=1)

    def forward(self, visibility, geometry, place):
        traced, direct, left, share = visibility[:, :2], visibility[:, 2:3], visibility[:, 3:4], visibility[:, 4:]
        mean = direct.mean((1, 2, 3), keepdim=True) + 1e-9
        shadow = (left / (direct + 0.02 * mean)).clamp(-1, 2) * (share > 0)
        planes = [traced, torch.log(0.02 + torch.clamp(direct / mean, max=50)) / 2, shadow, share, unit_scale(geometry), ways(geometry, place)]
        y = F.pixel_shuffle(self.head(self.unet(torch.cat(planes, 1))[0]), 2)
        return torch.cat([torch.sigmoid(y[:, :2]), torch.sigmoid(y[:, 2:] - 3)], 1)

    @staticmethod
    def batch(rooms, g, size):
        """Sources are drawn by the root of how much of their light is unknown: those without unknown rays teach little."""
        items = []
        for room in torch.randint(len(rooms), (size,), generator=g).tolist():
            items.append((room, torch.multinomial(rooms.get("doubt", room).sqrt() + 0.05, 1, generator=g).item()))
        x = planes(rooms, items)
        fov = torch.stack([rooms.get("fov_x", room) for room, _ in items])
        flip = augment.uniform(g, fov) < 0.5
        mirrored = {name: augment.mirrored(v, name == "normal") for name, v in x.items()} | {"place": places.mirrored(x["place"])}
        x = {name: torch.where(flip, mirrored[name], v) for name, v in x.items()}
        geometry = augment.geometry(g, x["depth"], x["normal"], fov)
        albedo = augment.choose(g, 0.7, augment.worse_albedo(g, x["albedo"]), x["albedo"])
        wrong = lambda scale: torch.exp(scale * torch.randn(size, 1, 1, 1, generator=g))
        radiance = x["radiance"] * wrong(0.2)
        seen = evidence(x | {"albedo": albedo, "radiance": radiance}, x["explained"] * wrong(0.15))
        seen = torch.where(augment.uniform(g, fov) < UNSEEN, 0.0, seen)
        noise = lambda scale, channels: scale * torch.randn(size, channels, 1, 1, generator=g)
        place = x["place"] * (1 + noise(0.05, 1)) + noise(0.03, 12) * (x["place"] != 0)
        return {"inputs": (visibility(x, seen), geometry, place), "shadow": x["shadow"], "weight": brightness(x["direct"])}

    def loss(self, batch):
        """Weighted squares for the level, after least-squares scaling (a light's radiance is fitted to the photo later), and scale-invariant gradients
        where something is unknown."""
        visibility, shadow, weight = batch["inputs"][0], batch["shadow"], batch["weight"]
        got = combine(visibility, self(*batch["inputs"]).float())
        got = scaled(got, shadow, weight)
        level = (weight * (got - shadow) ** 2).sum() / weight.sum().clamp(min=1)
        edges, unknown = 0, (visibility[:, 1:2] > 0.02).float()
        for gap in GAPS:
            for dim in (-1, -2):
                near, far = lambda x: x.narrow(dim, 0, x.shape[dim] - gap), lambda x: x.narrow(dim, gap, x.shape[dim] - gap)
                change = lambda x: (near(x) - far(x)) / (near(x) + far(x) + 0.1)
                pair = torch.maximum(near(unknown), far(unknown)) * torch.minimum(near(weight), far(weight))
                edges = edges + (pair * (change(got) - change(shadow)) ** 2).sum() / pair.sum().clamp(min=1)
        return level + 0.003 * edges

    @staticmethod
    def inputs(rooms, room):
        """As the product gives them, for all sources of a room: [S, ..]."""
        x = planes(rooms, [(room, s) for s in range(len(rooms.sources[room]))])
        geometry = torch.cat([x["normal"], augment.xyz(x["depth"], rooms.get("fov_x", room))], 1)
        return {"visibility": visibility(x, evidence(x, x["explained"])), "geometry": geometry, "place": x["place"]}

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
        """Per room: mean squared error, over the lit pixels of all its sources, after least-squares scaling of each source; `weighted`: by direct
        light; `in the picture`: by the share of all direct light that the source has there. Regions with less than 50 lit pixels do not count."""
        x = self.inputs(rooms, room)
        visibility = x["visibility"]
        estimates = {"network": combine(visibility, self(**x))}
        if floors is not None:
            known, unknown = visibility[:, :1] - visibility[:, 1:2], visibility[:, 1:2]
            unseen = x | {"visibility": torch.cat([visibility[:, :3], 0 * visibility[:, 3:]], 1)}
            truth = rooms.get("shadow", room)[:, None]
            estimates |= {
                "network, light not in the photo": combine(unseen["visibility"], self(**unseen)),
                "traced": visibility[:, :1],
                "unknown is blocked": known,
                "unknown is constant": known + unknown * floors["constant"],
                "best for unknown": torch.minimum(torch.maximum(truth, known), known + unknown),
            }
        estimates = {k: v[:, 0] for k, v in estimates.items()}
        shadow, direct = rooms.get("shadow", room), rooms.get("direct", room)
        lit, weight = (direct > 0.1 * middle(direct)).float(), brightness(direct[:, None])[:, 0]
        unknown = (visibility[:, 1] > 0.02).float()
        power = lit * direct * rooms.get("radiance", room).mean(1).view(-1, 1, 1)
        share = power / power.sum(0).clamp(min=1e-9)

        def measures(e):
            error = lambda w: (scaled(e, shadow, w) - shadow) ** 2
            mean = lambda w, x: ((w * x).sum() / w.sum()).item() if (w > 0).sum() >= 50 else float("nan")
            regions = {"all": torch.ones_like(unknown), "unknown": unknown, "known": 1 - unknown}
            plain = {k: mean(lit * region, error(lit)) for k, region in regions.items()}
            plain |= {f"{k} weighted": mean(weight * region, error(weight)) for k, region in regions.items()}
            return plain | {"in the picture": mean(share, error(lit))}

        return [{name: measures(e) for name, e in estimates.items()}]

    def pictures(self, rooms, room):
        """The source with the most unknown light."""
        x = self.inputs(rooms, room)
        s = int(rooms.get("doubt", room).argmax())
        got = combine(x["visibility"], self(**x))
        pictures = {
            "left": (x["visibility"][s, 3] / x["visibility"][s, 2].clamp(min=1e-6)).clamp(0, 1) * (x["visibility"][s, 4] > 0),
            "direct": brightness(x["visibility"][s : s + 1, 2:3])[0, 0],
            "unknown": x["visibility"][s, 1],
            "traced": x["visibility"][s, 0],
            "network": got[s, 0],
            "truth": rooms.get("shadow", room, s),
        }
        return f"{rooms.names[room]} {rooms.sources[room][s]}", {k: v.numpy() for k, v in pictures.items()}


def ways(geometry, place):
    """How each pixel sees the light, [B, 12, h, w]: direction to it (of a sun: to the sun), its cosine with the normal, nearness; in a window's frame
    (x, y, into the room) that direction, where it meets the pane (-1..1 from edge to edge), and half the pane's sides over the distance."""
    center, half_x, half_y, sun = place.split(3, 1)
    dot = lambda a, b: (a * b).sum(1, keepdim=True)
    length = lambda a: torch.sqrt(dot(a, a) + 1e-6)
    to = center - geometry[:, 3:]
    far, long, high = length(to), length(half_x), length(half_y)
    x, y = half_x / long, half_y / high
    n = torch.cat([x[:, i : i + 1] * y[:, j : j + 1] - x[:, j : j + 1] * y[:, i : i + 1] for i, j in ((1, 2), (2, 0), (0, 1))], 1)
    bright = dot(sun, sun).clamp(max=1)
    way = (1 - bright) * to / far + bright * sun
    meets = to - way * (dot(to, n) / dot(way, n).clamp(max=-0.05))
    on_pane = torch.cat([-dot(meets, x) / long, -dot(meets, y) / high], 1).clamp(-2, 2)
    near = geometry[:, 5:].mean((1, 2, 3), keepdim=True) / -3 / far
    sides = torch.cat([long / far, high / far], 1).clamp(max=2)
    return torch.cat([way, dot(way, geometry[:, :3]), near / (1 + near), dot(way, x), dot(way, y), dot(way, n), on_pane, sides], 1)


def planes(rooms, items):
    x = {name: rooms.stack(name, items) for name in ["traced", "unknown", "traced_direct", "direct", "shadow", "depth", "normal", "albedo", "photo"]}
    x |= {name: rooms.stack(name, items)[..., None, None] for name in ["place", "radiance"]}
    whole = {room: explained(rooms, room) for room in {room for room, _ in items}}
    return x | {"explained": torch.stack([whole[room] for room, _ in items])}


def explained(rooms, room):
    """The shading [3, h, w] of all that burns, as ray-traced."""
    lit = rooms.get("traced_direct", room) * rooms.get("traced", room)
    return torch.einsum("shw,sc->chw", lit, rooms.get("radiance", room)) + rooms.get("path_trace_indirect", room).sum(0)


def visibility(x, seen):
    """The network's input [B, 5, h, w] from `planes` and `evidence`."""
    return torch.cat([x["traced"], x["unknown"], x["traced_direct"], seen], 1)


def evidence(x, explained):
    """Returns the evidence of the photo for a light of `radiance` [B, 3, 1, 1], by luminance, [B, 2, h, w]: the shading per unit radiance that it leaves for the
    light's own direct light, once all light as ray-traced (`explained` [B, 3, h, w], that of this light included) is taken away but this light's direct
    light; and the share of the photo's shading that the light would have unshadowed. Zeros where the photo is white."""
    shading, radiance = luminance(x["photo"] / x["albedo"].clamp(min=0.03)), luminance(x["radiance"]).clamp(min=1e-6)
    left = (shading - luminance(explained)) / radiance + x["traced_direct"] * x["traced"]
    share = (radiance * x["traced_direct"] / shading.clamp(min=1e-6)).clamp(0, 1)
    return torch.cat([left, share], 1) * (x["photo"].amax(1, keepdim=True) < WHITE)


def combine(visibility, shares):
    traced, unknown = visibility[:, :1], visibility[:, 1:2]
    lit, instead, doubt = shares.split(1, 1)
    return (1 - doubt) * (traced - unknown + unknown * lit) + doubt * instead


def scaled(got, want, weight):
    """`got` of each item times what brings it closest to `want`, within a factor of 4. The factor has no gradient."""
    sums = lambda x: (weight * x).flatten(1).sum(1).detach()
    factor = (sums(got * want) / sums(got * got).clamp(min=1e-6)).clamp(0.25, 4)
    return got * factor.view(-1, *[1] * (got.ndim - 1))


def middle(direct):
    """Medians over the lit pixels of [B, .., h, w], to compare with."""
    x = direct.flatten(1)
    return torch.where(x > 0, x, torch.nan).nanmedian(1).values.nan_to_num(1.0).view(-1, *[1] * (direct.ndim - 1))


def brightness(direct):
    """Weight 0..1 of the pixels of [B, 1, h, w]: in the dark a ratio of light is noise, and matters to nobody."""
    return (direct / middle(direct).clamp(min=1e-8)).clamp(0, 1)
