//! `FillReflectance`: reflectance of the surface, also where a light hides it.

mod exemplar;

use std::sync::Arc;

use glam::{BVec3, FloatExt, Vec3};
use rayon::prelude::*;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, GlareMask, Mask, Normal, Picture, Plane, Points, REFLECTANCE, RELIT_PIXEL, Shading,
    clip_level, glare_of, inpaint_surfaces, limited, luminance, reflected, resize, smooth_step,
};
use crate::nodes::artifacts::{ScatteredLight, ShadingGain};
use crate::optics::LightKind;
use crate::tuning::tuning;
use crate::{params, ports};

pub use exemplar::ExemplarTuning;
use exemplar::inpaint_with_texture;

params! {
    /// Marks the pixels of each visible light and its glare, and estimates the reflectance of the
    /// surface, also under lights and saturation.
    ///
    /// Reflectance is photo over shading. Pixels that a light or saturation hides are filled in
    /// from the surroundings without a visible edge (Poisson's equation in logarithms), with the
    /// edges that unsaturated channels show, and with texture that is copied from the same surface.
    /// No edit of a light changes the result.
    pub struct FillReflectance {
        /// Least width of the bloom around a visible light, as a fraction of the photo's longer
        /// side. Within it, residual light belongs to the light. A lamp's bloom is at least half as
        /// wide as the lamp.
        bloom: f32 = 0.01, in 0.0..=0.1,
    }
}

ports! {
    pub input FillReflectanceIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Points of the seen surface, working size.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Shading by each estimated light, working size.
        light: Gather<Shading>,
        /// Factor of the shading by each visible light; empty where it is 1.
        shading_gain: Gather<ShadingGain>,
        /// Residual shading, which no light explains, working size.
        residual: Arc<Shading>,
        /// Light of visible lights that the lens scatters, working size: it is not the surface's.
        glare: Gather<ScatteredLight>,
        /// Pixels of each visible light, photo size.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
    }
}

ports! {
    pub output FillReflectanceOut {
        /// Photo over shading, 0..=4, working size: above 1, the shading is too low.
        reflectance: Arc<Albedo>,
        /// The light of saturated pixels as it was before saturation, in the units of the photo,
        /// working size; that of the photo elsewhere.
        unsaturated: Arc<Picture>,
        /// The own pixels of each visible light and its glare, photo size.
        glare_mask: Scatter<GlareMask>,
        /// Fraction of each pixel whose surface a light, its glare or saturation hides, 0..=1,
        /// working size: there the reflectance is filled in.
        filled: Arc<Mask>,
    }
}

impl Node for FillReflectance {
    const KIND: &'static str = "FillReflectance";
    const VERSION: u32 = 20;
    type In = FillReflectanceIn;
    type Out = FillReflectanceOut;

    fn run(
        &self,
        mut inputs: FillReflectanceIn,
        _: &Context,
    ) -> Result<FillReflectanceOut, NodeError> {
        inputs.light = ShadingGain::scaled(&inputs.light, &inputs.shading_gain, |_| true)?;
        let (full_w, full_h) = inputs.photo.0.size();
        let bloom = self.bloom * full_w.max(full_h) as f32;
        let mut lights = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let kind = inputs.kind.get(id).ok_or_else(|| {
                NodeError::Failed(format!("visible light {id:?} is neither lamp nor window"))
            })?;
            lights.push((id, mask, **kind));
        }
        let glare_masks = lights.into_par_iter().map(|(id, mask, kind)| {
            let pixels = match kind {
                LightKind::Lamp => GlareMask::of_lamp,
                LightKind::Window => GlareMask::of_window,
            };
            let glare_mask = pixels(&mask.0, &inputs.photo, &inputs.clipped, bloom);
            (id.to_owned(), Arc::new(glare_mask))
        });
        let glare_masks: Vec<(String, Arc<GlareMask>)> = glare_masks.collect();
        let (w, h) = inputs.small.0.size();
        let white = clip_level(&inputs.photo, &inputs.clipped);
        let filled = filled(&inputs.photo, white, &glare_masks);
        let bright = REFLECTANCE.saturation[0] * white;
        let mut hidden = inputs.small.0.map(|shown| shown.max_element() > bright);
        let mut own = Plane::filled(w, h, false);
        for (_, glare_mask) in &glare_masks {
            for i in glare_mask.pixels() {
                let at = (i % full_w * w / full_w, i / full_w * h / full_h);
                hidden.set(at.0, at.1, true);
                if glare_mask.coverage(i) > 0.0 {
                    own.set(at.0, at.1, true);
                }
            }
        }
        let shading = |i: usize| {
            let lights = inputs.light.iter().map(|(_, light)| light.0.pixels()[i]);
            lights.sum::<Vec3>() + inputs.residual.0.pixels()[i]
        };
        let reflectance = |i: usize| {
            let glare = inputs.glare.iter().map(|(_, light)| light.glare.pixels()[i]);
            let shown = inputs.small.0.pixels()[i].max(Vec3::ZERO);
            reflected(shown - glare_of(shown, glare.sum()), shading(i))
        };
        // In logarithms a step is a ratio, and no filling is negative.
        let log = |i: usize| reflectance(i).max(Vec3::splat(TUNING.min_reflectance)).map(f32::ln);
        let mut paint = Plane::new(w, h, (0..w * h).map(log).collect());
        let mean = inputs.small.0.pixels().iter().map(|shown| luminance(*shown)).sum::<f32>();
        let noise = TUNING.noise * mean / (w * h).max(1) as f32 + REFLECTANCE.dark;
        let is_own = |i: usize| own.pixels()[i];
        let edges = |i, j| match is_own(i) || is_own(j) {
            true => (Vec3::ZERO, 1.0),
            false => edge(&inputs.small, [noise, white], i, j),
        };
        let holes = (0..w * h).map(|i| hidden.pixels()[i] && !is_own(i)).collect();
        let parts = (&hidden, &Plane::new(w, h, holes));
        inpaint_with_texture(&mut paint, parts, (&inputs.points, &inputs.normal), edges);
        let fill = |i: usize| match hidden.pixels()[i] {
            false => reflectance(i),
            // e^10 is beyond the limit and finite.
            true => {
                limited(paint.pixels()[i].min(Vec3::splat(10.0)).map(f32::exp), REFLECTANCE.excess)
            }
        };
        let paint = Plane::new(w, h, (0..w * h).map(fill).collect());
        let unsaturated = unsaturated(&inputs, white, is_own, shading);
        Ok(FillReflectanceOut {
            reflectance: Arc::new(Albedo(paint)),
            unsaturated: Arc::new(Picture(unsaturated)),
            glare_mask: Scatter(glare_masks),
            filled: Arc::new(Mask(resize(&filled, w, h))),
        })
    }
}

/// The light of saturated pixels before saturation, by Poisson's equation in logarithms with the
/// photo around on the boundary. Saturated channels change as those that are not, and where none is
/// left, with the [`slopes`] continued from around; none is darker than the photo.
fn unsaturated(
    inputs: &FillReflectanceIn,
    white: f32,
    is_own: impl Fn(usize) -> bool + Sync,
    shading: impl Fn(usize) -> Vec3 + Sync,
) -> Plane<Vec3> {
    let photo = &inputs.small.0;
    let width = photo.width();
    let level = Vec3::splat(RELIT_PIXEL.shoulder[0] * white);
    let is_saturated = |i: usize| photo.pixels()[i].cmpge(level);
    if (0..photo.len()).all(|i| is_own(i) || !is_saturated(i).any()) {
        return photo.map(|shown| shown.max(Vec3::ZERO));
    }
    let unknown = |i: usize| is_saturated(i) | BVec3::splat(is_own(i));
    let unknown = Plane::new(width, photo.height(), (0..photo.len()).map(unknown).collect());
    let floor = Vec3::splat(TUNING.min_light * white);
    let log = |shown: Vec3| (shown.max(Vec3::ZERO) + floor).map(f32::ln);
    let logs = photo.map(log);
    // The channels that are left in both of two pixels, and their steps from one to the other.
    let step = |i: usize, j: usize| {
        let (a, b) = (photo.pixels()[i], photo.pixels()[j]);
        let left = Vec3::select(a.max(b).cmplt(level), Vec3::ONE, Vec3::ZERO);
        (left, logs.pixels()[i] - logs.pixels()[j])
    };
    let slopes = slopes((&inputs.points, &inputs.normal), |i, j| {
        let (left, step) = step(i, j);
        let is_known = left != Vec3::ZERO && !is_own(i) && !is_own(j);
        is_known.then(|| step.dot(left) / left.element_sum())
    });
    let fading = fading(&logs, (&inputs.points, &inputs.normal), &unknown);
    let link = |i: usize, j: usize| {
        let slope = 0.5 * (slopes.pixels()[i] + slopes.pixels()[j]);
        let away = |a: usize, b: usize| a as f32 - b as f32;
        // One step for all channels: white keeps the hue around it.
        let continued = slope.x * away(i % width, j % width) + slope.y * away(i / width, j / width);
        let continued = Vec3::splat(continued);
        if is_own(i) || is_own(j) {
            return (continued, TUNING.across);
        }
        let (left, step) = step(i, j);
        if left == Vec3::ONE {
            return (step, 1.0);
        }
        let modeled = log(shading(i)) - log(shading(j));
        let hidden = match left == Vec3::ZERO {
            true => continued,
            false if left.element_sum() == 2.0 => {
                let lost = (Vec3::ONE - left).max_position();
                let share = 0.5 * (fading.pixels()[i] + fading.pixels()[j])[lost];
                Vec3::splat(step[(lost + 1) % 3].lerp(step[(lost + 2) % 3], share))
            }
            false => Vec3::splat(step.dot(left) / left.element_sum()),
        };
        let (a, b) = (photo.pixels()[i], photo.pixels()[j]);
        let (up, down) = (a.cmpge(level) & b.cmplt(level), b.cmpge(level) & a.cmplt(level));
        let is_white = left == Vec3::ZERO && up.any() != down.any();
        let hidden = risen(hidden, [step, modeled], up, is_white);
        let hidden = -risen(-hidden, [-step, -modeled], down, is_white);
        (Vec3::select(left.cmpgt(Vec3::ZERO), step, hidden), 1.0)
    };
    let mut light = logs.clone();
    inpaint_surfaces(&mut light, unknown, (&inputs.points, &inputs.normal), link);
    Plane::from_fn(width, photo.height(), |x, y| {
        let (shown, i) = (photo.get(x, y).max(Vec3::ZERO), y * width + x);
        if !is_saturated(i).any() && !is_own(i) {
            return shown;
        }
        let light = light.get(x, y).map(f32::exp) - floor;
        limited(light, TUNING.brightest * shown.max_element()).max(shown)
    })
}

/// For each channel the weight of the channel after the next one in its change, beside that of the
/// next one, by the colors around `unknown` pixels, of which `logs` are the logarithms.
///
/// A color that fades towards white keeps the ratio of the differences of its logarithms. With this
/// ratio (c - p) / (q - p) of the surroundings as the weight k, the change of a saturated channel c
/// is (1 - k) times that of p plus k times that of q. Where p and q are alike, k is one half.
fn fading(logs: &Plane<Vec3>, surfaces: (&Points, &Normal), unknown: &Plane<BVec3>) -> Plane<Vec3> {
    let mut weights = logs.map(|log| {
        let weight = |c: usize| {
            let [c, p, q] = [log[c], log[(c + 1) % 3], log[(c + 2) % 3]];
            let alike = TUNING.alike * TUNING.alike;
            let weight = ((c - p) * (q - p) + 0.5 * alike) / ((q - p) * (q - p) + alike);
            weight.clamp(TUNING.fading[0], TUNING.fading[1])
        };
        Vec3::new(weight(0), weight(1), weight(2))
    });
    let unknown = unknown.map(|unknown| BVec3::splat(unknown.any()));
    inpaint_surfaces(&mut weights, unknown, surfaces, |_, _| (Vec3::ZERO, 1.0));
    weights
}

/// Slopes of a light along both axes of a picture, in logarithms per pixel, which are harmonic
/// where the photo does not show them.
///
/// `step(i, j)` is the logarithm of the light of pixel `i` over that of pixel `j`, if the photo
/// shows it. A halo with the slope s at its edge of radius R becomes a dome, which has no kink at
/// this edge and rises by s R / 2 to its center. An edge of the surface has no slope.
fn slopes(surfaces: (&Points, &Normal), step: impl Fn(usize, usize) -> Option<f32>) -> Plane<Vec3> {
    let (w, h) = surfaces.0.0.size();
    let slope = |i: usize, j: usize| {
        let [from, to] = TUNING.edge;
        let step = step(i, j)?;
        Some(0.5 * step * (1.0 - smooth_step(from, to, step.abs())))
    };
    let mut unknown = Plane::filled(w, h, BVec3::FALSE);
    let mut slopes = Plane::from_fn(w, h, |x, y| {
        // At the ends of a row or column half of the slope.
        let right = slope(y * w + (x + 1).min(w - 1), y * w + x.saturating_sub(1));
        let down = slope((y + 1).min(h - 1) * w + x, y.saturating_sub(1) * w + x);
        unknown.set(x, y, BVec3::new(right.is_none(), down.is_none(), false));
        Vec3::new(right.unwrap_or(0.0), down.unwrap_or(0.0), 0.0)
    });
    inpaint_surfaces(&mut slopes, unknown, surfaces, |_, _| (Vec3::ZERO, 1.0));
    slopes
}

/// The wanted step into a pixel in which the channels `into` saturate: at least what the photo
/// shows of it and the lights' shading. Where that makes the pixel white without an edge, the
/// other channels rise as much: the last one to saturate shows how the light rises.
fn risen(wanted: Vec3, [step, modeled]: [Vec3; 2], into: BVec3, is_white: bool) -> Vec3 {
    let most = Vec3::select(into, step, Vec3::ZERO).max_element();
    let [from, to] = TUNING.edge;
    let falloff = if is_white { most * (1.0 - smooth_step(from, to, most)) } else { 0.0 };
    let wanted = if falloff > 0.0 { wanted.max(Vec3::splat(falloff)) } else { wanted };
    Vec3::select(into, wanted.max(step).max(modeled), wanted)
}

/// Logarithm of the reflectance of pixel `i` over that of its neighbor `j`, as the photo shows it:
/// that of their colors where it is an edge, zero where it may be light (Land and McCann 1971). A
/// saturated channel follows those that are not; white tells no step. The weight is less the more
/// of an edge it is: what lies on one side tells little of the other. `noise` is added to both,
/// `white` is the level at which the photo is clipped.
fn edge(photo: &Picture, [noise, white]: [f32; 2], i: usize, j: usize) -> (Vec3, f32) {
    let (a, b) = (photo.0.pixels()[i], photo.0.pixels()[j]);
    let noise = Vec3::splat(noise);
    let step = ((a + noise) / (b + noise)).map(f32::ln);
    let is_left = a.max(b).cmplt(Vec3::splat(REFLECTANCE.saturation[0] * white));
    let left = Vec3::select(is_left, Vec3::ONE, Vec3::ZERO);
    let told = if left == Vec3::ZERO { Vec3::ONE } else { left };
    let mean = step.dot(told) / told.element_sum();
    let [from, to] = TUNING.edge;
    let share = smooth_step(from, to, mean.abs());
    let step = if is_left.all() { step } else { Vec3::splat(mean) * left.max_element() };
    (share * step, 1.0 - share + share * TUNING.across)
}

tuning! {
    /// Constants of the filling of reflectance.
    pub const TUNING: FillReflectanceTuning {
        /// Difference of neighbors in logarithms, from which on it is an edge of the surface, and
        /// at which all of it is.
        edge: [f32; 2] = [0.3, 0.6],
            unit "1", source Taste, effect "smaller values take the falloff of a lamp for texture";
        /// Weight of such an edge beside that of neighbors without one.
        across: f32 = 0.01,
            unit "1", source Measured("lamps of real photos that are off; by eye"),
            effect "a larger value lets the color of one surface spread over another";
        /// Part of the photo's mean that is added to both sides of a ratio of neighbors.
        noise: f32 = 0.05,
            unit "1", source Taste, effect "a smaller value takes noise for texture";
        /// Light that is added to the photo before its logarithm, over white.
        min_light: f32 = 0.01,
            unit "1", source Taste, effect "a smaller value takes noise in a dark channel for light";
        /// Difference of the logarithms of two channels below which they are alike.
        alike: f32 = 0.1,
            unit "1", source Taste,
            effect "a smaller value takes noise for the way in which a color fades to white";
        /// Range of the weight of a channel in the change of a saturated one.
        fading: [f32; 2] = [-1.0, 1.0],
            unit "1", source Measured("lamps of real photos dimmed to 0.3; by eye"),
            effect "a wider range amplifies the noise of the channels that are left";
        /// Largest light of a saturated pixel over the photo, in the largest channel: three stops.
        brightest: f32 = 8.0,
            unit "1", source Taste, effect "a larger value keeps a dimmed lamp's surroundings white";
        /// Least reflectance that is filled in.
        min_reflectance: f32 = 0.001,
            unit "reflectance", source Derived("logarithms"), effect "none above the noise of photos";
    }
}

/// Fraction of each pixel of the photo that does not show its surface: a light's own, in its glare,
/// or saturated in all channels.
fn filled(photo: &Picture, white: f32, lights: &[(String, Arc<GlareMask>)]) -> Plane<f32> {
    let [from, to] = REFLECTANCE.saturation.map(|level| level * white);
    let (width, height) = photo.0.size();
    let share = |i: usize| {
        let lights = lights.iter().map(|(_, light)| light.weight(i));
        lights.fold(smooth_step(from, to, photo.0.pixels()[i].min_element()), f32::max)
    };
    Plane::new(width, height, (0..width * height).into_par_iter().map(share).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_light_or_saturation_hides_is_filled() {
        let colors = [Vec3::ONE, Vec3::X, Vec3::splat(0.5), Vec3::new(0.2, 0.1, 0.6)];
        let photo = Picture(Plane::from_fn(40, 9, |x, _| colors[x / 10]));
        let own = Plane::from_fn(40, 9, |x, _| if x < 30 { 0.0 } else { 1.0 });
        let none = Mask(own.map(|_| 0.0));
        let mask = GlareMask::of_window(&own, &photo, &none, 1e-3);
        let light = ("lamp".to_owned(), Arc::new(mask));
        let filled = filled(&photo, 1.0, &[light]);
        assert_eq!([5, 15, 25, 35].map(|x| filled.get(x, 4)), [1.0, 0.0, 0.0, 1.0]);
    }

    /// A wall of which the light falls off from the left, in a photo that is clipped at 1.
    fn wall(light: impl Fn(usize) -> Vec3, shading: impl Fn(usize) -> Vec3) -> FillReflectanceIn {
        let plane = |value: &dyn Fn(usize) -> Vec3| Plane::from_fn(40, 9, |x, _| value(x));
        let photo = Arc::new(Picture(plane(&|x| light(x).min(Vec3::ONE))));
        let clipped = photo.0.map(|shown| f32::from(u8::from(shown.max_element() >= 1.0)));
        FillReflectanceIn {
            photo: photo.clone(),
            clipped: Arc::new(Mask(clipped)),
            small: photo,
            points: Arc::new(Points(Plane::filled(40, 9, Vec3::NEG_Z))),
            normal: Arc::new(Normal(Plane::filled(40, 9, Vec3::Z))),
            light: Gather(vec![("lamp".to_owned(), Arc::new(Shading(plane(&shading))))]),
            shading_gain: Gather(vec![]),
            residual: Arc::new(Shading(plane(&|_| Vec3::ZERO))),
            glare: Gather(vec![]),
            mask: Gather(vec![]),
            kind: Gather(vec![]),
        }
    }

    /// The light before saturation that the stage gives.
    fn unsaturated(inputs: FillReflectanceIn) -> Arc<Picture> {
        let out = FillReflectance { bloom: 0.01 }.run(inputs, &Context::default());
        out.expect("all is there").unsaturated
    }

    /// The first `columns` of a [`wall`] get their `light` back, to a twentieth.
    fn assert_light_is_back(light: impl Fn(usize) -> Vec3, columns: usize) {
        let got = unsaturated(wall(&light, |_| Vec3::ONE));
        for x in 0..columns {
            let off = (got.0.get(x, 4) / light(x) - Vec3::ONE).abs().max_element();
            assert!(off < 0.05, "column {x}: {} for {}", got.0.get(x, 4), light(x));
        }
    }

    #[test]
    fn a_saturated_channel_changes_as_those_that_are_left() {
        // Red is above white in the first 20 columns, blue never is.
        let light = |x: usize| Vec3::new(1.0, 0.6, 0.2) * (-0.05 * x as f32).exp() * 2.7;
        assert_light_is_back(light, 40);
    }

    #[test]
    fn a_saturated_channel_fades_to_white_as_those_that_are_left() {
        // Red is in the shoulder from column 32 to the left, where the color fades to 0.4 of its
        // strength. The last column is white.
        let light = |x: usize| {
            let strength = if x < 33 { 0.4 + 0.6 * x as f32 / 33.0 } else { 1.0 };
            let color = (strength * Vec3::new(0.4, 0.0, -0.5)).map(f32::exp);
            if x == 39 { Vec3::ONE } else { 0.75 * (-0.01 * x as f32).exp() * color }
        };
        assert_light_is_back(light, 39);
    }

    #[test]
    fn a_saturated_halo_is_a_dome_and_white_paper_is_flat() {
        // The logarithm of the light is a paraboloid, whose slopes are linear, and so harmonic.
        let radius = |i: usize| (i % 41).abs_diff(20).pow(2) + (i / 41).abs_diff(20).pow(2);
        let light = |i: usize| Vec3::new(4.0, 3.0, 2.0) * (-0.005 * radius(i) as f32).exp();
        let run = |light: &dyn Fn(usize) -> Vec3| {
            let shown = Plane::from_fn(41, 41, |x, y| light(y * 41 + x).min(Vec3::ONE));
            let photo = Arc::new(Picture(shown));
            unsaturated(FillReflectanceIn {
                photo: photo.clone(),
                clipped: Arc::new(Mask(photo.0.map(|v| f32::from(u8::from(v.x >= 1.0))))),
                small: photo,
                points: Arc::new(Points(Plane::filled(41, 41, Vec3::NEG_Z))),
                normal: Arc::new(Normal(Plane::filled(41, 41, Vec3::Z))),
                residual: Arc::new(Shading(Plane::filled(41, 41, Vec3::ONE))),
                light: Gather(vec![]),
                ..wall(|_| Vec3::ZERO, |_| Vec3::ZERO)
            })
        };
        let got = run(&light);
        for i in [20 * 41 + 20, 20 * 41 + 25, 28 * 41 + 20, 14 * 41 + 12] {
            let off = (got.0.pixels()[i] / light(i) - Vec3::ONE).abs().max_element();
            assert!(off < 0.1, "pixel {i}: {} for {}", got.0.pixels()[i], light(i));
        }
        let got = run(&|i| Vec3::splat(if radius(i) < 100 { 1.0 } else { 0.3 }));
        assert!((got.0.get(20, 20) - Vec3::ONE).abs().max_element() < 0.01);
    }

    #[test]
    fn white_has_the_hue_around_it() {
        // Blue is the last channel to saturate, in column 15.
        let light = |x: usize| Vec3::new(1.0, 0.7, 0.3) * (0.12 * (25.0 - x as f32)).exp();
        let got = unsaturated(wall(light, |_| Vec3::ONE));
        assert!(light(15).z < 1.0 && light(14).z > 1.0);
        for x in 0..25 {
            let shown = got.0.get(x, 4);
            let hue = shown / shown.element_sum() * 2.0;
            assert!((hue - Vec3::new(1.0, 0.7, 0.3)).abs().max_element() < 0.06, "{x}: {hue}");
        }
        // Beyond an edge, white paper on a brown table stays white.
        let paper = |x: usize| if x < 20 { Vec3::splat(1.5) } else { Vec3::new(0.3, 0.2, 0.1) };
        let shown = unsaturated(wall(paper, |_| Vec3::ONE)).0.get(18, 4);
        assert!(shown.max_element() < 1.05 * shown.min_element(), "{shown}");
    }

    #[test]
    fn a_photo_with_negative_values_has_a_finite_light() {
        let light = |x: usize| Vec3::new(if x < 20 { 2.0 } else { -0.5 }, 0.3, -0.1);
        let got = unsaturated(wall(light, |_| Vec3::ONE));
        assert!(got.0.pixels().iter().all(|light| light.is_finite() && light.min_element() >= 0.0));
    }

    #[test]
    fn an_edge_is_of_the_surface_and_a_falloff_of_the_light() {
        let colors = [
            Vec3::new(0.4, 0.3, 0.2),
            Vec3::new(0.38, 0.29, 0.19),
            Vec3::new(0.08, 0.03, 0.02),
            Vec3::new(1.0, 0.4, 0.3),
            Vec3::ONE,
        ];
        let photo = Picture(Plane::from_fn(5, 1, |x, _| colors[x]));
        let ln = |a: f32, b: f32| ((a + 0.01) / (b + 0.01)).ln();
        let edge = |i, j| super::edge(&photo, [0.01, 1.0], i, j);
        assert_eq!(edge(0, 1), (Vec3::ZERO, 1.0), "5 % are light");
        let want = Vec3::new(ln(0.4, 0.08), ln(0.3, 0.03), ln(0.2, 0.02));
        assert!((edge(0, 2).0 - want).abs().max_element() < 1e-5);
        assert_eq!(edge(2, 0), (-edge(0, 2).0, TUNING.across));
        // Saturated red follows green and blue.
        let want = (ln(0.4, 0.03) + ln(0.3, 0.02)) / 2.0;
        assert!((edge(3, 2).0 - Vec3::splat(want)).abs().max_element() < 1e-5);
        assert_eq!(edge(4, 2), (Vec3::ZERO, TUNING.across), "white tells no step");
    }
}
