//! `FitLights`: how bright the lights are.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Mask, Normal, Picture, Plane, Points, Segments, Shading, around, fill_along_surfaces, luminance,
};
use crate::nodes::artifacts::{INV_LAMP, INV_WINDOW, LOBES, UnitDirect, UnitIndirect, Visibility};
use crate::optics::{Column, Conditioning, Evidence, Radiance, RadianceFit, Transport, evidence_pixels, fit_radiances};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Fits the radiance of every lobe of every light to the photo, together with one albedo per
    /// segment.
    ///
    /// The picture is linear in the radiances. The fit alternates between non-negative least
    /// squares on the unit layers, each with its shadows and its indirect light, and the albedos
    /// (`optics::fit_radiances`). Saturated pixels are lower bounds. A constant ambient layer with
    /// a cost of its own takes the residual that no light explains.
    pub struct FitLights {
        /// Upper bound of the iterations. The fit ends earlier when no light changes by more than
        /// 1e-4 of itself. With 0, all lights give the same mean shading.
        turns: usize = 200, in 0..=10_000,
        /// Weight of the prior that all lights give the same mean shading, as a fraction of the
        /// photo's energy. It decides where the photo does not.
        prior: f64 = 0.03, in 0.0..,
        /// Cost of the ambient residual, as a fraction of the photo's energy.
        rest_cost: f64 = 0.01, in 0.0..,
        /// Cost of lights out of view, as a fraction of the photo's energy.
        invisible_cost: f64 = 0.005, in 0.0..,
        /// Cost of the sun in a window, as a fraction of the photo's energy.
        sun_cost: f64 = 0.05, in 0.0..,
        /// Whether the input albedo is exact: then it stays as it is, per pixel, and the fit has
        /// only the radiances as unknowns.
        keep_albedo: bool = false,
    }
}

ports! {
    pub input FitLightsIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Albedo before the fit, whose mean level the fit keeps.
        albedo: Arc<Albedo>,
        /// Segments of one material each.
        segments: Arc<Segments>,
        /// Rays of the receivers. A receiver whose rays leave the seen room gets the most ambient
        /// light.
        transport: Arc<Transport>,
        /// Pixels that are not part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// Unit direct shading of each light.
        direct: Gather<UnitDirect>,
        /// Visibility of each light.
        visibility: Gather<Visibility>,
        /// Unit indirect shading of each light.
        indirect: Gather<UnitIndirect>,
    }
}

ports! {
    pub output FitLightsOut {
        /// Radiance of each light, per lobe.
        radiance: Scatter<Radiance>,
        /// Residual shading, which no light explains.
        rest: Arc<Shading>,
        /// One albedo per segment, fitted with the lights. A light's own pixels get the albedo of
        /// their surroundings.
        albedo: Arc<Albedo>,
    }
}

impl Node for FitLights {
    const KIND: &'static str = "FitLights";
    const VERSION: u32 = 5;
    type In = FitLightsIn;
    type Out = FitLightsOut;

    fn run(&self, inputs: FitLightsIn, ctx: &Context) -> Result<FitLightsOut, NodeError> {
        let grid = inputs.transport.grid();
        let masks = || inputs.mask.iter().map(|(_, mask)| &**mask);
        let receivers: Vec<usize> = (0..grid.len()).map(|i| grid.pixel(i)).collect();
        let pixels =
            evidence_pixels(receivers.into_iter(), &inputs.photo, &inputs.clipped, masks().chain([&*inputs.ignore]));
        let at = |picture: &Picture| Evidence::at(picture, &inputs.clipped, &inputs.segments, &pixels, 2);
        let mut evidence = at(&inputs.photo);
        if self.keep_albedo {
            evidence = evidence.over(&at(&Picture(inputs.albedo.0.clone())).photo);
        }

        let ambient = grid.upsample(&inputs.points, &inputs.normal, &inputs.transport.ambient());
        let (mut names, mut layers): (Vec<String>, Vec<(Vec<Vec3>, f64)>) = Default::default();
        for (id, direct) in inputs.direct.iter() {
            let (Some(visibility), Some(indirect)) = (inputs.visibility.get(id), inputs.indirect.get(id)) else {
                return Err(NodeError::Failed(format!("light {id:?} has no visibility or no indirect shading")));
            };
            let cost = if [INV_LAMP, INV_WINDOW].contains(&id) { self.invisible_cost } else { 0.0 };
            for (lobe, e) in direct.lobes.iter().enumerate() {
                // Of the lobes of a window the first is the sun.
                let cost = if direct.lobes.len() == 3 && lobe == 0 { self.sun_cost } else { cost };
                let (lit, bounced) = (&visibility.lit[lobe], &indirect.lobes[lobe].0);
                let layer = |&p: &usize| bounced.pixels()[p] + Vec3::splat(e.pixels()[p] * lit.pixels()[p]);
                layers.push((pixels.iter().map(layer).collect(), cost));
                names.push(if direct.lobes.len() == 3 { format!("{id} ({})", LOBES[lobe]) } else { id.into() });
            }
        }
        names.push("the rest".into());
        layers.push((pixels.iter().map(|&p| ambient.pixels()[p]).collect(), self.rest_cost));
        let mut columns: Vec<Column> =
            layers.iter().map(|(layer, cost)| Column { layer, penalty: *cost, pull: self.prior }).collect();
        // Nobody expects light that no light explains.
        columns.last_mut().expect("the rest is one").pull = 0.0;
        let before: Vec<Vec3> = match self.keep_albedo {
            true => vec![Vec3::ONE; pixels.len()],
            false => pixels.iter().map(|&p| inputs.albedo.0.pixels()[p]).collect(),
        };
        let fit = fit_radiances(&evidence, &columns, self.turns).with_albedo_of(&evidence.segment, &before);

        let mut weights = fit.radiance.iter().copied();
        let radiance = inputs.direct.iter().map(|(id, direct)| {
            (id.to_string(), Arc::new(Radiance(weights.by_ref().take(direct.lobes.len()).collect())))
        });
        let radiance: Vec<_> = radiance.collect();
        let rest_radiance = fit.radiance.last().copied().unwrap_or(Vec3::ZERO);
        tell(&names, &layers, &fit, &evidence, ctx);

        let rest = Arc::new(Shading(ambient.map(|a| a * rest_radiance)));
        if self.keep_albedo {
            return Ok(FitLightsOut { radiance: Scatter(radiance), rest, albedo: inputs.albedo });
        }
        let known = mark(&pixels, &inputs.segments, fit.albedo.len());
        let fitted = |p: usize| {
            let s = inputs.segments.label.pixels()[p] as usize;
            let albedo = if known[s] { fit.albedo[s] } else { inputs.albedo.0.pixels()[p] };
            albedo.clamp(Vec3::splat(super::TUNING.min_albedo), Vec3::splat(super::TUNING.max_albedo))
        };
        let (w, h) = inputs.photo.0.size();
        let mut albedo = Plane::new(w, h, (0..w * h).map(fitted).collect());
        // Neither a light's own pixels nor saturated ones tell an albedo, nor the seam around them.
        let seam = (w.max(h) / TUNING.boundary_parts).max(TUNING.min_boundary);
        let unknown = around(masks().chain([&*inputs.clipped]), (w, h), seam);
        fill_along_surfaces(&mut albedo, unknown, &inputs.points, &inputs.normal);
        Ok(FitLightsOut { radiance: Scatter(radiance), rest, albedo: Arc::new(Albedo(albedo)) })
    }
}

tuning! {
    /// Constants of `FitLights`.
    pub const TUNING: FitLightsTuning {
        /// Greatest fraction of the light that may stay unexplained without a warning.
        max_residual: f64 = 0.3, unit "fraction", source Taste, effect "a larger value warns less often; no estimate changes";
        /// Parts of the photo's longer side, one of which is the width of the boundary around lights and
        /// saturated pixels, where albedo is filled in.
        boundary_parts: usize = 64, unit "1", source Taste, effect "a larger value keeps more albedo close to lights";
        /// Least width of that boundary.
        min_boundary: usize = 2, unit "working pixels", source Taste, effect "a larger value fills in more around lights";
    }
}

/// Says how good the fit is where a person should know. `names` are those of the columns, the rest last.
fn tell(names: &[String], layers: &[(Vec<Vec3>, f64)], fit: &RadianceFit, evidence: &Evidence, ctx: &Context) {
    let pixels = evidence.photo.len();
    let named = |columns: &[usize]| columns.iter().map(|&k| names[k].as_str()).collect::<Vec<_>>().join(", ");
    if pixels == 0 {
        ctx.warn(
            "the photo is black wherever it could tell of the lights (their own pixels and those of no part of the room apart): \
             every radiance is 0",
        );
        return;
    }
    let rest = names.len() - 1;
    let lit = (0..rest).filter(|k| !fit.dark.contains(k)).count();
    if lit == 0 {
        ctx.warn("no light reaches what the photo shows: all of its light stays as `rest`");
    }
    // A window without sun is nothing to tell: only a light none of whose lobes reaches anything is.
    let light = |k: usize| names[k].split(" (").next().unwrap_or_default();
    let whole = |k: &usize| (0..rest).filter(|&j| light(j) == light(*k)).all(|j| fit.dark.contains(&j));
    let mut dark: Vec<&str> = fit.dark.iter().filter(|&&k| k < rest).filter(|k| whole(k)).map(|&k| light(k)).collect();
    dark.dedup();
    if lit > 0 && !dark.is_empty() {
        ctx.warn(format!("nothing that the photo shows is lit by {}: radiance 0", dark.join(", ")));
    }
    let clipped = evidence.saturated.iter().filter(|&&s| s).count();
    if clipped == pixels {
        ctx.warn("the photo is saturated wherever it could tell of the lights: all radiances are lower bounds, shared by guess");
    } else if 2 * clipped > pixels {
        ctx.warn(format!("{clipped} of {pixels} places are saturated: radiances are lower bounds"));
    }
    let wanted = (names.len() - fit.dark.len()).saturating_sub(1);
    let few = lit > 0 && fit.spare < wanted;
    if few && clipped < pixels {
        ctx.warn(format!(
            "{} unsaturated places of the photo, of which the colours of its surfaces take up all but {}, say too little to \
             share the light among {lit} lobes (wanted {wanted}): the radiances are not determined",
            pixels - clipped,
            fit.spare
        ));
    }
    let share = |k: usize| -> f64 { layers[k].0.iter().map(|u| f64::from(luminance(*u * fit.radiance[k]))).sum() };
    let total: f64 = (0..names.len()).map(share).sum();
    let unexplained = if total > 0.0 { share(rest) / total } else { 0.0 };
    if unexplained > TUNING.max_residual && lit > 0 {
        ctx.warn(format!("{:.0} % of the light is explained by no light; it stays as `rest`", 100.0 * unexplained));
    }
    let Conditioning { number, alike, correlation } = fit.conditioning;
    if let Some(pair) = alike.filter(|_| number > super::TUNING.confused_condition && !few) {
        ctx.warn(format!(
            "the photo hardly tells {} and {} apart (condition number {number:.1e}, correlation {correlation:.5}): what \
             one of them gives may be the other's",
            names[pair[0]], names[pair[1]]
        ));
    }
    if !fit.moving.is_empty() && !few {
        ctx.warn(format!(
            "the fit did not settle: after {} turns (parameter `turns`) a light still changes by {:.1} %: {}",
            fit.turns,
            100.0 * fit.change,
            named(&fit.moving)
        ));
    }
    let hardest =
        alike.map_or(String::new(), |[a, b]| format!(", {} and {} hardest to tell apart", names[a], names[b]));
    ctx.note(format!(
        "{} turns, last change {:.1e}, misfit {:.4} -> {:.4}, condition number {number:.1e}{hardest}, rest {:.1} %",
        fit.turns,
        fit.change,
        fit.loss_before,
        fit.loss,
        100.0 * unexplained
    ));
}

/// Which segments the fit saw.
fn mark(pixels: &[usize], segments: &Segments, count: usize) -> Vec<bool> {
    let mut known = vec![false; count];
    pixels.iter().for_each(|&p| known[segments.label.pixels()[p] as usize] = true);
    known
}
