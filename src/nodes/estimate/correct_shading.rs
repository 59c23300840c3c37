//! `CorrectShading`: shading by lamps in view, where their shapes do not predict it.

use std::sync::Arc;

use glam::{BVec3, Vec3};

use crate::geometry::Grid;
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Mask, Normal, Picture, Plane, Points, REFLECTANCE, Shading, clip_level, dilate, distance,
    geodesic_dilate, glare_of, inpaint, luminance, ratio, smooth_step,
};
use crate::nodes::artifacts::{ScatteredLight, ShadingGain, same_size};
use crate::optics::LightKind;
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Corrects the shading by visible lamps around them.
    ///
    /// A lamp is not the even ball or box of its estimate: its shade lets light out above and
    /// below, and a camera's tone curve brightens what is near white. Around the lamp, soft changes
    /// of photo over shading are therefore light of the lamp, and steps are paint (Retinex, Land
    /// and McCann 1971): Poisson's equation for the logarithm of the reflectance, of which only the
    /// steps are kept, with the reflectance further away on the boundary. The shading by the lamp
    /// is multiplied by what makes up the difference.
    pub struct CorrectShading {}
}

ports! {
    pub input CorrectShadingIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Pixels of each visible light, working size.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// Shading by each estimated light, working size.
        light: Gather<Shading>,
        /// Residual shading, which no light explains, working size.
        residual: Arc<Shading>,
        /// Light of visible lights that the lens scatters, working size.
        glare: Gather<ScatteredLight>,
    }
}

ports! {
    pub output CorrectShadingOut {
        /// Factor of the shading by each visible light, within `TUNING.gain`; empty for lights
        /// whose shading stays as it is.
        gain: Scatter<ShadingGain>,
    }
}

impl Node for CorrectShading {
    const KIND: &'static str = "CorrectShading";
    const VERSION: u32 = 1;
    type In = CorrectShadingIn;
    type Out = CorrectShadingOut;

    fn run(&self, inputs: CorrectShadingIn, _: &Context) -> Result<CorrectShadingOut, NodeError> {
        let size = inputs.photo.0.size();
        let planes = [
            ("clipped", inputs.clipped.0.size()),
            ("points", inputs.points.0.size()),
            ("normal", inputs.normal.0.size()),
            ("residual", inputs.residual.0.size()),
        ];
        let masks = inputs.mask.iter().map(|(id, mask)| (id, mask.0.size()));
        let lights = inputs.light.iter().map(|(id, light)| (id, light.0.size()));
        let glare = inputs.glare.iter().map(|(id, light)| (id, light.glare.size()));
        for (name, got) in planes.into_iter().chain(masks).chain(lights).chain(glare) {
            same_size(name, got, "photo", size)?;
        }
        let gains = match lamps(&inputs) {
            lamps if lamps.is_empty() => Vec::new(),
            lamps => gains(&inputs, &lamps),
        };
        let gain = |(id, _): (&str, _)| {
            let gain = gains.iter().find(|(lamp, _)| *lamp == id);
            let gain = gain.map_or_else(ShadingGain::none, |(_, gain)| gain.clone());
            (id.to_owned(), Arc::new(gain))
        };
        let gain = Scatter(inputs.mask.iter().map(gain).collect());
        Ok(CorrectShadingOut { gain })
    }
}

tuning! {
    /// Constants of `CorrectShading`.
    pub const TUNING: CorrectShadingTuning {
        /// Radius of the region in which the shading by a lamp is corrected, from the lamp and the
        /// saturated pixels that touch it, over the side of a square of their area.
        falloff_radius: f32 = 1.5,
            unit "1", source Measured("lamps of real photos that are off; by eye"),
            effect "a larger value takes more soft paint for light";
        /// Largest such radius over the photo's longer side.
        max_falloff_radius: f32 = 0.25,
            unit "1", source Taste, effect "a larger value corrects more around large lamps";
        /// Part of the radius up to which all soft changes are light.
        inner_radius: f32 = 0.5,
            unit "1", source Taste, effect "a larger value ends the region more abruptly";
        /// Side of the cells in which the reflectance is averaged.
        stride: usize = 2,
            unit "working pixels", source Derived("lowers noise to the half"),
            effect "a larger value blurs the gain";
        /// Step of the log reflectance between cells, from which on a part of it is paint, and from
        /// which on all of it is.
        edge: [f32; 2] = [0.06, 0.15],
            unit "1", source Measured("lamps of real photos that are off; by eye"),
            effect "larger values take faint texture for light";
        /// Weight of neighbors on two surfaces, beside that of neighbors on one.
        across: f32 = 0.002,
            unit "1", source Taste, effect "a larger value lets one surface correct another";
        /// Step of the photo's log luminance beside a hidden cell, from which on it is an edge of
        /// the surface, and at which all of it is.
        boundary: [f32; 2] = [0.3, 0.6],
            unit "1", source Taste, effect "larger values take what lies before a bright wall for the wall";
        /// Light that is added to the photo there, over the photo's mean.
        noise: f32 = 0.05,
            unit "1", source Taste, effect "a smaller value takes noise for edges";
        /// Cosine between normals at and below which neighbors lie on two surfaces.
        crease: f32 = 0.5,
            unit "1", source Taste, effect "a larger value needs smoother normals";
        /// Relative step of depth at which a neighbor weighs 1 / e.
        step: f32 = 0.05,
            unit "1", source Taste, effect "a smaller value needs smoother depth";
        /// Width of the band around lights that takes no part.
        margin: usize = 1,
            unit "working pixels", source Taste, effect "a larger value hides more bloom";
        /// Range of the ratio of the light to its estimate.
        ratio: [f32; 2] = [0.37, 3.3],
            unit "1", source Taste, effect "a wider range corrects larger errors, and more paint";
        /// Range of the factor of the shading by a lamp.
        gain: [f32; 2] = [0.1, 4.0],
            unit "1", source Taste, effect "a larger value lets a lamp explain light where it is weak";
    }
}

/// A visible lamp, with the degree 0..=1 to which soft changes of a pixel are its light.
struct Lamp<'a> {
    id: &'a str,
    weight: Plane<f32>,
    light: &'a Plane<Vec3>,
}

/// The visible lamps that light the room.
fn lamps(inputs: &CorrectShadingIn) -> Vec<Lamp<'_>> {
    let lamp = |(id, mask): (_, &'_ Arc<Mask>)| {
        let light = &inputs.light.get(id)?.0;
        let is_lamp = inputs.kind.get(id).is_some_and(|kind| **kind == LightKind::Lamp);
        if !is_lamp || light.pixels().iter().all(|&e| e == Vec3::ZERO) {
            return None;
        }
        let core = geodesic_dilate(&mask.0, &inputs.clipped.0);
        let (w, h) = core.size();
        let area = core.pixels().iter().filter(|inside| **inside).count();
        let radius = TUNING.falloff_radius * (area as f32).sqrt();
        let radius = radius.min(TUNING.max_falloff_radius * w.max(h) as f32).max(1.0);
        let weight = distance(&core)
            .map(|away| 1.0 - smooth_step(TUNING.inner_radius * radius, radius, away));
        (area > 0).then_some(Lamp { id, weight, light })
    };
    inputs.mask.iter().filter_map(lamp).collect()
}

/// The gain of each lamp: all channels of the light change by one ratio, so that what is left
/// without the lamp keeps its hue.
fn gains<'a>(inputs: &CorrectShadingIn, lamps: &[Lamp<'a>]) -> Vec<(&'a str, ShadingGain)> {
    let (w, h) = inputs.photo.0.size();
    let shading = |i: usize| {
        let lights = inputs.light.iter().map(|(_, light)| light.0.pixels()[i]);
        lights.sum::<Vec3>() + inputs.residual.0.pixels()[i]
    };
    let shading: Vec<Vec3> = (0..w * h).map(shading).collect();
    let grid = Grid::new((w, h), TUNING.stride);
    let cells = cells(inputs, &shading);
    let ratio = correction(inputs, &grid, &cells, lamps);
    let ratio = grid.upsample(&inputs.points, &inputs.normal, &ratio);
    let [least, most] = TUNING.ratio.map(f32::ln);
    let missing = |i: usize| {
        let lamps = lamps.iter().map(|lamp| lamp.weight.pixels()[i] * lamp.light.pixels()[i]);
        let ratio = ratio.pixels()[i].clamp(least, most).exp();
        shading[i] * (ratio - 1.0) / (lamps.sum::<Vec3>() + REFLECTANCE.dark)
    };
    let missing: Vec<Vec3> = (0..w * h).map(missing).collect();
    let gain = |lamp: &Lamp<'a>| {
        let [least, most] = TUNING.gain.map(Vec3::splat);
        let factor =
            |(weight, missing): (&f32, &Vec3)| (Vec3::ONE + *missing * *weight).clamp(least, most);
        let factors = lamp.weight.pixels().iter().zip(&missing).map(factor).collect();
        (lamp.id, ShadingGain(Plane::new(w, h, factors)))
    };
    lamps.iter().map(gain).collect()
}

/// A cell of the working grid.
struct Cell {
    /// Logarithm of the luminance that the photo shows.
    shown: f32,
    /// Mean logarithm of the reflectance over the channels; `None` where a light or saturation
    /// hides it.
    reflectance: Option<f32>,
}

/// The cells of the grid.
fn cells(inputs: &CorrectShadingIn, shading: &[Vec3]) -> Vec<Cell> {
    let photo = &inputs.photo.0;
    let bright = REFLECTANCE.saturation[0] * clip_level(&inputs.photo, &inputs.clipped);
    let masks = inputs.mask.iter().map(|(_, mask)| &**mask);
    let own = dilate(masks, photo.size(), TUNING.margin);
    let shown = |i: usize| photo.pixels()[i].max(Vec3::ZERO);
    let mean = (0..photo.len()).map(|i| luminance(shown(i))).sum::<f32>();
    let noise = TUNING.noise * mean / photo.len().max(1) as f32 + REFLECTANCE.dark;
    let of_surface = |i: usize| {
        let glare = inputs.glare.iter().map(|(_, light)| light.glare.pixels()[i]).sum();
        shown(i) - glare_of(shown(i), glare)
    };
    let is_hidden = |i: usize| own.pixels()[i] || shown(i).max_element() > bright;
    let means = |value: &dyn Fn(usize) -> Vec3| {
        let pixels = (0..photo.len()).map(value).collect();
        Picture(Plane::new(photo.width(), photo.height(), pixels)).blocks(TUNING.stride).0
    };
    let hidden = means(&|i| Vec3::splat(f32::from(u8::from(is_hidden(i)))));
    let (color, surface) = (means(&shown), means(&of_surface));
    let shading = means(&|i| shading[i]);
    let least = Vec3::splat(super::TUNING.min_albedo);
    let cell = |i: usize| {
        let reflectance = ratio(surface.pixels()[i], shading.pixels()[i]).max(least);
        Cell {
            shown: (luminance(color.pixels()[i]) + noise).ln(),
            reflectance: (hidden.pixels()[i] == Vec3::ZERO)
                .then(|| reflectance.map(f32::ln).element_sum() / 3.0),
        }
    };
    (0..color.len()).map(cell).collect()
}

/// Logarithm of the light over its estimate, on the grid.
fn correction(inputs: &CorrectShadingIn, grid: &Grid, cells: &[Cell], lamps: &[Lamp]) -> Vec<f32> {
    let weight = |i: usize| {
        let weights = lamps.iter().map(|lamp| lamp.weight.pixels()[grid.pixel(i)]);
        weights.fold(0.0, f32::max)
    };
    let weights: Vec<f32> = (0..grid.len()).map(weight).collect();
    let surface = |i: usize, j: usize| {
        let [p, q] = [i, j].map(|i| grid.pixel(i));
        let normal = &inputs.normal.0.pixels();
        let smooth = (normal[p].dot(normal[q]) - TUNING.crease) / (1.0 - TUNING.crease);
        let [near, far] = [p, q].map(|p| -inputs.points.0.pixels()[p].z);
        let step = (near / far).ln() / TUNING.step;
        let [from, to] = TUNING.boundary;
        let boundary = match (cells[i].reflectance, cells[j].reflectance) {
            (Some(_), Some(_)) => 1.0,
            _ => 1.0 - smooth_step(from, to, (cells[i].shown - cells[j].shown).abs()),
        };
        (smooth * (-step * step).exp() * boundary).clamp(TUNING.across, 1.0)
    };
    let steps = |i: usize, j: usize| {
        let step = match (cells[i].reflectance, cells[j].reflectance) {
            (Some(a), Some(b)) => a - b,
            _ => 0.0,
        };
        let [from, to] = TUNING.edge;
        let soft = 1.0 - smooth_step(from, to, step.abs());
        (Vec3::X * step * (1.0 - soft * weights[i].min(weights[j])), surface(i, j))
    };
    let (columns, rows) = grid.size();
    // Values of one channel.
    let fill = |values: Vec<f32>,
                unknown: &dyn Fn(usize) -> bool,
                steps: &(dyn Fn(usize, usize) -> (Vec3, f32) + Sync)| {
        let mut plane = Plane::new(columns, rows, values).map(|value| Vec3::X * value);
        let unknown = (0..grid.len()).map(|i| BVec3::new(unknown(i), false, false)).collect();
        inpaint(&mut plane, Plane::new(columns, rows, unknown), steps);
        plane.map(|value| value.x)
    };
    let is_hidden = |i: usize| cells[i].reflectance.is_none();
    let known = cells.iter().map(|cell| cell.reflectance.unwrap_or_default()).collect();
    let paint = fill(known, &|i| is_hidden(i) || weights[i] > 0.0, &steps);
    let light = cells.iter().zip(paint.pixels());
    let light = light.map(|(cell, paint)| cell.reflectance.map_or(0.0, |log| log - paint));
    let light = fill(light.collect(), &is_hidden, &|i, j| (Vec3::ZERO, surface(i, j)));
    light.pixels().to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (120, 90);

    fn plane<T: Copy>(value: impl Fn(usize, usize) -> T) -> Plane<T> {
        Plane::from_fn(SIZE.0, SIZE.1, value)
    }

    /// Distance from the lamp, a disc of 12 pixels in the middle; negative within it.
    fn away(x: usize, y: usize) -> f32 {
        (x as f32 - 60.0).hypot(y as f32 - 45.0) - 12.0
    }

    /// A lamp before a wall whose light is `gain` times that of its estimate, beside even light of
    /// a fifth.
    fn wall(gain: impl Fn(f32) -> f32, paint: impl Fn(usize) -> Vec3) -> CorrectShadingIn {
        let lamp = |x, y| Vec3::new(1.0, 0.8, 0.5) / (1.0 + (away(x, y) / 20.0).powi(2));
        let other = Vec3::splat(0.2);
        let photo = plane(|x, y| match away(x, y) <= 0.0 {
            true => Vec3::splat(3.0),
            false => 0.4 * paint(x) * (lamp(x, y) * gain(away(x, y)) + other),
        });
        let own = Mask(plane(|x, y| f32::from(u8::from(away(x, y) <= 0.0))));
        let light = |id: &str, light| (id.to_owned(), Arc::new(Shading(light)));
        CorrectShadingIn {
            photo: Arc::new(Picture(photo)),
            clipped: Arc::new(own.clone()),
            points: Arc::new(Points(plane(|x, y| Vec3::new(x as f32, y as f32, -200.0)))),
            normal: Arc::new(Normal(plane(|_, _| Vec3::Z))),
            mask: Gather(vec![("lamp".to_owned(), Arc::new(own))]),
            kind: Gather(vec![("lamp".to_owned(), Arc::new(LightKind::Lamp))]),
            light: Gather(vec![light("lamp", plane(lamp)), light("rest", plane(|_, _| other))]),
            residual: Arc::new(Shading(plane(|_, _| Vec3::ZERO))),
            glare: Gather(vec![]),
        }
    }

    fn found(inputs: CorrectShadingIn) -> Plane<Vec3> {
        let out = CorrectShading {}.run(inputs, &Context::default()).expect("planes of one size");
        assert_eq!(out.gain.0[0].1.check(), Ok(()));
        out.gain.0[0].1.0.clone()
    }

    /// Largest error of the gain where all soft changes are light.
    fn error(got: &Plane<Vec3>, want: impl Fn(f32) -> f32) -> f32 {
        let error = |(x, y): (usize, usize)| (got.get(x, y) - want(away(x, y))).abs().max_element();
        let near = |&(x, y): &(usize, usize)| (2.0..14.0).contains(&away(x, y));
        let all = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
        all.filter(near).map(error).fold(0.0, f32::max)
    }

    fn halo(away: f32) -> f32 {
        1.0 + 0.6 * (-(away.max(0.0) / 11.0).powi(2)).exp()
    }

    #[test]
    fn a_halo_around_a_lamp_is_its_light() {
        let got = found(wall(halo, |_| Vec3::ONE));
        let off = error(&got, halo);
        assert!(off < 0.15, "{off}");
        let dimmer = |away: f32| 1.0 / halo(away);
        let off = error(&found(wall(dimmer, |_| Vec3::ONE)), dimmer);
        assert!(off < 0.15, "{off}");
        assert_eq!(got.get(0, 0), Vec3::ONE, "far away nothing changes");
    }

    #[test]
    fn stripes_of_paint_are_no_light() {
        let stripes = |x: usize| match x % 20 < 10 {
            true => Vec3::new(1.0, 0.9, 0.8),
            false => Vec3::new(0.3, 0.4, 0.6),
        };
        let off = error(&found(wall(|_| 1.0, stripes)), |_| 1.0);
        assert!(off < 0.01, "{off}");
        // At the edges of stripes the change of the light counts as paint.
        let off = error(&found(wall(halo, stripes)), halo);
        assert!(off < 0.25, "{off} of 0.6");
    }

    #[test]
    fn a_dark_thing_before_saturated_light_does_not_dim_it() {
        // The wall is saturated up to 13 pixels around the lamp; the thing begins 10 beside it.
        let thing = |x: usize| if (82..96).contains(&x) { Vec3::splat(0.05) } else { Vec3::ONE };
        let mut inputs = wall(|_| 1.0, thing);
        let shown = inputs.photo.0.map(|shown| shown.min(Vec3::splat(0.36)));
        inputs.clipped =
            Arc::new(Mask(shown.map(|shown| f32::from(u8::from(shown.max_element() >= 0.36)))));
        inputs.photo = Arc::new(Picture(shown));
        let got = found(inputs);
        for x in 40..82 {
            let off = (got.get(x, 45) - Vec3::ONE).abs().max_element();
            assert!(off < 0.05, "column {x}: {}", got.get(x, 45));
        }
    }

    #[test]
    fn windows_and_dark_lamps_keep_their_shading() {
        let mut window = wall(halo, |_| Vec3::ONE);
        window.kind.0[0].1 = Arc::new(LightKind::Window);
        assert!(found(window).is_empty());
        let mut dark = wall(halo, |_| Vec3::ONE);
        dark.light.0[0].1 = Arc::new(Shading(plane(|_, _| Vec3::ZERO)));
        assert!(found(dark).is_empty());
        let mut other = wall(halo, |_| Vec3::ONE);
        other.light.0[0].1 = Arc::new(Shading(Plane::filled(3, 2, Vec3::ONE)));
        let refused = CorrectShading {}.run(other, &Context::default()).err().expect("refused");
        assert!(refused.to_string().contains("3 x 2"), "{refused}");
    }
}
