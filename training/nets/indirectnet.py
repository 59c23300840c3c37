"""IndirectNet: indirect shading, linear and non-negative in the light; and the paper's squashed network as a baseline.

Per color channel, with weights shared by all channels, x = A E:
    I = a x sum over scales of  g(p) x upsample( sum_k out_k x (kernel_k * (in_k x pool(x))) )
      + b x g(p) x upsample( sum_r out_r x (M (mean(in_r x pool(x)) + f_r x flux)) )
where the gates in, out, g, the 7 x 7 kernels and the matrix M are positive (softplus). The gates come from a U-net over geometry, albedo and mask,
the levels a, b and f of the whole picture from means, among them the channel's own albedo: multiple bounces scale with rho / (1 - rho).
No other operation involves the light: no bias, no activation. Hence I(a E1 + b E2) = a I(E1) + b I(E2) to rounding.

`flux` is the power of the light (flux.py). Most light of a source falls outside of the view; E_d alone does not determine this part,
nor a sun that shines beside the view. The flux is linear in the light like E_d.

The photo determines the light that returns from unseen surfaces: `left` is its shading minus the direct light of all sources that are on (`burning`).
Gates and levels may depend on it, as it is a property of the scene and not of the input light."""

import torch
import torch.nn.functional as F
from torch import nn

import augment
from layers import UNet, unit_scale, upsample

MAPS, RANK, KERNEL = 16, 48, 7
SCALES = (2, 4, 8)
BLOCK = 4  # pixels a side over which errors are measured
WHITE = 0.99  # a photo's pixel above it tells nothing
ALONE = 0.6  # share of the items to train on that are one light alone, as the program asks for them: errors of a mixture cancel
BLIND = 0.25  # share of the items to train on that have no photo


class Indirect(nn.Module):
    """Data, loss and measures of both networks. geometry [1, 6, 120, 160]: normal, xyz (m); albedo [1, 3, ..]; light [1, 1, ..]: 1 at pixels of visible
    lights; direct [1, 3, ..]: E_d of one lobe, three channels; flux [1, 3, 1, 1]: its power in m^2; left [1, 3, ..]: shading of the photo minus all
    direct light, zeros where the photo is saturated or a light, and everywhere without a photo; burning [1, 6, 1, 1]: mean E_d and flux of all lights
    that are on in the photo -> indirect [1, 3, ..]. For a lobe of unit radiance all three channels of `direct` and `flux` are equal, and those of
    `indirect` differ by albedo."""

    outputs = ["indirect"]
    judged_by = "L1"
    targets = [
        ("L1 / no indirect", lambda m: m["network"]["L1"], 0.5),
        ("L1 / TraceIndirect", lambda m: m["network"]["L1"] / m["TraceIndirect"]["L1"], 0.75),
        ("linearity residual", lambda m: m["network"]["linearity residual"], 1e-5),
        ("L1 / the squashed network's", lambda m: m["network"]["L1"] / m["squashedindirectnet"]["L1"], 1.05),
    ]

    @staticmethod
    def batch(rooms, g, size):
        """Light is linear, so random non-negative mixtures of a room's paths are as true as the paths. A third of the items start from what the
        product has."""
        room = torch.randint(len(rooms), (size,), generator=g).tolist()
        start, indirect, flux, photo, burning = [], [], [], [], []
        for r in room:
            p = len(rooms.paths[r])
            mix = torch.randn(p, 3, 1, 1, generator=g).exp() * (torch.rand(p, 1, 1, 1, generator=g) < 0.6)
            if torch.rand(1, generator=g) < ALONE:
                mix *= 0
            mix[torch.randint(p, (1,), generator=g)] += 0.1
            name = "path_traced" if torch.rand(1, generator=g) < 0.33 else "path_direct"
            start.append((mix * rooms.get(name, r)).sum(0))
            indirect.append((mix * rooms.get("indirect", r)).sum(0))
            flux.append((mix * rooms.get("path_flux", r)[..., None, None]).sum(0))
            # The photo, whatever light is passed through: as it is, or the room under another mixture.
            mix = torch.randn(p, 1, 1, 1, generator=g).exp() if torch.rand(1, generator=g) < 0.5 else torch.ones(p, 3, 1, 1)
            lit, power = (mix * rooms.get(name, r)).sum(0), (mix * rooms.get("path_flux", r)[..., None, None]).sum(0)
            shading = (mix * (rooms.get("path_direct", r) + rooms.get("indirect", r))).sum(0)
            photo.append(torch.stack([shading, lit]))
            burning.append(torch.cat([lit.mean((1, 2)), power[:, 0, 0]])[:, None, None])
        items = [(r, None) for r in room]
        x = {name: rooms.stack(name, items) for name in ["depth", "normal", "albedo", "light"]} | {
            "direct": torch.stack(start),
            "indirect": torch.stack(indirect),
            "shading": torch.stack(photo)[:, 0],
            "lit": torch.stack(photo)[:, 1],
        }
        fov = torch.stack([rooms.get("fov_x", r) for r in room])
        flip = augment.uniform(g, fov) < 0.5
        x = {name: torch.where(flip, augment.mirrored(v, name == "normal"), v) for name, v in x.items()}
        albedo = augment.choose(g, 0.5, augment.worse_albedo(g, x["albedo"]), x["albedo"])
        geometry = augment.geometry(g, x["depth"], x["normal"], fov)
        wrong = lambda scale: torch.exp(scale * torch.randn(size, 1, 1, 1, generator=g))
        flux, known = torch.stack(flux) * wrong(0.1), (augment.uniform(g, fov) > BLIND).float()
        # Estimated albedo and radiances are wrong together, as the photo is their product.
        seen = x["shading"] * (x["albedo"] / albedo.clamp(min=0.03)).clamp(max=4)
        white = (x["shading"] * x["albedo"]).amax(1, keepdim=True)
        white = white > white.flatten(1).quantile(0.9 + 0.1 * torch.rand(1, generator=g).item(), 1).view(-1, 1, 1, 1)
        left = known * (seen - x["lit"] * wrong(0.1)) * (1 - x["light"]) * ~white
        turn = torch.randperm(3, generator=g)  # light does not know colors by name
        colored = lambda v: v[:, turn]
        burning = known * torch.stack(burning)[:, torch.cat([turn, turn + 3])]
        return {
            "inputs": (geometry, colored(albedo), x["light"], colored(x["direct"]), colored(flux), colored(left), burning),
            "indirect": colored(x["indirect"]),
            "albedo": colored(x["albedo"]),
            "valid": 1 - x["light"],
        }

    def loss(self, batch):
        """L1 of E + L1 of A E, relative to the picture's mean."""
        got = self(*batch["inputs"]).float()
        error = (got - batch["indirect"]).abs() * batch["valid"] / (batch["indirect"].mean((1, 2, 3), keepdim=True) + 1e-4)
        return (error * (1 + batch["albedo"])).mean()

    @staticmethod
    def inputs(rooms, room, start="path_direct"):
        """For all paths of a room: [P, ..]."""
        items = [(room, p) for p in range(len(rooms.paths[room]))]
        geometry = torch.cat([rooms.stack("normal", items), augment.xyz(rooms.stack("depth", items), rooms.get("fov_x", room))], 1)
        planes = {"albedo": rooms.stack("albedo", items), "light": rooms.stack("light", items), "direct": rooms.stack(start, items)}
        flux, photo = rooms.get("path_flux", room)[..., None, None], rooms.get("photo", room)
        left, burning = evidence(photo, planes["albedo"][0], planes["light"][0], planes["direct"].sum(0), flux.sum(0))
        many = lambda v: v.expand(len(items), -1, -1, -1)
        return {"geometry": geometry, **planes, "flux": flux, "left": many(left), "burning": many(burning)}

    @staticmethod
    def floors(rooms):
        return {}

    def score(self, rooms, room, floors=None):
        """Per path: L1 of the indirect shading, and of that times albedo, over the L1 of no indirect at all; and the first of all paths together, in
        which a dark window counts little. Pixels of visible lights do not count. Of means over 4 x 4 pixels: the truth is not denoised."""
        x = self.inputs(rooms, room)
        truth = rooms.get("indirect", room)
        estimates = {"network": self(**x)}
        if floors is not None:
            estimates["network on ray-traced E_d"] = self(**self.inputs(rooms, room, "path_traced"))
            estimates["network, no photo"] = self(**x | {k: 0 * x[k] for k in ("left", "burning")})
            estimates["TraceIndirect"] = rooms.get("path_trace_indirect", room)
            whole, left = estimates["TraceIndirect"].sum(0), x["left"][0]
            level = (left * whole).sum() / ((left != 0) * whole**2).sum().clamp(min=1e-9)
            estimates["TraceIndirect, level by the photo"] = estimates["TraceIndirect"] * level.clamp(min=0)
        lit, albedo = 1 - x["light"], x["albedo"]
        mean = lambda e: F.avg_pool2d(e * lit[:1], BLOCK)
        ratio = lambda e, t: mean(e - t).abs().sum((1, 2, 3)) / mean(t).sum((1, 2, 3)).clamp(min=1e-6)
        measures = {k: {"L1": ratio(e, truth), "L1 of A E": ratio(e * albedo, truth * albedo)} for k, e in estimates.items()}
        items = [{k: {m: v[p].item() for m, v in measure.items()} for k, measure in measures.items()} for p in range(len(truth))]
        for k, e in estimates.items():
            items[0][k]["L1, all light"] = ratio(e.sum(0, keepdim=True), truth.sum(0, keepdim=True))[0].item()
        other = {"direct": x["direct"].roll(1, 0).flip(-1), "flux": x["flux"].roll(1, 0)}
        got = self(**x | {k: 0.3 * x[k] + 2.0 * other[k] for k in other})
        want = 0.3 * estimates["network"] + 2.0 * self(**x | other)
        items[0]["network"]["linearity residual"] = ((got - want).abs().max() / want.max()).item()
        return items

    def pictures(self, rooms, room):
        """All paths together."""
        x = {k: v.sum(0, keepdim=True) if k in ("direct", "flux") else v[:1] for k, v in self.inputs(rooms, room).items()}
        planes = {
            "E_d": x["direct"][0],
            "TraceIndirect": rooms.get("path_trace_indirect", room).sum(0),
            "network": self(**x)[0],
            "truth": rooms.get("indirect", room).sum(0),
        }
        scale = 2 * float(rooms.get("indirect", room).sum(0).mean())
        return rooms.names[room], {"albedo": x["albedo"][0].numpy()} | {k: torch.as_tensor(v).numpy() / scale for k, v in planes.items()}


def relative(flux, geometry):
    """Power as a shading: over pi and the room's scale squared."""
    return flux.float() / torch.pi / (geometry[:, 5:].mean((1, 2, 3), keepdim=True) / 3) ** 2


def evidence(photo, albedo, light, direct, flux):
    """`left` [1, 3, h, w] and `burning` [1, 6, 1, 1] of a photo [3, h, w], when `direct` [3, h, w] and `flux` [3, 1, 1] are those of all that burns."""
    seen = (photo.amax(0, keepdim=True) < WHITE) * (1 - light)
    left = (photo / albedo.clamp(min=0.03) - direct) * seen
    return left[None], torch.cat([direct.mean((1, 2)), flux[:, 0, 0]]).view(1, 6, 1, 1)


def told(left, burning, geometry):
    """Returns the evidence of the photo, an input of the gates: planes [B, 2, h, w] (logarithm of `left` over its mean; where it is known), numbers [B, 3 channels, 3]
    (logarithms of the mean of `left` over that of the direct light, and over the power; whether it is known)."""
    seen = (left.abs().sum(1, keepdim=True) > 0).float()
    mean = (left.clamp(min=0) * seen).sum((2, 3)) / seen.sum((2, 3)).clamp(min=1)
    known = (seen.mean((2, 3)) > 0).float()
    luminance = left.clamp(min=0).mean(1, keepdim=True)
    middle = mean.mean(1).view(-1, 1, 1, 1)
    plane = torch.log(0.1 + luminance / (middle + 1e-6)) * seen
    power = relative(burning[:, 3:], geometry)[:, :, 0, 0]
    over = lambda x: torch.log((mean + 1e-6) / (x + 1e-6)).clamp(-4, 4) * known
    numbers = torch.stack([over(burning[:, :3, 0, 0]), over(power), known.expand_as(mean)], 2)
    return torch.cat([plane, seen], 1), numbers


def positive(shape, start):
    """Parameters whose softplus starts at about `start`."""
    return nn.Parameter(torch.log(torch.expm1(torch.tensor(start))) + 0.1 * torch.randn(shape))


class IndirectNet(Indirect):
    def __init__(self):
        super().__init__()
        widths = [24, 40, 64, 96]
        self.gates = UNet(12, widths)
        inner = [2 * MAPS + 4 * (len(SCALES) + 1), 2 * MAPS, 2 * MAPS + 2 * RANK]
        self.heads = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in zip(widths, inner))
        self.levels = nn.Sequential(nn.Linear(widths[-1] + 18, 64), nn.ReLU(), nn.Linear(64, RANK + 2))
        self.kernels = nn.ParameterList(positive((MAPS, 1, KERNEL, KERNEL), KERNEL**-2.0) for _ in SCALES)
        self.matrix = positive((RANK, RANK), 1.0 / RANK)

    def forward(self, geometry, albedo, light, direct, flux, left, burning):
        planes = torch.cat([unit_scale(geometry), albedo, light], 1)
        seen, numbers = told(left, burning, geometry)
        levels = self.gates(torch.cat([planes, seen], 1))
        gates = [F.softplus(head(level).float()) for head, level in zip(self.heads, levels)]
        mean = planes.mean((2, 3))
        spread = ((planes[:, :6] - mean[:, :6, None, None]) ** 2).mean((2, 3))
        scene = torch.cat([levels[-1].mean((2, 3)), mean[:, :6], spread, mean[:, 6:9].mean(1, keepdim=True), mean[:, 9:]], 1)
        scene = torch.cat([scene[:, None].expand(-1, 3, -1), mean[:, 6:9, None], numbers], 2)  # [B, channel, features]
        whole_level, local_level, unseen = F.softplus(self.levels(scene).float() + 0.54).flatten(0, 1).split([1, 1, RANK], 1)
        final = F.pixel_shuffle(gates[0][:, 2 * MAPS :], 2)  # at full size, so that edges stay sharp
        with torch.autocast("cpu", enabled=False):
            b, c, h, w = direct.shape
            x = (albedo.float() * direct.float()).reshape(b * c, 1, h, w)
            each = lambda gate: gate.repeat_interleave(c, 0) if b > 1 else gate
            total = 0
            for k, (scale, gate) in enumerate(zip(SCALES, gates)):
                pooled = F.avg_pool2d(x, scale)
                maps = F.conv2d(each(gate[:, :MAPS]) * pooled, F.softplus(self.kernels[k]), padding=KERNEL // 2, groups=MAPS)
                y = (each(gate[:, MAPS : 2 * MAPS]) * maps).mean(1, keepdim=True)
                total = total + each(final[:, k : k + 1]) * upsample(y, scale)
            collect, give = each(gate[:, 2 * MAPS : 2 * MAPS + RANK]), each(gate[:, 2 * MAPS + RANK :])
            whole = ((collect * pooled).mean((2, 3)) + 0.01 * unseen * relative(flux, geometry).reshape(b * c, 1)) @ F.softplus(self.matrix)
            y = (give * whole[:, :, None, None]).mean(1, keepdim=True)
            y = each(final[:, len(SCALES) :]) * upsample(y, SCALES[-1])
            return (local_level[..., None, None] * total + whole_level[..., None, None] * y).reshape(b, c, h, w)


class SquashedIndirectNet(Indirect):
    """The paper's form: light squashed by arc tangent, all in one U-net. Fed relative to a mean of the light, which the paper leaves to the
    exposure."""

    def __init__(self):
        super().__init__()
        self.unet = UNet(30, [32, 48, 72, 104])
        self.head = nn.Conv2d(32, 12, 3, padding=1)

    def forward(self, geometry, albedo, light, direct, flux, left, burning):
        seen, numbers = told(left, burning, geometry)
        told_everywhere = numbers.flatten(1)[..., None, None].expand(-1, -1, *direct.shape[2:])
        flux = relative(flux, geometry)
        scale = direct.mean((1, 2, 3), keepdim=True) + 0.1 * flux.mean(1, keepdim=True) + 1e-6
        squashed = [torch.atan(3 * x / scale) for x in (direct, albedo * direct, flux.expand_as(direct))]
        y = F.pixel_shuffle(self.head(self.unet(torch.cat([*squashed, unit_scale(geometry), albedo, light, seen, told_everywhere], 1))[0]), 2).float()
        return torch.tan(0.99 * torch.sigmoid(y) * torch.pi / 2) * scale
