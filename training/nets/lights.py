"""Networks that estimate light sources: a visible lamp or window, or the invisible lamp or window of a room.

A lamp is a box with one radiance, a window a rectangle with three lobes. The loss is that of the lights' direct shading (emit.py). Lengths inside
are in units of a third of the mean depth. `confidence` contains the probability that the light is on, and the expected L1 error of its direct
shading, relative to the truth's mean plus a twentieth of that of all light.

Training relights its rooms: every light path has a random factor, and the photo changes accordingly."""

import math
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import augment
import emit
import form
from layers import block, luminance, unit_scale

CELL = 4  # pixels of the half plane that E_j is measured over
CHOSEN = 300  # of these cells, to learn from
BRIGHT = 10.0  # E_j above this is beyond what a photo shows
FACES = 6 * 7 * 4  # numbers of `faces`
SEEN = 6 + 3 + 3 + 3  # numbers of the brightest place and of what the light would give alone
LEAST = 0.02  # an invisible light that gives less than this share of all light is none


class Seen(NamedTuple):
    """Initial values for decoding a light: unit of length [B, 1] (m); level [B, 3] at which this light alone would fit the photo's shading best, from
    where it starts (of one that is not seen, mean shading); place [B, 3] (m) and shading [B, 3] of what is lit most, by the fourth power of shading."""

    unit: torch.Tensor
    alone: torch.Tensor
    spot: torch.Tensor
    glare: torch.Tensor


class Lights(nn.Module):
    """Base of the four networks that estimate lights.

    Inputs: photo [1, 3, 120, 160], linear RGB, clipped where the photo is saturated; the exposure places the 98 % quantile of the pixels without a light
    at 0.9 to 1. geometry [1, 6, 120, 160]: normals, points (m). albedo [1, 3, 120, 160]. lights [1, 2, 120, 160]: masks of all visible lights and of this
    one. start [1, 5, 1, 1]: center (m) and half extents (m) of this light by mask and depth, zeros for an invisible light."""

    visible, window = False, False
    judged_by = "E_j / all light"
    targets = [
        ("E_j / training mean's", lambda m: m["network"]["E_j"] / m["training mean"]["E_j"], 0.7),
        ("E_j / InitLights'", lambda m: m["network"]["E_j"] / m["InitLights"]["E_j"], 0.7),
    ]

    def __init__(self, numbers):
        super().__init__()
        widths = [40, 56, 80, 112, 128]
        self.stem = nn.Sequential(block(23 * 4, widths[0]), block(widths[0], widths[0]))
        self.down = nn.ModuleList(nn.Sequential(block(a, b, 2), block(b, b)) for a, b in zip(widths, widths[1:]))
        self.squeeze = block(widths[-1], 32)
        self.head = nn.Sequential(
            nn.Linear(32 * 4 * 5 + widths[-1] + 5 + FACES + SEEN, 256), nn.Sequential(nn.ReLU(), nn.Dropout(0.2)), nn.Linear(256, numbers + 2)
        )
        self.register_buffer("calibration", torch.tensor([1.0, 0.0, 1.0, 0.0]))

    def numbers(self, photo, geometry, albedo, lights, start):
        """The head's numbers [B, ..], and what is Seen."""
        unit = geometry[:, 5:].mean((1, 2, 3)).view(-1, 1) / -3
        plain, begin = unit_scale(geometry), start / unit[..., None, None]
        shading = (photo / albedo.clamp(min=0.05)).clamp(max=10)
        gray = torch.log(0.02 + luminance(shading))
        falls, valid = self.falls(plain, begin), 1 - lights[:, :1]
        planes = [photo.clamp(0, 8).sqrt(), plain, albedo, gray, lights, begin.expand(-1, -1, *photo.shape[2:]), lights[:, 1:] * gray]
        planes += [torch.log(falls + 0.02), gray - torch.log(falls + 0.02)]
        x = self.stem(F.pixel_unshuffle(torch.cat(planes, 1), 2))
        for down in self.down:
            x = down(x)
        mean = lambda v: (v * valid).mean((2, 3))
        alone = mean(falls * shading) / (mean(falls * falls) + 1e-4)
        glare = luminance(shading) ** 4 + 1e-8
        spot = mean(glare * torch.cat([plain, shading], 1)) / (mean(glare) + 1e-9)
        start = begin[:, :, 0, 0]
        told = [start, faces(plain, shading, valid), spot[:, :6], spot[:, 3:6] - start[:, :3], torch.log(spot[:, 6:] + 0.02), torch.log(alone + 0.02)]
        x = torch.cat([self.squeeze(x)[:, :, :4, :5].flatten(1), x.mean((2, 3)), *told], 1)
        return self.head(x).float(), Seen(unit, alone, spot[:, 3:6] * unit, spot[:, 6:])

    def falls(self, geometry, start):
        """[B, 1, h, w]: how much of a small light at `start` falls on each pixel, beside what falls on the middle of the view; lengths in units. One
        everywhere for a light that is not seen."""
        if not self.visible:
            return torch.ones_like(geometry[:, :1])
        to = start[:, :3] - geometry[:, 3:]
        square = (to * to).sum(1, keepdim=True)
        cosine = ((to * geometry[:, :3]).sum(1, keepdim=True) / torch.sqrt(square + 1e-6)).clamp(min=0)
        return spread(start[:, :3, 0, 0], 1.0)[..., None, None] * cosine / (square + 4 * start[:, 3:4] * start[:, 4:] / torch.pi)

    def decode(self, y, seen, start):
        """The outputs by name, from what `numbers` gives. A light that is not sure to burn burns less; the confidence is calibrated, this share is not."""
        guess = self.light(y, seen, start)
        guess["radiance"] = guess["radiance"] * share(y[:, -2:-1, None])
        a, b, c, d = self.calibration
        guess["confidence"] = torch.cat([torch.sigmoid(a * y[:, -2:-1] + b), torch.exp(c * expected(y) + d)], 1)
        return guess

    @classmethod
    def chosen(cls, rooms, room):
        """The rows of a room's lights that a network of this kind is for; one None where an invisible light is not there."""
        kind = "window" if cls.window else "lamp"
        if cls.visible:
            return [k for k, name in enumerate(rooms.lights[room]) if name.startswith(kind)]
        return [next((k for k, name in enumerate(rooms.lights[room]) if name == f"inv_{kind}"), None)]

    @classmethod
    def batch(cls, rooms, g, size):
        """Lights of this kind; of invisible ones any room, as often as rooms have them."""
        known = [(room, row) for room in range(len(rooms)) for row in cls.chosen(rooms, room)]
        if not known:
            raise SystemExit(f"{cls.__name__}: wanted rooms with such a light, got {len(rooms)} without")
        items = [known[k] for k in torch.randint(len(known), (size,), generator=g)]
        relit = [relight(rooms, room, row, factors(rooms, room, g)) for room, row in items]
        x = {k: torch.stack([r[k] for r in relit]) for k in relit[0]}
        x |= {name: rooms.stack(name, [(room, None) for room, _ in items]) for name in ["depth", "normal", "albedo"]}
        fov = torch.stack([rooms.get("fov_x", room) for room, _ in items])
        painted = augment.repainted(g, x["albedo"])
        x["photo"], x["albedo"] = torch.where(x["lights"][:, :1] > 0, x["photo"], x["photo"] * painted / x["albedo"].clamp(min=1e-3)), painted
        x["photo"], gain = augment.exposed(g, x["photo"], x["lights"][:, :1])
        x["form"], x["shading"], x["whole"] = scaled(x["form"], gain), x["shading"] * gain, x["whole"] * gain
        flip = augment.uniform(g, fov) < 0.5
        planes = {k: augment.mirrored(x[k], k == "normal") for k in ["photo", "lights", "shading", "whole", "depth", "normal", "albedo"]}
        planes |= {"form": mirrored_form(x["form"]), "surface": x["surface"] * x["surface"].new_tensor([-1, 1, 1])}
        x |= {k: torch.where(flip.view(-1, *[1] * (v.ndim - 1)), v, x[k]) for k, v in planes.items()}
        albedo = augment.choose(g, 0.6, augment.worse_albedo(g, x["albedo"]), x["albedo"])
        geometry = augment.geometry(g, x["depth"], x["normal"], fov)
        lights = x["lights"]
        if cls.visible:
            lights = torch.cat([lights[:, :1], augment.ragged(g, lights[:, 1:])], 1)
            lights = torch.cat([torch.maximum(lights[:, :1], lights[:, 1:]), lights[:, 1:]], 1)
        true = torch.cat([x["normal"], augment.xyz(x["depth"], fov)], 1)
        grid = augment.parts(g, lights[:, 1:], lights[:, :1])
        photo, geometry, albedo, lights, true = (augment.part(v, grid) for v in (x["photo"], geometry, albedo, lights, true))
        x |= {k: augment.part(x[k], grid) for k in ["albedo", "shading", "lights", "whole"]}
        return {
            "inputs": (augment.photographed(g, photo), geometry, albedo, lights, begin(geometry, lights, cls.window)),
            "places": pick(g, true, albedo=x["albedo"], shading=x["shading"], lights=x["lights"], whole=x["whole"]),
            "form": x["form"],
            "surface": x["surface"],
            "there": x["there"],
        }

    def loss(self, batch):
        """L1 of E_j and of A E_j, of the logarithm of E_j and of its mean's, Chamfer distance, the form's own terms; and what makes the confidence
        right."""
        y, seen = self.numbers(*batch["inputs"])
        with torch.autocast("cpu", enabled=False):
            return self.measured(y, Seen(*(v.float() for v in seen)), batch)

    def measured(self, y, seen, batch):
        guess = self.decode(y, seen, batch["inputs"][-1][:, :, 0, 0])
        shading, relative = self.errors(guess, batch["places"])
        place = chamfer(self.surface(guess), batch["surface"]) / seen.unit[:, 0] + self.form_loss(guess, batch["form"])
        burns = F.binary_cross_entropy_with_logits(y[:, -2:-1], batch["there"].view(-1, 1))
        doubt = (expected(y)[:, 0] - relative.detach()).abs().mean()
        exists = (batch["surface"].abs().sum((1, 2)) > 0).float()
        weight = 1.0 if self.visible else 0.1
        return shading + weight * (place * exists).sum() / exists.sum().clamp(min=1) + 0.2 * burns + 0.05 * doubt

    def errors(self, guess, p):
        """Returns the loss of the shading of `guess` at the places `p`, and the logarithm of each item's error, relative as `confidence` tells it."""
        got, want = self.shading(guess, p["points"], p["normals"]), p["shading"]
        mean = lambda x: (x * p["valid"]).mean((1, 2))
        error = (got.clamp(max=BRIGHT) - want.clamp(max=BRIGHT)).abs()
        whole = mean(p["whole"]) + 0.05
        level = (mean(error) + mean(error * p["albedo"])) / whole
        tone = mean((torch.log1p(10 * got) - torch.log1p(10 * want)).abs())
        sent = torch.log((mean(got) + 0.02 * whole) / (mean(want) + 0.02 * whole)).abs()
        return (level + tone + 0.2 * sent).mean(), torch.log(mean(error) / (mean(want) + 0.05 * whole) + 1e-3)

    def confidences(self, rooms):
        """Of relit, degraded items of rooms, eight a room but no more than 400: logit of burning, whether it burns; expected and true logarithm of the
        relative error."""
        out = []
        for k in range(min(len(rooms), 50)):
            batch = self.batch(rooms, torch.Generator().manual_seed(k), 8)
            y, seen = self.numbers(*batch["inputs"])
            _, relative = self.errors(self.decode(y, seen, batch["inputs"][-1][:, :, 0, 0]), batch["places"])
            out.append(torch.stack([y[:, -2], batch["there"], expected(y)[:, 0], relative], 1))
        return torch.cat(out).unbind(1)

    @torch.no_grad()
    def calibrate(self, rooms):
        """Two numbers each for both parts of the confidence, from held-out rooms: logistic regression, and least squares of logarithms moved so that the
        mean error is right; both drawn a little to no change."""
        logit, there, guess, relative = self.confidences(rooms)
        start, pull = torch.tensor([1.0, 0.0]), 0.01 * len(logit)
        a = start.clone().requires_grad_()
        search = torch.optim.LBFGS([a], line_search_fn="strong_wolfe", max_iter=100)

        @torch.enable_grad()
        def loss():
            search.zero_grad()
            value = F.binary_cross_entropy_with_logits(a[0] * logit + a[1], there, reduction="sum") + pull / 2 * ((a - start) ** 2).sum()
            value.backward()
            return value

        search.step(loss)
        second = torch.stack([guess, torch.ones_like(guess)], 1)
        c = torch.linalg.solve(second.T @ second + pull * torch.eye(2), second.T @ relative + pull * start)
        c[1] += torch.log(relative.exp().mean() / (second @ c).exp().mean())
        self.calibration.copy_(torch.cat([a.detach(), c]))

    @torch.no_grad()
    def reliability(self, rooms):
        """How far the confidence can be trusted on relit, degraded items: Brier score of burning beside that of the mean; and the L1 error of E_j,
        relative to the truth, of the half of the items that are expected to be better and of the other half."""
        logit, there, guess, relative = self.confidences(rooms)
        a, b, c, d = self.calibration
        brier = lambda p: ((p - there) ** 2).mean().item()
        order = (c * guess).argsort()
        half = len(order) // 2
        error, told = relative.exp(), torch.exp(c * guess + d)
        return {
            "burns, Brier": brier(torch.sigmoid(a * logit + b)),
            "burns, Brier of the mean": brier(there.mean()),
            "burns, Brier before calibration": brier(torch.sigmoid(logit)),
            "expected error, trusted half": told[order[:half]].mean().item(),
            "error, trusted half": error[order[:half]].mean().item(),
            "expected error, other half": told[order[half:]].mean().item(),
            "error, other half": error[order[half:]].mean().item(),
        }

    @classmethod
    def inputs(cls, rooms, room, worse=None):
        """For all such lights of a room; `worse`: depth, normals and albedo as estimates are, from this generator."""
        rows = cls.chosen(rooms, room) or [None]
        items = [(room, None)] * len(rows)
        x = {name: rooms.stack(name, items) for name in ["depth", "normal", "albedo"]}
        relit = [relight(rooms, room, row, {}) for row in rows]
        lights = torch.stack([r["lights"] for r in relit])
        fov = rooms.get("fov_x", room).expand(len(rows))
        geometry = torch.cat([x["normal"], augment.xyz(x["depth"], fov)], 1)
        albedo = x["albedo"]
        if worse is not None:
            geometry, albedo = augment.geometry(worse, x["depth"], x["normal"], fov, 1.0), augment.worse_albedo(worse, albedo)
        photo = torch.stack([r["photo"] for r in relit]).clamp(max=1)
        return {"photo": photo, "geometry": geometry, "albedo": albedo, "lights": lights, "start": begin(geometry, lights, cls.window)}

    def forward(self, photo, geometry, albedo, lights, start):
        y, seen = self.numbers(photo, geometry, albedo, lights, start)
        return tuple(self.decode(y, seen, start[:, :, 0, 0]).values())

    @classmethod
    def floors(cls, rooms):
        """The mean light of up to 300 rooms: of a seen one relative to its start; radiances and bandwidths by their logarithm."""
        forms, starts = [], []
        for room in range(min(len(rooms), 300)):
            rows = [row for row in cls.chosen(rooms, room) if row is not None]
            if rows:
                forms.append(torch.stack([rooms.get("form", room, row) for row in rows]))
                starts.append(cls.inputs(rooms, room)["start"][:, :, 0, 0])
        return {"mean": cls.middle(torch.cat(forms), torch.cat(starts))}

    def score(self, rooms, room, floors=None):
        """Per light, E_j and distances as the reference's code has them: mean absolute error of E_j over the picture, Chamfer distance in meters. An
        invisible light that nothing estimates has no distance. `radiance` is that of a lamp, or of sky and ground."""
        rows = self.chosen(rooms, room)
        if not rows:
            return []
        x = self.inputs(rooms, room)
        guesses = {"network": self(**x)}
        if floors is not None:
            guesses["network, degraded inputs"] = self(**self.inputs(rooms, room, torch.Generator().manual_seed(room)))
            guesses["training mean"] = self.mean_guess(floors["mean"], x["start"][:, :, 0, 0])
        cells = lambda v: F.avg_pool2d(v, CELL).flatten(2).transpose(1, 2)
        points, normals = cells(x["geometry"][:, 3:]), F.normalize(cells(x["geometry"][:, :3]), dim=2)
        found = rooms.beside("estimates.npz", room) if floors is not None else None
        items = []
        for k, row in enumerate(rows):
            relit, dark = relight(rooms, room, row, {}), cells(1 - x["lights"][k : k + 1, :1]) > 0.99
            want, whole = cells(relit["shading"][None]).clamp(max=BRIGHT) * dark, (cells(relit["whole"][None]) * dark).mean().item()
            there, name = bool(relit["there"]), rooms.lights[room][row] if row is not None else ""
            answers = {}
            for title, guess in guesses.items():
                one = dict(zip(self.outputs, (v[k : k + 1] for v in guess)))
                answers[title] = (
                    self.shading(one, points[k : k + 1], normals[k : k + 1]),
                    self.surface(one),
                    one["radiance"][:, -2:].sum(1).mean().item(),
                )
            if found is not None:
                sought = np.flatnonzero(found["lights"] == (name or f"inv_{'window' if self.window else 'lamp'}"))
                answers["InitLights"] = (0 * want, None, 0.0)
                for at in sought:
                    shading = torch.from_numpy(found["direct"][at]).float().movedim(-1, 0)[None]
                    answers["InitLights"] = (cells(shading), torch.from_numpy(found["surface"][at])[None], float(found["radiance"][at].mean()))
            item, none = {}, float("nan")
            for title, (shading, surface, radiance) in answers.items():
                error = ((shading.clamp(max=BRIGHT) - want).abs() * dark).mean().item()
                item[title] = {
                    "E_j": error,
                    "E_j / all light": error / whole,
                    "Chamfer": chamfer(surface, rooms.get("surface", room, row)[None])[0].item() if there and surface is not None else none,
                    "radiance, there": radiance if there else none,
                    "radiance, not there": none if there else radiance,
                    "mean E_j, there": shading.mean().item() if there else none,
                    "mean E_j, not there": none if there else shading.mean().item(),
                }
                if title.startswith("network"):
                    p, told = guesses[title][-1][k].tolist()
                    got = error / (want.mean().item() + 0.05 * whole)
                    item[title] |= {
                        "burns, wrong": float((p > 0.5) != there),
                        "expected / got error, log": abs(math.log((told + 1e-3) / (got + 1e-3))),
                    }
            items.append(item)
        return items

    def cast(self, guess, geometry):
        """E_j of lights at each pixel, [B, 3, h, w]."""
        row = lambda x: x.flatten(2).transpose(1, 2)
        return self.shading(guess, row(geometry[:, 3:]), row(geometry[:, :3])).transpose(1, 2).unflatten(2, geometry.shape[-2:])

    def pictures(self, rooms, room):
        """Where the lights are on the photo, and the direct light of all of them."""
        x = self.inputs(rooms, room)
        guess = self(**x)
        rows = self.chosen(rooms, room)
        got = self.cast(dict(zip(self.outputs, guess)), x["geometry"]).sum(0) if rows else 0 * x["photo"][0]
        want = sum(relight(rooms, room, row, {})["shading"] for row in rows) if rows else got
        scale = 0.5 / max(float(want.mean()), 1e-3)
        planes = {"photo": x["photo"][0], "own": x["lights"][:, 1:].amax(0).expand(3, -1, -1), "network E_j": got * scale, "truth": want * scale}
        return rooms.names[room], {k: v.numpy() for k, v in planes.items()}


class Lamp(Lights):
    outputs = ["centre", "axes", "radiance", "confidence"]

    @staticmethod
    def made(center, axes, numbers, seen):
        """What `light` gives, from the 3 numbers of what the lamp sends."""
        a, b, c = axes.norm(dim=2).unbind(1)
        shown = 2 * (a * b + b * c + c * a)  # a quarter of the box's surface, the mean over directions
        radiance = strength(numbers) * seen.alone * (4 * spread(center, seen.unit) / shown[:, None])
        return {"centre": center, "axes": axes, "radiance": radiance[:, None]}

    def shading(self, guess, points, normals):
        return emit.box(guess["centre"], guess["axes"], points, normals)[..., None] * guess["radiance"]

    def surface(self, guess):
        """24 points on the box."""
        k = torch.tensor([[a, b, c] for a in (-1, 1) for b in (-0.5, 0.5) for c in (-0.5, 0.5)])
        k = torch.cat([k, k.roll(1, 1), k.roll(2, 1)])
        return guess["centre"][:, None] + torch.einsum("na,bac->bnc", k, guess["axes"])

    def form_loss(self, guess, form):
        volume = lambda axes: 8 * axes.norm(dim=2).prod(1)
        small = (torch.log(volume(guess["axes"]) + 1e-3) - torch.log(volume(form[:, 3:12].unflatten(1, (3, 3))) + 1e-3)).abs()
        return 0.05 * small

    @staticmethod
    def middle(forms, starts):
        return {
            "offset": (forms[:, :3] - starts[:, :3]).mean(0),
            "half": forms[:, 3:12].unflatten(1, (3, 3)).norm(dim=2).mean(0),
            "radiance": torch.expm1(torch.log1p(forms[:, 33:]).mean(0)),
        }

    def mean_guess(self, mean, start):
        b = len(start)
        return start[:, :3] + mean["offset"], torch.diag(mean["half"]).expand(b, 3, 3), mean["radiance"].expand(b, 1, 3)


class Window(Lights):
    window = True
    outputs = ["centre", "half_x", "half_y", "directions", "bandwidths", "radiance", "confidence"]

    def shading(self, guess, points, normals):
        lobes = emit.window(*(guess[k] for k in self.outputs[:5]), points, normals)
        return torch.einsum("blp,blc->bpc", lobes, guess["radiance"])

    def surface(self, guess):
        """36 points on the pane."""
        k = torch.linspace(-5 / 6, 5 / 6, 6)
        u, v = (t.reshape(1, -1, 1) for t in torch.meshgrid(k, k, indexing="ij"))
        return guess["centre"][:, None] + u * guess["half_x"][:, None] + v * guess["half_y"][:, None]

    @staticmethod
    def made(center, out, tilt, half, numbers, seen):
        """What `light` gives, from half extents [B, 2] and the 21 numbers of the lobes. What sky and ground give falls off with
        distance, what the sun gives does not."""
        x, up = frame(out, tilt)
        directions, bandwidths, sent = lobes(numbers, out, F.normalize(center - seen.spot, dim=1, eps=1e-6))
        wide = (seen.alone * spread(center, seen.unit) / half.prod(1, keepdim=True))[:, None]
        radiance = sent * torch.cat([seen.glare[:, None] / 2, wide, wide], 1) * (1 + bandwidths)[..., None]
        return {
            "centre": center,
            "half_x": x * half[:, :1],
            "half_y": up * half[:, 1:],
            "directions": directions,
            "bandwidths": bandwidths,
            "radiance": radiance,
        }

    def form_loss(self, guess, form):
        x, y = form[:, 3:6], form[:, 6:9]
        lobes = form[:, 12:33].unflatten(1, (3, 7))
        cross = lambda a, b: torch.linalg.cross(a, b, dim=-1)
        mine, true = cross(guess["half_x"], guess["half_y"]), cross(x, y)
        turned = 1 - F.cosine_similarity(mine, true, dim=1)
        area = (torch.log(4 * mine.norm(dim=1) + 0.01) - torch.log(4 * true.norm(dim=1) + 0.01)).abs()
        weight = torch.tensor([1.0, 0.2, 0.2])
        there = (lobes[..., 3] > 0).float() * weight
        aim = there * (1 - (guess["directions"] * lobes[..., :3]).sum(2))
        width = 0.001 * weight * (lobes[..., 3] > 0) * (torch.log1p(guess["bandwidths"]) - torch.log1p(lobes[..., 3])) ** 2
        radiance = 0.001 * weight[:, None] * (torch.log1p(guess["radiance"]) - torch.log1p(lobes[..., 4:])) ** 2
        return turned + 0.2 * area + (aim + width).sum(1) + radiance.sum((1, 2))

    @staticmethod
    def middle(forms, starts):
        lobes = forms[:, 12:33].unflatten(1, (3, 7))
        burns = (lobes[..., 3] > 0).float()
        some = lambda v: (v * burns[..., None]).sum(0) / burns.sum(0)[:, None].clamp(min=1)
        inward = F.normalize(torch.linalg.cross(forms[:, 3:6], forms[:, 6:9], dim=1), dim=1).mean(0)
        return {
            "offset": (forms[:, :3] - starts[:, :3]).mean(0),
            "inward": inward,
            "half": torch.stack([forms[:, 3:6].norm(dim=1).mean(), forms[:, 6:9].norm(dim=1).mean()]),
            "directions": F.normalize(some(lobes[..., :3]), dim=1),
            "bandwidths": torch.exp(some(torch.log1p(lobes[..., 3:4]))[:, 0]) - 1,
            "radiance": torch.expm1(torch.log1p(lobes[..., 4:]).mean(0)),
        }

    def mean_guess(self, mean, start):
        b = len(start)
        out = F.normalize(start[:, :3], dim=1) if self.visible else F.normalize(-mean["inward"], dim=0).expand(b, 3)
        x, y = frame(out, torch.zeros(b, 3))
        return (
            start[:, :3] + mean["offset"],
            x * mean["half"][0],
            y * mean["half"][1],
            mean["directions"].expand(b, 3, 3),
            mean["bandwidths"].expand(b, 3),
            mean["radiance"].expand(b, 3, 3),
        )


def faces(geometry, shading, valid):
    """[B, FACES]: of the surfaces in each quarter of the picture that face right, up, towards us and the other ways: how much there is, its mean place
    and the logarithm of its mean shading by color. What comes from where."""
    normal, xyz = geometry[:, :3], geometry[:, 3:]
    weight = torch.cat([normal, -normal], 1).clamp(min=0) * valid
    mean = lambda x: F.avg_pool2d(x, (60, 80))
    much = mean(weight)
    weighed = lambda x: torch.cat([mean(weight * x[:, k : k + 1]) for k in range(3)], 1) / (much.repeat(1, 3, 1, 1) + 1e-3)
    return torch.cat([much, weighed(xyz), torch.log(weighed(shading) + 0.02)], 1).flatten(1)


def expected(y):
    """[B, 1]: the logarithm of the relative error that the head expects."""
    return torch.tanh(y[:, -1:] / 3) * 3


def share(y):
    """The sigmoid, to as many digits where it is next to nothing; runtimes differ there on their own."""
    return 1 / (1 + torch.exp(-y.clamp(-30, 30)))


def strength(y):
    """Light of any size from any number; 0 gives about 0.4."""
    return torch.tan(torch.pi / 2 * 0.9999 * share(y - 1))


def spread(center, unit):
    """Squared distance of a light from the middle of what is seen, [B, 1]. The head tells how much arrives there, as a share of what the photo shows,
    and not the radiance: that hangs less on how large and how far the light is taken to be."""
    middle = unit * center.new_tensor([0.0, 0.0, -3.0])
    return ((center - middle) ** 2).sum(1, keepdim=True) + unit**2


def frame(out, tilt):
    """half_x and half_y of unit length of a window that looks `out`; x cross y points into the room."""
    up = F.normalize(tilt + out.new_tensor([0.0, 1.0, 0.0]), dim=1)
    y = F.normalize(up - (up * out).sum(1, keepdim=True) * out, dim=1, eps=1e-6)
    return torch.linalg.cross(out, y, dim=1), y


def lobes(y, out, sun):
    """directions, bandwidths and radiances of sun, sky and ground from 21 numbers; `out` is where the window looks, `sun` where the brightest place
    sees it."""
    y = y.unflatten(1, (3, 7))
    up = out.new_tensor([0.0, 1.0, 0.0])
    first = torch.stack([sun, F.normalize(out + up, dim=1), F.normalize(out - up, dim=1)], 1)
    directions = F.normalize(2 * torch.tanh(y[..., :3]) + first, dim=2, eps=1e-6)
    low, high = y.new_tensor([0.9, 0.0, 0.0]), y.new_tensor([0.999999, 0.9999, 0.9999])
    bandwidths = torch.tan(torch.pi / 2 * (low + (high - low) * torch.sigmoid(y[..., 3])))
    return directions, bandwidths, strength(y[..., 4:] - y.new_tensor([2.0, 0.0, 0.0]).view(1, 3, 1))


def away(y, geometry_unit):
    """A place that is not seen, from 4 numbers: distance, angle from straight behind, and the two of the turn about the view."""
    distance = torch.exp(1 + torch.tanh(y[:, :1] / 2) * 2)
    theta = torch.pi * 0.95 * torch.sigmoid(y[:, 1:2])
    turn = F.normalize(y[:, 2:4] + y.new_tensor([0.0, 0.5]), dim=1, eps=1e-6)
    return geometry_unit * distance * torch.cat([torch.sin(theta) * turn, torch.cos(theta)], 1)


class VisLampNet(Lamp):
    """A visible lamp -> center [1, 3], half axes [1, 3, 3] (m), radiance [1, 1, 3], confidence [1, 2]. The center lies on the mean ray of its mask,
    up to 0.2 units before or behind its median depth; the box lies along the camera's axes."""

    visible = True

    def __init__(self):
        super().__init__(7)

    def light(self, y, seen, start):
        towards = F.normalize(start[:, :3], dim=1)
        half = torch.cat([start[:, 3:], start[:, 3:].amin(1, keepdim=True)], 1) * torch.exp(torch.tanh(y[:, 1:4])) + 1e-3
        center = start[:, :3] + 0.2 * torch.tanh(y[:, :1]) * towards * seen.unit
        return self.made(center, half[..., None] * torch.eye(3), y[:, 4:7], seen)


class VisWinNet(Window):
    """A visible window -> center [1, 3], half_x and half_y [1, 3] (m; their cross product points into the room), directions [1, 3, 3], bandwidths [1,
    3] and radiance [1, 3, 3] of sun, sky and ground, confidence [1, 2]."""

    visible = True

    def __init__(self):
        super().__init__(3 + 3 + 3 + 2 + 21)

    def light(self, y, seen, start):
        out = F.normalize(0.8 * torch.tanh(y[:, 3:6]) + F.normalize(start[:, :3], dim=1), dim=1, eps=1e-6)
        center, half = start[:, :3] + 0.5 * torch.tanh(y[:, :3]) * seen.unit, start[:, 3:] * torch.exp(torch.tanh(y[:, 9:11])) + 1e-3
        return self.made(center, out, 0.8 * torch.tanh(y[:, 6:9]), half, y[:, 11:32], seen)


class InvLampNet(Lamp):
    """The invisible lamp -> center [1, 3], half axes [1, 3, 3] (m), radiance [1, 1, 3], confidence [1, 2]."""

    def __init__(self):
        super().__init__(4 + 3 + 3 + 3)

    def light(self, y, seen, start):
        a, b, c = (torch.pi * torch.tanh(y[:, 4:7] / 2)).unbind(1)
        zero, one = torch.zeros_like(a), torch.ones_like(a)
        about = lambda rows: torch.stack([torch.stack(r, 1) for r in rows], 1)
        turn = about([[c.cos(), -c.sin(), zero], [c.sin(), c.cos(), zero], [zero, zero, one]])
        turn = about([[one, zero, zero], [zero, b.cos(), -b.sin()], [zero, b.sin(), b.cos()]]) @ turn
        turn = about([[a.cos(), zero, a.sin()], [zero, one, zero], [-a.sin(), zero, a.cos()]]) @ turn
        half = torch.exp(-2 + torch.tanh(y[:, 7:10] / 2) * 2) * seen.unit
        return self.made(away(y[:, :4], seen.unit), turn * half[..., None], y[:, 10:13], seen)


class InvWinNet(Window):
    """The invisible window; outputs as VisWinNet's."""

    def __init__(self):
        super().__init__(4 + 3 + 3 + 2 + 21)

    def light(self, y, seen, start):
        center = away(y[:, :4], seen.unit)
        out = F.normalize(torch.tanh(y[:, 4:7]) + 0.5 * F.normalize(center, dim=1), dim=1, eps=1e-6)
        half = torch.exp(-0.5 + torch.tanh(y[:, 10:12] / 2) * 2) * seen.unit
        return self.made(center, out, 0.8 * torch.tanh(y[:, 7:10]), half, y[:, 12:33], seen)


def parts(paths):
    """{source: number of the path that it is in}, from names such as "window_0.sky+ground+lamp_1"."""
    out = {}
    for number, name in enumerate(paths):
        light = ""
        for token in name.split("+"):
            if token in form.LOBES:
                out[f"{light}.{token}"] = number
            else:
                light = token.split(".")[0]
                out[token] = number
    return out


def factors(rooms, room, g):
    """{path: factor [3]}: nothing for two items of five, else each path brighter, darker, tinted or off."""
    if torch.rand(1, generator=g) < 0.4:
        return {}
    paths = range(len(rooms.paths[room]))
    burns = torch.rand(len(paths), generator=g) > 0.2
    level = 0.8 * torch.randn(len(paths), 1, generator=g) + 0.15 * torch.randn(len(paths), 3, generator=g)
    return dict(zip(paths, torch.exp(level) * burns[:, None])) if burns.any() else {}


def relight(rooms, room, row, factor):
    """A room whose paths take these factors, and its light `row` (None: one that is not there): photo, masks, E_j of that light, all light, its form,
    points on it, whether it burns."""
    path = parts(rooms.paths[room])
    by = lambda number: torch.as_tensor(factor.get(number, 1.0)).expand(3)
    of = lambda source: by(path.get(source))
    photo, light = rooms.get("photo", room), rooms.get("light", room)[None]
    each = rooms.get("path_direct", room) + rooms.get("indirect", room)
    before = each.sum(0)
    after = sum(by(p).view(3, 1, 1) * e for p, e in enumerate(each))
    photo = photo * ((after + 1e-4) / (before + 1e-4)) if factor else photo
    names, own = rooms.lights[room], torch.zeros_like(light)
    for k, name in enumerate(names):
        if name.startswith("inv_") or not (factor or k == row):
            continue
        mask = rooms.get("own", room, k)[None]
        if factor:
            shine = torch.stack([of(s) for s in rooms.sources[room] if s.split(".")[0] == name]).amax(0)
            photo = torch.where(mask > 0, rooms.get("photo", room) * shine.view(3, 1, 1) + 0.02, photo)
        own = mask if k == row else own
    shading, numbers, surface = torch.zeros_like(photo), torch.zeros(36), torch.zeros(64, 3)
    if row is not None:
        numbers, surface = rooms.get("form", room, row).clone(), rooms.get("surface", room, row)
        radiance, direct = rooms.get("radiance", room), rooms.get("direct", room)
        for s, source in enumerate(rooms.sources[room]):
            name, _, lobe = source.partition(".")
            if name == names[row]:
                shading = shading + direct[s] * (of(source) * radiance[s])[:, None, None]
                first = 16 + 7 * form.LOBES.index(lobe) if lobe else 33
                numbers[first : first + 3] *= of(source)
    unseen = row is None or names[row].startswith("inv_")
    there = shading.mean() > (LEAST * after.mean() if unseen else 1e-4)
    if unseen and not there:
        surface = torch.zeros(64, 3)
    return {
        "photo": photo,
        "lights": torch.cat([light, own]),
        "shading": shading,
        "whole": after,
        "form": numbers,
        "surface": surface,
        "there": there.float(),
    }


def begin(geometry, lights, window):
    """Where a seen light is by mask and depth, [B, 5, 1, 1]: center and half extents across the view (m). Depth is the median over the mask, of a window
    over what surrounds the mask, two pixels wide: depth of a pane may be that of the view outside."""
    out = torch.zeros(len(lights), 5)
    ring = (F.max_pool2d(lights[:, 1:], 5, 1, 2)[:, 0] > 0) & (lights[:, 0] == 0)
    for k, (xyz, mask) in enumerate(zip(geometry[:, 3:], lights[:, 1] > 0)):
        if not mask.any():
            continue
        rays = (xyz / -xyz[2:])[:, mask]
        around = mask
        if window and ring[k].sum() >= 4:
            around = ring[k]
        depth = -xyz[2, around].median()
        out[k, :3] = rays.mean(1) * depth
        out[k, 3:] = (3 * rays[:2].var(1, correction=0)).sqrt() * depth + 0.01
    return out[..., None, None]


def pick(g, geometry, albedo, shading, lights, whole):
    """Means over cells, of which CHOSEN for each item: points and normals [B, P, 3], albedo, E_j, all light, and 1 where no light is seen."""
    cells = lambda v: F.avg_pool2d(v, CELL).flatten(2).transpose(1, 2)
    some = torch.randperm(cells(lights).shape[1], generator=g)[:CHOSEN]
    x = {
        k: cells(v)[:, some] for k, v in {"geometry": geometry, "albedo": albedo, "shading": shading, "lights": lights[:, :1], "whole": whole}.items()
    }
    out = {k: x[k] for k in ["albedo", "shading", "whole"]}
    return out | {"points": x["geometry"][..., 3:], "normals": F.normalize(x["geometry"][..., :3], dim=2), "valid": (x["lights"] < 0.01).float()}


def chamfer(a, b):
    """Both ways between [B, N, 3] and [B, M, 3], m."""
    d = torch.sqrt(((a[:, :, None] - b[:, None]) ** 2).sum(3) + 1e-6)
    return d.amin(2).mean(1) + d.amin(1).mean(1)


def scaled(form, gain):
    """Forms [B, 36] with radiances times `gain` [B, 3, 1, 1]."""
    gain = gain[:, :, 0, 0]
    one = torch.ones(len(form), 4)
    return form * torch.cat([torch.ones(len(form), 12), *[torch.cat([one, gain], 1)] * 3, gain], 1)


def mirrored_form(form):
    """Of the horizontally mirrored room; half_x turns round as well, so that x cross y still points into the room."""
    sign = form.new_tensor([-1, 1, 1] + [1, -1, -1] + [-1, 1, 1] * 2 + [-1, 1, 1, 1, 1, 1, 1] * 3 + [1, 1, 1])
    return form * sign
