"""MNet: albedo, normal and roughness of each pixel, from a photo and its points."""

import torch
import torch.nn.functional as F
from torch import nn

import augment
from layers import UNet, block, luminance, unit_scale

GAPS = (1, 2, 4, 8, 16)
FLOOR = 0.02  # of albedo, below which its logarithm matters less


class MNet(nn.Module):
    """photo [1, 3, 240, 320]: linear, 98 % of the pixels without a light below 0.9..1, clipped like the photo; geometry [1, 6, 240, 320]: normals from
    depth, xyz (m); light [1, 1, 240, 320]: 1 at pixels of visible lights -> albedo [1, 3, ..] and rough [1, 1, ..] in 0..1, normal [1, 3, ..] of unit
    length."""

    outputs = ["albedo", "normal", "rough"]
    judged_by = "albedo, log"
    needs = "room"  # data.rooms_of reads it
    targets = [
        ("albedo error / RetinexMaterials", lambda m: m["network"]["albedo"] / m["RetinexMaterials"]["albedo"], 0.75),
        ("normal angle / normals from depth", lambda m: m["network, noisy depth"]["normal"] / m["noisy depth"]["normal"], 1.0),
        ("roughness error / constant", lambda m: m["network"]["rough"] / m["constant"]["rough"], 1.0),
    ]

    def __init__(self):
        super().__init__()
        widths = [56, 88, 136, 192, 224]
        self.unet = UNet(13, widths)
        self.whole = nn.Sequential(nn.Linear(widths[-1] + 27, 128), nn.ReLU(), nn.Linear(128, widths[0]))
        self.mix = block(widths[0], widths[0])
        self.head = nn.Conv2d(widths[0], 28, 3, padding=1)

    def forward(self, photo, geometry, light):
        photo = photo.clamp(0, 8)
        seen = torch.cat([photo.sqrt(), torch.log(photo + 0.02) / 2], 1)
        levels = self.unet(torch.cat([seen, unit_scale(geometry), light], 1))
        # Means over the picture, which group normalization removes: of the photo, and of its surfaces that face up or down and its lights.
        up = geometry[:, 1:2]
        shares = [up.clamp(min=0), (-up).clamp(min=0), light]
        facts = [levels[-1], *shares, seen, *(share * seen for share in shares)]
        whole = self.whole(torch.cat([fact.mean((2, 3)) for fact in facts], 1))
        y = F.pixel_shuffle(self.head(self.mix(levels[0] + whole[:, :, None, None])), 2).float()
        # Normals are bent from those of the depth; one that has no direction is left to the network.
        normal = geometry[:, :3] + 1.01 * torch.tanh(y[:, 3:6]) * 1.5
        normal = normal / torch.sqrt((normal * normal).sum(1, keepdim=True) + 1e-6)
        return torch.sigmoid(y[:, :3]), normal, torch.sigmoid(y[:, 6:7])

    @staticmethod
    def batch(rooms, g, size):
        """A half of the size asked for: the pictures are four times as large as those of the other networks."""
        size = max(size // 2, 1)
        items = [(room, None) for room in torch.randint(len(rooms), (size,), generator=g).tolist()]
        x = planes(rooms, items)
        fov = torch.stack([rooms.get("fov_x", room) for room, _ in items])
        flip = augment.uniform(g, fov) < 0.5
        x = {name: torch.where(flip, augment.mirrored(v, name == "normal"), v) for name, v in x.items()}
        photo, x["albedo"] = augment.recolored(g, x["photo"], x["albedo"])
        photo, _ = augment.exposed(g, photo, x["light"])
        depth = augment.choose(g, 0.7, augment.worse_depth(g, x["depth"]), x["depth"])
        points = augment.xyz(depth, fov)
        inputs = (augment.photographed(g, photo), torch.cat([augment.normals_of(points), points], 1), x["light"])
        return {"inputs": inputs} | {k: x[k] for k in ["albedo", "normal", "rough"]} | {"valid": 1 - x["light"]}

    def loss(self, batch):
        """Returns the sum of three losses. Albedo: the L1 of its logarithm, half of it after the mean error of each item is subtracted, and the squared
        gradients of that error. Normals: L2. Roughness: 0.5 (L2 + gradients)."""
        albedo, normal, rough = self(*batch["inputs"])
        valid = batch["valid"]
        mean = lambda x: (x * valid).mean() / valid.mean().clamp(min=1e-3)
        error = torch.log(albedo + FLOOR) - torch.log(batch["albedo"] + FLOOR)
        per_item = lambda x: (x * valid).sum((1, 2, 3), keepdim=True) / (3 * valid.sum((1, 2, 3), keepdim=True)).clamp(min=1)
        color = 0.5 * mean(error.abs()) + 0.5 * mean((error - per_item(error)).abs()) + gradients(error, valid)
        gloss = mean((rough - batch["rough"]) ** 2) + gradients(rough - batch["rough"], valid)
        return color + mean((normal - batch["normal"]) ** 2) + 0.5 * gloss

    @staticmethod
    def inputs(rooms, room, worse=None):
        """`worse`: depth as an estimate is, from this generator."""
        x = planes(rooms, [(room, None)])
        depth = x["depth"] if worse is None else augment.worse_depth(worse, x["depth"])
        points = augment.xyz(depth, rooms.get("fov_x", room)[None])
        return {"photo": x["photo"].clamp(max=1), "geometry": torch.cat([augment.normals_of(points), points], 1), "light": x["light"]}

    @staticmethod
    def floors(rooms):
        """The mean of up to 200 rooms."""
        mean = lambda name: torch.stack([rooms.get(name, room).mean((-1, -2)) for room in range(min(len(rooms), 200))]).mean(0)
        return {"albedo": mean("albedo").view(1, 3, 1, 1), "rough": mean("rough").view(1, 1, 1, 1)}

    def score(self, rooms, room, floors=None):
        """Of pixels of no light: scale-invariant error of albedo (squared, after the least-squares level), mean angle of normals in degrees, squared error
        of roughness."""
        x, inputs = planes(rooms, [(room, None)]), self.inputs(rooms, room)
        estimates = {"network": self(**inputs)}
        if floors is not None:
            worse = self.inputs(rooms, room, torch.Generator().manual_seed(room))
            estimates["network, noisy depth"] = self(**worse)
            estimates["noisy depth"] = (None, worse["geometry"][:, :3], None)
            estimates["true depth"] = (None, inputs["geometry"][:, :3], None)
            estimates["constant"] = (floors["albedo"].expand_as(x["albedo"]), None, floors["rough"].expand_as(x["rough"]))
            estimates["photo"] = (inputs["photo"], None, None)
            retinex = rooms.beside("estimates.npz", room)
            if retinex is not None:
                estimates["RetinexMaterials"] = (torch.from_numpy(retinex["albedo"]).float().movedim(-1, 0)[None], None, None)
        valid = 1 - x["light"]
        mean = lambda v: ((v * valid).sum() / (valid.sum() * v.shape[1])).item()
        angle = lambda n: torch.rad2deg(torch.acos((n * x["normal"]).sum(1, keepdim=True).clamp(-1, 1)))
        out = {}
        for name, (albedo, normal, rough) in estimates.items():
            out[name] = {}
            if albedo is not None:
                out[name]["albedo"] = mean((albedo * level(albedo, x["albedo"], valid) - x["albedo"]) ** 2)
                out[name]["albedo, own level"] = mean((albedo - x["albedo"]) ** 2)
                out[name]["albedo, log"] = mean(torch.log((luminance(albedo) + FLOOR) / (luminance(x["albedo"]) + FLOOR)).abs().expand_as(albedo))
            if normal is not None:
                out[name]["normal"] = mean(angle(normal))
            if rough is not None:
                out[name]["rough"] = mean((rough - x["rough"]) ** 2)
        return [out]

    def pictures(self, rooms, room):
        x = planes(rooms, [(room, None)])
        albedo, normal, rough = self(**self.inputs(rooms, room))
        shown = {
            "photo": x["photo"].clamp(max=1),
            "albedo": albedo,
            "true albedo": x["albedo"],
            "normal": (normal + 1) / 2,
            "true normal": (x["normal"] + 1) / 2,
        }
        shown |= {"rough": rough.expand(-1, 3, -1, -1), "true rough": x["rough"].expand(-1, 3, -1, -1)}
        return rooms.names[room], {k: v[0].numpy() for k, v in shown.items()}


def planes(rooms, items):
    x = {name: rooms.stack(f"{name}_full", items) for name in ["photo", "albedo", "normal", "rough", "depth"]}
    return x | {"light": F.interpolate(rooms.stack("light", items), scale_factor=2, mode="nearest")}


def level(got, want, valid):
    """The factor of each item that brings `got` closest to `want`, without a gradient."""
    sums = lambda x: (x * valid).sum((1, 2, 3), keepdim=True).detach()
    return sums(got * want) / sums(got * got).clamp(min=1e-6)


def gradients(error, valid):
    """Squared differences of errors at gaps of 1 to 16 pixels, mean over gaps and both directions."""
    total = 0
    for gap in GAPS:
        for dim in (-1, -2):
            near, far = lambda x: x.narrow(dim, 0, x.shape[dim] - gap), lambda x: x.narrow(dim, gap, x.shape[dim] - gap)
            pair = near(valid) * far(valid)
            total = total + (pair * (near(error) - far(error)) ** 2).mean() / pair.mean().clamp(min=1e-3)
    return total / (2 * len(GAPS))
