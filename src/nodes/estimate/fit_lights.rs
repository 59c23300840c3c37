//! `FitLights`: radiances of the lights, and albedos of the segments.

use std::sync::Arc;

use glam::{BVec3, Vec3};

use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{
    Albedo, Mask, Normal, Picture, Plane, Points, Segments, Shading, dilate, inpaint_surfaces,
    luminance,
};
use crate::nodes::artifacts::{
    INV_LAMP, INV_WINDOW, LOBES, REST, Sun, UnitDirect, UnitIndirect, Visibility,
};
use crate::optics::inverse::{
    Column, Conditioning, LightPrior, Observations, RadianceFit, Role, fit_radiances,
    observed_pixels, quantile,
};
use crate::optics::{LightTransport, Radiance, Shape};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Fits the radiance of every lobe of every light to the photo, together with one albedo per
    /// segment.
    ///
    /// The picture is linear in the radiances: non-negative least squares on the unit layers, each
    /// with its own shadow and its own indirect light, by turns with the albedos (see
    /// `optics::inverse::fit_radiances`). Saturated pixels are lower bounds. A constant ambient
    /// with a higher penalty than any light takes the residual, which no light explains. A lamp
    /// that seems to be off by its pixels has a penalty, too.
    pub struct FitLights {
        /// Upper bound of the iterations. The fit ends earlier when no light changes by more than
        /// 1e-4 of itself. With 0, all lights give the same mean shading.
        iterations: usize = 200, in 0..=10_000,
        /// Weight of the prior that all lights give the same mean shading, as a fraction of the
        /// photo's energy. It decides where the photo does not.
        tikhonov_weight: f64 = 0.01, in 0.0..,
        /// Weight of the prior that all lights have one color, as a fraction of the photo's energy.
        hue_weight: f64 = 0.003, in 0.0..,
        /// Cost of the ambient residual, as a fraction of the photo's energy.
        ambient_weight: f64 = 0.01, in 0.0..,
        /// Cost of lights in view that seem to be off, as a fraction of the photo's energy.
        unlit_weight: f64 = 0.01, in 0.0..,
        /// Cost of lights out of view, as a fraction of the photo's energy.
        out_of_view_weight: f64 = 0.005, in 0.0..,
        /// Cost of the sun in a window, as a fraction of the photo's energy.
        sun_weight: f64 = 0.05, in 0.0..,
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
        /// Rays from the receivers into the room; receivers that look out of the visible room get
        /// the most ambient light.
        transport: Arc<LightTransport>,
        /// Pixels that are not part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// Shape of each light, which determines the roles of its lobes.
        shape: Gather<Shape>,
        /// Unit direct shading of each light.
        direct: Gather<UnitDirect>,
        /// Visibility of each light.
        visibility: Gather<Visibility>,
        /// Unit indirect shading of each light.
        indirect: Gather<UnitIndirect>,
        /// The sun whose light the photo shows: it has no cost.
        sun: Option<Arc<Sun>>,
    }
}

ports! {
    pub output FitLightsOut {
        /// Radiance of each light, per lobe.
        radiance: Scatter<Radiance>,
        /// Residual shading, which no light explains.
        residual: Arc<Shading>,
        /// One albedo per segment, fitted with the lights; lights' own pixels take that of their
        /// surroundings.
        albedo: Arc<Albedo>,
    }
}

impl Node for FitLights {
    const KIND: &'static str = "FitLights";
    const VERSION: u32 = 9;
    type In = FitLightsIn;
    type Out = FitLightsOut;

    fn run(&self, inputs: FitLightsIn, ctx: &Context) -> Result<FitLightsOut, NodeError> {
        let grid = inputs.transport.grid();
        let masks = || inputs.mask.iter().map(|(_, mask)| &**mask);
        let receivers: Vec<usize> = (0..grid.len()).map(|i| grid.pixel(i)).collect();
        let pixels = observed_pixels(
            receivers.into_iter(),
            &inputs.photo,
            &inputs.clipped,
            masks().chain([&*inputs.ignore]),
        );
        let at = |picture: &Picture| {
            Observations::at(
                picture,
                &inputs.clipped,
                &inputs.segments,
                &pixels,
                TUNING.mean_radius,
            )
        };
        let mut observations = at(&inputs.photo);
        if self.keep_albedo {
            observations = observations.over(&at(&Picture(inputs.albedo.0.clone())).photo);
        }

        let ambient = grid.upsample(&inputs.points, &inputs.normal, &inputs.transport.ambient());
        let mut lobes = unit_lobes(&inputs, &pixels)?;
        let layer = pixels.iter().map(|&p| ambient.pixels()[p]).collect();
        lobes.push(UnitLobe { light: REST, lobe: None, role: Role::Ambient, layer });
        let columns: Vec<Column> =
            lobes.iter().map(|lobe| Column::new(lobe.role, &lobe.layer)).collect();
        let before: Vec<Vec3> = match self.keep_albedo {
            true => vec![Vec3::ONE; pixels.len()],
            false => pixels.iter().map(|&p| inputs.albedo.0.pixels()[p]).collect(),
        };
        let prior = LightPrior {
            unlit: self.unlit_weight,
            out_of_view: self.out_of_view_weight,
            sun: self.sun_weight,
            ambient: self.ambient_weight,
            tikhonov_weight: self.tikhonov_weight,
            hue_weight: self.hue_weight,
            // No candidates are compared.
            residual_weight: 0.0,
        };
        let fit = fit_radiances(&observations, &columns, &prior, self.iterations);
        let fit = fit.with_albedo_of(&observations.segment, &before);
        FitReport { lobes: &lobes, columns: &columns, fit: &fit, observations: &observations }
            .send(ctx);

        let mut weights = fit.radiance.iter().copied();
        let radiance = inputs.direct.iter().map(|(id, direct)| {
            (
                id.to_string(),
                Arc::new(Radiance(weights.by_ref().take(direct.lobes.len()).collect())),
            )
        });
        let radiance = Scatter(radiance.collect());
        let ambient_radiance = fit.radiance.last().copied().unwrap_or(Vec3::ZERO);
        let residual = Arc::new(Shading(ambient.map(|a| a * ambient_radiance)));
        let albedo = match self.keep_albedo {
            true => Arc::clone(&inputs.albedo),
            false => Arc::new(Albedo(segment_albedo(&inputs, &pixels, &fit))),
        };
        Ok(FitLightsOut { radiance, residual, albedo })
    }
}

tuning! {
    /// Constants of `FitLights`.
    pub const TUNING: FitLightsTuning {
        /// Radius around a receiver within which the pixels of its segment are averaged.
        mean_radius: usize = 2,
            unit "pixels", source Taste, effect "a larger value lowers noise and blurs the edges of shadows";
        /// Width of the band around lights and saturated pixels in which the albedo is filled from
        /// its surroundings: this part of the picture's longer side.
        seam: usize = 64,
            unit "1 over the fraction", source Taste, effect "a smaller value hides more glare, and more paint";
        /// Least width of that band.
        min_seam: usize = 2,
            unit "pixels", source Taste, effect "a larger value hides more glare, and more paint, in small pictures";
        /// Largest fraction of saturated pixels of a lamp that seems to be off: at least 0.26 in 12
        /// lamps of photos that are on, at most 0.03 in those that are off.
        unlit_saturated: f32 = 0.1,
            unit "1", source Measured("lamps of real photos, on and off"), effect "a larger value takes more lamps for unlit";
        /// Luminance below which a lamp seems to be off: the 0.9 quantile of its pixels over that
        /// of the photo.
        unlit_brightness: f32 = 1.5,
            unit "1", source Measured("lamps of real photos, on and off"), effect "a larger value takes more lamps for unlit";
        /// Residual fraction of the light above which a person is warned.
        max_residual: f64 = 0.3,
            unit "1", source Taste, effect "a larger value warns less often; no estimate changes";
    }
}

/// Albedo of each pixel: that of its segment where the fit saw it, else that before the fit;
/// lights' own pixels, saturated ones and the seam around them take that of their surroundings.
fn segment_albedo(inputs: &FitLightsIn, pixels: &[usize], fit: &RadianceFit) -> Plane<Vec3> {
    let label = inputs.segments.label.pixels();
    let mut known = vec![false; fit.albedo.len()];
    pixels.iter().for_each(|&p| known[label[p] as usize] = true);
    // A value outside of this range is an error of the fit.
    let [least, most] = [super::TUNING.min_albedo, super::TUNING.max_albedo].map(Vec3::splat);
    let fitted = |p: usize| {
        let s = label[p] as usize;
        let albedo = if known[s] { fit.albedo[s] } else { inputs.albedo.0.pixels()[p] };
        albedo.clamp(least, most)
    };
    let (w, h) = inputs.photo.0.size();
    let mut albedo = Plane::new(w, h, (0..w * h).map(fitted).collect());
    let masks = inputs.mask.iter().map(|(_, mask)| &**mask);
    let unknown = dilate(
        masks.chain([&*inputs.clipped]),
        (w, h),
        (w.max(h) / TUNING.seam).max(TUNING.min_seam),
    );
    inpaint_surfaces(
        &mut albedo,
        unknown.map(BVec3::splat),
        (&inputs.points, &inputs.normal),
        |_, _| (Vec3::ZERO, 1.0),
    );
    albedo
}

/// Unit layer of one lobe of one light on the observed pixels.
struct UnitLobe<'a> {
    light: &'a str,
    /// Index of the lobe in [`LOBES`]; `None` for a light of one lobe.
    lobe: Option<usize>,
    role: Role,
    layer: Vec<Vec3>,
}

impl UnitLobe<'_> {
    /// Name in a message.
    fn name(&self) -> String {
        match (self.role, self.lobe) {
            (Role::Ambient, _) => "the residual".to_owned(),
            (_, Some(lobe)) => format!("{} ({})", self.light, LOBES[lobe]),
            (_, None) => self.light.to_owned(),
        }
    }
}

/// Whether a lamp seems to be off: at most `TUNING.unlit_saturated` of its pixels are saturated,
/// and their luminance is below `TUNING.unlit_brightness` times that of the photo. A lamp without
/// a working pixel of its own seems to be on.
fn seems_off(mask: &Mask, clipped: &Mask, luminances: &Plane<f32>) -> bool {
    let own = || (0..mask.0.pixels().len()).filter(|&i| mask.0.pixels()[i] > 0.5);
    let saturated = own().filter(|&i| clipped.0.pixels()[i] > 0.5).count() as f32;
    let shown = quantile(own().map(|i| luminances.pixels()[i]), 0.9);
    let photo = quantile(luminances.pixels().iter().copied(), 0.9);
    let count = own().count();
    count > 0
        && saturated <= TUNING.unlit_saturated * count as f32
        && shown < TUNING.unlit_brightness * photo
}

/// The lobes of all lights, in the order of the port `direct`.
fn unit_lobes<'a>(
    inputs: &'a FitLightsIn,
    pixels: &[usize],
) -> Result<Vec<UnitLobe<'a>>, NodeError> {
    let mut lobes = Vec::new();
    let luminances = inputs.photo.0.map(luminance);
    for (light, direct) in inputs.direct.iter() {
        let (Some(visibility), Some(indirect)) =
            (inputs.visibility.get(light), inputs.indirect.get(light))
        else {
            return Err(NodeError::Failed(format!(
                "light {light:?} has no visibility or no indirect shading"
            )));
        };
        let in_view = ![INV_LAMP, INV_WINDOW].contains(&light);
        let shape = inputs.shape.get(light);
        let shape =
            shape.ok_or_else(|| NodeError::Failed(format!("light {light:?} has no shape")))?;
        let is_window = matches!(**shape, Shape::Window(_));
        let mask = inputs.mask.get(light).filter(|_| !is_window);
        let shows_sun = inputs.sun.as_ref().is_some_and(|sun| sun.through(light).is_some());
        let is_unlit = mask.is_some_and(|mask| seems_off(mask, &inputs.clipped, &luminances));
        for (lobe, e) in direct.lobes.iter().enumerate() {
            let (lit, bounced) = (&visibility.lit[lobe], &indirect.lobes[lobe].0);
            let layer =
                |&p: &usize| bounced.pixels()[p] + Vec3::splat(e.pixels()[p] * lit.pixels()[p]);
            let role = match Role::of_lobe(shape, lobe, in_view) {
                _ if is_unlit => Role::Unlit,
                Role::Sun if shows_sun => Role::Visible,
                role => role,
            };
            let layer = pixels.iter().map(layer).collect();
            lobes.push(UnitLobe { light, lobe: is_window.then_some(lobe), role, layer });
        }
    }
    Ok(lobes)
}

/// Quality of a fit, for the person who runs it.
struct FitReport<'a> {
    /// The last one is the ambient.
    lobes: &'a [UnitLobe<'a>],
    columns: &'a [Column<'a>],
    fit: &'a RadianceFit,
    observations: &'a Observations,
}

impl FitReport<'_> {
    /// Sends warnings and a note.
    fn send(&self, ctx: &Context) {
        let pixels = self.observations.photo.len();
        if pixels == 0 {
            ctx.warn(
                "the photo is black at all observed pixels (pixels of lights and ignored pixels excluded): every \
                radiance is 0",
            );
            return;
        }
        let lights = self.lobes.len() - 1;
        let lit = (0..lights).filter(|k| !self.fit.dark.contains(k)).count();
        self.warn_of_dark_lights(lit, ctx);
        let is_undetermined = self.warn_of_few_pixels(lit, ctx);
        let (residual, total) = self.fit.residual_and_total(self.columns);
        let residual = if total > 0.0 { residual / total } else { 0.0 };
        if residual > TUNING.max_residual && lit > 0 {
            ctx.warn(format!(
                "no light source explains {:.0} % of the photo's light; it stays as `rest`",
                100.0 * residual
            ));
        }
        if !is_undetermined {
            self.warn_of_uncertain_lights(ctx);
        }
        let Conditioning { number, most_correlated, .. } = self.fit.conditioning;
        let hardest = most_correlated.map_or(String::new(), |[a, b]| {
            format!(", {} and {} most correlated", self.lobes[a].name(), self.lobes[b].name())
        });
        ctx.note(format!(
            "{} iterations, last change {:.1e}, misfit {:.4} -> {:.4}, condition number {number:.1e}{hardest}, residual \
            {:.1} %",
            self.fit.iterations,
            self.fit.change,
            self.fit.loss_before,
            self.fit.loss,
            100.0 * residual
        ));
    }

    /// Warns of lights none of whose lobes reaches the observed pixels. A window without sun is not
    /// worth a warning.
    fn warn_of_dark_lights(&self, lit: usize, ctx: &Context) {
        if lit == 0 {
            ctx.warn("no light reaches a visible surface: all light of the photo stays as `rest`");
            return;
        }
        let lobes = || self.lobes.iter().enumerate().filter(|(_, lobe)| lobe.role != Role::Ambient);
        let is_dark = |light: &str| {
            lobes().filter(|(_, lobe)| lobe.light == light).all(|(k, _)| self.fit.dark.contains(&k))
        };
        let mut dark: Vec<&str> =
            lobes().map(|(_, lobe)| lobe.light).filter(|light| is_dark(light)).collect();
        dark.dedup();
        if !dark.is_empty() {
            ctx.warn(format!("no visible surface is lit by {}: radiance 0", dark.join(", ")));
        }
    }

    /// Warns of saturation, and of fewer unsaturated pixels than unknowns; returns whether the
    /// latter leave radiances open.
    fn warn_of_few_pixels(&self, lit: usize, ctx: &Context) -> bool {
        let pixels = self.observations.photo.len();
        let clipped = self.observations.saturated.iter().filter(|&&s| s).count();
        if clipped == pixels {
            ctx.warn(
                "the photo is saturated at all observed pixels: all radiances are lower bounds, and their ratios \
                a guess",
            );
        } else if 2 * clipped > pixels {
            ctx.warn(format!(
                "{clipped} of {pixels} observed pixels are saturated: radiances are lower bounds"
            ));
        }
        let wanted = (self.lobes.len() - self.fit.dark.len()).saturating_sub(1);
        let is_undetermined = lit > 0 && self.fit.degrees_of_freedom < wanted;
        if is_undetermined && clipped < pixels {
            ctx.warn(format!(
                "{} unsaturated pixels of the photo leave {} equations for {lit} lobes after one unknown color per \
                surface (wanted {wanted}): the radiances are not determined",
                pixels - clipped,
                self.fit.degrees_of_freedom
            ));
        }
        is_undetermined
    }

    /// Warns of lights that look alike, and of those that have not converged.
    fn warn_of_uncertain_lights(&self, ctx: &Context) {
        let Conditioning { number, most_correlated, correlation } = self.fit.conditioning;
        if let Some([a, b]) = most_correlated.filter(|_| number > super::TUNING.confused_condition)
        {
            ctx.warn(format!(
                "the photo hardly distinguishes {} from {} (condition number {number:.1e}, correlation \
                {correlation:.5}): light of one may be attributed to the other",
                self.lobes[a].name(),
                self.lobes[b].name()
            ));
        }
        if !self.fit.unsettled.is_empty() {
            let names: Vec<String> =
                self.fit.unsettled.iter().map(|&k| self.lobes[k].name()).collect();
            ctx.warn(format!(
                "the fit did not converge: after {} iterations (parameter `iterations`) a light still changes by {:.1} %: \
                {}",
                self.fit.iterations,
                100.0 * self.fit.change,
                names.join(", ")
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_no_brighter_than_the_room_seems_off() {
        // A lamp of 2 x 5 pixels, a twentieth of the picture, in a room that shows 0.4.
        let own = |x: usize, y: usize| x < 2 && y < 5;
        let plane = |lamp: f32, room: f32| {
            Plane::from_fn(20, 10, |x, y| if own(x, y) { lamp } else { room })
        };
        let (mask, none) = (Mask(plane(1.0, 0.0)), Mask(plane(0.0, 0.0)));
        assert!(seems_off(&mask, &none, &plane(0.5, 0.4)));
        assert!(!seems_off(&mask, &none, &plane(0.7, 0.4)), "it is brighter than the room");
        assert!(!seems_off(&mask, &mask, &plane(0.5, 0.4)), "it is saturated");
        assert!(!seems_off(&none, &none, &plane(0.5, 0.4)), "no pixel shows it");
    }
}
