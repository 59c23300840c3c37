//! `FitLights`: how bright the lights are.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Mask, Normal, Picture, Plane, Points, Segments, Shading, around, fill_along_surfaces, luminance,
};
use crate::nodes::artifacts::{INV_LAMP, INV_WINDOW, UnitDirect, UnitIndirect, Visibility};
use crate::optics::{Column, Evidence, Radiance, Transport, evidence_pixels, fit_radiances};
use crate::{params, ports};

params! {
    /// Fits the radiance of every lobe of every light to the photo, together with one albedo per segment.
    ///
    /// The picture is linear in the radiances: non-negative least squares on the unit layers, each with its own shadow and
    /// its own indirect light, by turns with the albedos (see `optics::fit_radiances`). Saturated pixels are lower bounds.
    /// A constant ambient, dearer than any light, takes what no light explains: the rest.
    pub struct FitLights {
        /// Rounds of the fit.
        turns: usize = 24,
        /// Cost of the rest, as a share of the photo's energy.
        rest_cost: f64 = 0.01,
        /// Cost of lights out of view.
        invisible_cost: f64 = 0.005,
        /// Cost of the sun in a window.
        sun_cost: f64 = 0.05,
    }
}

ports! {
    pub input FitLightsIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Share of saturated pixels.
        clipped: Arc<Mask>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Albedo before the fit; its mean level is kept.
        albedo: Arc<Albedo>,
        /// Pixels of one material.
        segments: Arc<Segments>,
        /// What the receivers see; those that look out of the seen room get the most ambient light.
        transport: Arc<Transport>,
        /// Pixels that are no part of the room.
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
        /// Shading that no light explains.
        rest: Arc<Shading>,
        /// One albedo per segment, fitted with the lights; lights' own pixels take that of their surroundings.
        albedo: Arc<Albedo>,
    }
}

impl Node for FitLights {
    const KIND: &'static str = "FitLights";
    const VERSION: u32 = 1;
    type In = FitLightsIn;
    type Out = FitLightsOut;

    fn check(&self) -> Result<(), String> {
        if !(1..=10_000).contains(&self.turns) {
            return Err(format!("turns: wanted 1..=10000, got {}", self.turns));
        }
        for (name, value) in
            [("rest_cost", self.rest_cost), ("invisible_cost", self.invisible_cost), ("sun_cost", self.sun_cost)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(format!("{name}: wanted a number >= 0, got {value}"));
            }
        }
        Ok(())
    }

    fn run(&self, inputs: FitLightsIn, ctx: &Context) -> Result<FitLightsOut, NodeError> {
        let grid = inputs.transport.grid();
        let masks = || inputs.mask.iter().map(|(_, mask)| &**mask);
        let receivers: Vec<usize> = (0..grid.len()).map(|i| grid.pixel(i)).collect();
        let pixels = evidence_pixels(receivers.into_iter(), &inputs.photo, masks().chain([&*inputs.ignore]));
        let evidence = Evidence::at(&inputs.photo, &inputs.clipped, &inputs.segments, &pixels, 2);

        let ambient = grid.upsample(&inputs.points, &inputs.normal, &inputs.transport.ambient());
        let mut layers: Vec<(Vec<Vec3>, f64)> = Vec::new();
        for (id, direct) in inputs.direct.iter() {
            let (Some(visibility), Some(indirect)) = (inputs.visibility.get(id), inputs.indirect.get(id)) else {
                return Err(NodeError::Failed(format!("light {id:?} has no visibility or no indirect shading")));
            };
            let cost = if [INV_LAMP, INV_WINDOW].contains(&id) { self.invisible_cost } else { 0.0 };
            for lobe in 0..direct.lobes.len() {
                // Of the lobes of a window the first is the sun.
                let cost = if direct.lobes.len() == 3 && lobe == 0 { self.sun_cost } else { cost };
                let (e, lit, bounced) = (&direct.lobes[lobe], &visibility.lit[lobe], &indirect.lobes[lobe].0);
                let layer = |&p: &usize| bounced.pixels()[p] + Vec3::splat(e.pixels()[p] * lit.pixels()[p]);
                layers.push((pixels.iter().map(layer).collect(), cost));
            }
        }
        layers.push((pixels.iter().map(|&p| ambient.pixels()[p]).collect(), self.rest_cost));
        let columns: Vec<Column> = layers.iter().map(|(layer, cost)| Column { layer, penalty: *cost }).collect();
        let before: Vec<Vec3> = pixels.iter().map(|&p| inputs.albedo.0.pixels()[p]).collect();
        let fit = fit_radiances(&evidence, &columns, self.turns).with_albedo_of(&evidence.segment, &before);

        let mut weights = fit.radiance.iter().copied();
        let radiance = inputs.direct.iter().map(|(id, direct)| {
            (id.to_string(), Arc::new(Radiance(weights.by_ref().take(direct.lobes.len()).collect())))
        });
        let radiance: Vec<_> = radiance.collect();
        let rest_radiance = fit.radiance.last().copied().unwrap_or(Vec3::ZERO);
        self.tell(&pixels, &layers, &fit, &evidence, ctx);

        let known = mark(&pixels, &inputs.segments, fit.albedo.len());
        let fitted = |p: usize| {
            let s = inputs.segments.label.pixels()[p] as usize;
            let albedo = if known[s] { fit.albedo[s] } else { inputs.albedo.0.pixels()[p] };
            albedo.clamp(Vec3::splat(0.02), Vec3::splat(0.95))
        };
        let (w, h) = inputs.photo.0.size();
        let mut albedo = Plane::new(w, h, (0..w * h).map(fitted).collect());
        // Neither a light's own pixels nor saturated ones tell an albedo, nor the seam around them.
        let seam = (w.max(h) / 64).max(2);
        let unknown = around(masks().chain([&*inputs.clipped]), (w, h), seam);
        fill_along_surfaces(&mut albedo, unknown, &inputs.points, &inputs.normal);
        Ok(FitLightsOut {
            radiance: Scatter(radiance),
            rest: Arc::new(Shading(ambient.map(|a| a * rest_radiance))),
            albedo: Arc::new(Albedo(albedo)),
        })
    }
}

impl FitLights {
    /// Says how good the fit is where a person should know.
    fn tell(
        &self,
        pixels: &[usize],
        layers: &[(Vec<Vec3>, f64)],
        fit: &crate::optics::RadianceFit,
        evidence: &Evidence,
        ctx: &Context,
    ) {
        if pixels.len() < layers.len() {
            ctx.warn(format!(
                "{} pixels of the photo say something about {} lobes: the radiances are not determined",
                pixels.len(),
                layers.len()
            ));
            return;
        }
        let share = |k: usize| -> f64 { layers[k].0.iter().map(|u| f64::from(luminance(*u * fit.radiance[k]))).sum() };
        let total: f64 = (0..layers.len()).map(share).sum();
        let rest = share(layers.len() - 1) / total.max(1e-12);
        if rest > 0.3 {
            ctx.warn(format!("{:.0} % of the light is explained by no light; it stays as `rest`", 100.0 * rest));
        }
        if fit.condition > 1e4 {
            ctx.warn(format!("some lights look alike to the fit (condition number {:.1e})", fit.condition));
        }
        let clipped = evidence.saturated.iter().filter(|&&s| s).count();
        if 2 * clipped > pixels.len() {
            ctx.warn(format!("{} of {} places are saturated: radiances are lower bounds", clipped, pixels.len()));
        }
        tracing::info!(loss = fit.loss, condition = fit.condition, rest, "radiances fitted");
    }
}

/// Which segments the fit saw.
fn mark(pixels: &[usize], segments: &Segments, count: usize) -> Vec<bool> {
    let mut known = vec![false; count];
    pixels.iter().for_each(|&p| known[segments.label.pixels()[p] as usize] = true);
    known
}
