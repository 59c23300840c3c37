//! Lights proposed from a photo.

use glam::Vec3;

use super::LightKind;
use super::evidence::white_level;
use crate::image::{Mask, Normal, Picture, Plane, Points, distance, grid_cut, luminance};
use crate::geometry::world_up;

pub struct Finder {
    pub threshold: f32,
    pub smoothness: f32,
    pub smallest: f32,
    pub most: usize,
}

pub struct Found {
    pub kind: LightKind,
    pub mask: Mask,
    pub why: String,
}

pub fn brightness(photo: &Picture, clipped: &Mask) -> Option<Plane<f32>> {
    let pixels = photo.0.pixels().iter().zip(clipped.0.pixels());
    let white = white_level(pixels.map(|(&p, &c)| (p, c > 0.5)));
    (white > 0.0).then(|| photo.0.map(|p| luminance(p).max(p.z) / white))
}

fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

pub fn find_lights(photo: &Picture, clipped: &Mask, room: Option<(&Points, &Normal)>, finder: &Finder) -> Vec<Found> {
    let Some(bright) = brightness(photo, clipped) else { return Vec::new() };
    let (w, h) = bright.size();
    let gain = bright.map(|b| (1000.0 * ((b.max(1e-6) / finder.threshold).ln() / -finder.threshold.ln()).clamp(-1.0, 1.0)) as i32);
    let shown = {
        let pixels = photo.0.pixels().iter().zip(clipped.0.pixels());
        let white = white_level(pixels.map(|(&p, &c)| (p, c > 0.5)));
        photo.0.map(|p| { let q = (p / white).clamp(Vec3::ZERO, Vec3::ONE); Vec3::new(q.x.sqrt(), q.y.sqrt(), q.z.sqrt()) })
    };
    let (mut sum, mut count) = (0.0f64, 0.0f64);
    for y in 0..h { for x in 0..w {
        for (nx, ny) in [(x + 1, y), (x, y + 1)] { if nx < w && ny < h {
            sum += f64::from(shown.get(x, y).distance_squared(shown.get(nx, ny))); count += 1.0; } }
    } }
    let beta = (count / (2.0 * sum.max(1e-9))) as f32;
    let weight = |x: usize, y: usize, nx: usize, ny: usize| {
        let d2 = shown.get(x, y).distance_squared(shown.get(nx, ny));
        let far = if x == nx || y == ny { 1.0 } else { std::f32::consts::SQRT_2 };
        (1000.0 * finder.smoothness * (-beta * d2).exp() / far) as i32
    };
    let label = grid_cut(&gain, weight);
    let mut comp = Plane::filled(w, h, 0usize);
    let mut parts: Vec<Vec<usize>> = Vec::new();
    for i in 0..w * h {
        if !label.pixels()[i] || comp.pixels()[i] > 0 { continue; }
        parts.push(Vec::new());
        let id = parts.len();
        comp.pixels_mut()[i] = id;
        let mut front = vec![i];
        while let Some(i) = front.pop() {
            parts[id - 1].push(i);
            let (cx, cy) = (i % w, i / w);
            for ny in cy.saturating_sub(1)..(cy + 2).min(h) { for nx in cx.saturating_sub(1)..(cx + 2).min(w) {
                if label.get(nx, ny) && comp.get(nx, ny) == 0 { comp.set(nx, ny, id); front.push(ny * w + nx); }
            } }
        }
    }
    let up = room.map(|(_, normal)| world_up(normal));
    let mut found = Vec::new();
    for (id, part) in parts.iter().enumerate() {
        if (part.len() as f32) < finder.smallest * (w * h) as f32 { continue; }
        let core = comp.map(|c| c == id + 1);
        let away = distance(&core);
        let into = distance(&core.map(|c| !c));
        let pick = |test: &dyn Fn(usize) -> bool| (0..w * h).filter(|&i| test(i)).collect::<Vec<_>>();
        let ring = pick(&|i| !label.pixels()[i] && away.pixels()[i] > 1.5 && away.pixels()[i] <= 4.0);
        let rim = pick(&|i| core.pixels()[i] && into.pixels()[i] > 1.0 && into.pixels()[i] <= 3.5);
        let level = |pixels: &[usize]| median(&mut pixels.iter().map(|&i| bright.pixels()[i].min(1.0)).collect::<Vec<_>>()).unwrap_or(0.0);
        let step = (level(&rim).max(0.004) / level(&ring).max(0.004)).ln();
        let mut ringv: Vec<f32> = ring.iter().map(|&i| bright.pixels()[i].min(1.0)).collect();
        ringv.sort_by(f32::total_cmp);
        let q75 = ringv.get(ringv.len() * 3 / 4).copied().unwrap_or(0.0);
        let sat = part.iter().filter(|&&i| bright.pixels()[i] > 0.95).count() as f32 / part.len() as f32;
        let (x0, x1) = part.iter().fold((w, 0), |(a, b), &i| (a.min(i % w), b.max(i % w)));
        let (y0, y1) = part.iter().fold((h, 0), |(a, b), &i| (a.min(i / w), b.max(i / w)));
        let fill = part.len() as f32 / ((x1 - x0 + 1) * (y1 - y0 + 1)) as f32;
        let hue = |pixels: &[usize]| median(&mut pixels.iter().map(|&i| { let p = photo.0.pixels()[i]; ((p.z + 1e-3) / (p.x + 1e-3)).ln() }).collect::<Vec<_>>()).unwrap_or(0.0);
        let (mut dz, mut nu) = (0.0, 0.0);
        if let (Some((points, normal)), Some(up)) = (room, up) {
            let z = |pixels: &[usize]| median(&mut pixels.iter().map(|&i| -points.0.pixels()[i].z).collect::<Vec<_>>()).unwrap_or(1.0);
            dz = (z(part) / z(&ring)).ln();
            nu = median(&mut part.iter().map(|&i| normal.0.pixels()[i].dot(up)).collect::<Vec<_>>()).unwrap_or(0.0);
        }
        let border = [x0 == 0, x1 == w - 1, y0 == 0, y1 == h - 1].iter().filter(|b| **b).count();
        let why = format!("at ({x0}..{x1}, {y0}..{y1}) area {} step {step:.2} q75 {q75:.2} sat {sat:.2} fill {fill:.2} border {border} hue {:.2} hue_ring {:.2} dz {dz:.3} up {nu:.2}", part.len(), hue(part), hue(&ring));
        found.push(Found { kind: LightKind::Lamp, mask: Mask(core.map(|c| if c { 1.0 } else { 0.0 })), why });
    }
    found
}
