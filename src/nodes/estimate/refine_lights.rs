//! `RefineLights`: shapes of the lights, refined by the photo.

use std::sync::Arc;

use crate::geometry::{Camera, RoomLayout, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Segments};
use crate::nodes::artifacts::{INV_LAMP, INV_WINDOW};
use crate::optics::inverse::{
    Bounds, DegreesOfFreedom, LayerQuality, LightPrior, LightVariable, Receivers, SeenRoom,
    ShapeFit, ShapeSearch, fit_shapes,
};
use crate::optics::{Bounces, LightTransport, Shape};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Moves lights to lower the loss: the distance of visible lamps, position and size of lights
    /// out of view, directions and bandwidths of window lobes.
    ///
    /// Damped Gauss-Newton on the receivers, radiances and albedos eliminated, Cauchy weights, a
    /// prior around the start; then shadows and indirect light are traced again (see
    /// `optics::inverse::fit_shapes`). A light whose move does not lower the loss enough keeps its
    /// shape to the bit.
    pub struct RefineLights {
        /// Upper bound of the rounds, in each of which shadows and indirect light are traced again.
        rounds: usize = 2, in 1..=10,
        /// Upper bound of the Gauss-Newton steps per round.
        steps: usize = 6, in 1..=100,
        /// Least fraction of the loss that the move of a light must save.
        min_gain: f64 = 0.05, in 0.0..1.0,
        /// Upper bound of the receivers.
        receivers: usize = 1000, in 1..=100_000,
        /// Shadow rays per receiver and lobe.
        samples: usize = 4, in 1..=1024,
        /// Radiosity of the unseen part of the room, as a multiple of the mean of the seen part.
        unseen: f32 = 0.5, in 0.0..=1.0,
        /// Cost of the constant ambient, as in `FitLights`.
        ambient_weight: f64 = 0.01, in 0.0..,
        /// Cost of lights out of view, as in `FitLights`.
        out_of_view_weight: f64 = 0.005, in 0.0..,
        /// Cost of the sun in a window, as in `FitLights`.
        sun_weight: f64 = 0.05, in 0.0..,
    }
}

ports! {
    pub input RefineLightsIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Fraction of saturated pixels.
        clipped: Arc<Mask>,
        /// The camera at working size.
        camera: Arc<Camera>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The mesh of the room, which casts shadows.
        mesh: Arc<SceneMesh>,
        /// Rays from the receivers into the room.
        transport: Arc<LightTransport>,
        /// The cuboid of the room whose cells `transport` has.
        layout: Option<Arc<RoomLayout>>,
        /// Albedo, for the indirect light.
        albedo: Arc<Albedo>,
        /// Segments of one material each.
        segments: Arc<Segments>,
        /// Pixels that are not part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// The shape of every visible light, of `inv_lamp` and of `inv_window`.
        shape: Gather<Shape>,
    }
}

ports! {
    pub output RefineLightsOut {
        /// The shapes of the same lights.
        shape: Scatter<Shape>,
    }
}

impl Node for RefineLights {
    const KIND: &'static str = "RefineLights";
    const VERSION: u32 = 2;
    type In = RefineLightsIn;
    type Out = RefineLightsOut;

    fn run(&self, inputs: RefineLightsIn, ctx: &Context) -> Result<RefineLightsOut, NodeError> {
        let RefineLightsIn {
            photo,
            clipped,
            points,
            normal,
            mesh,
            transport,
            albedo,
            segments,
            ..
        } = &inputs;
        let layout = inputs.layout.as_deref();
        let room =
            SeenRoom { photo, clipped, points, normal, mesh, transport, layout, albedo, segments };
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask).chain([&*inputs.ignore]);
        let receivers = Receivers::new(room, masks, self.receivers);
        ctx.check_cancelled()?;
        let (names, lights): (Vec<&str>, Vec<LightVariable>) =
            inputs.shape.iter().map(|(id, s)| (id, light_variable(id, s, &inputs))).unzip();
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let bounds = Bounds { camera: &camera, room: layout };
        let search = ShapeSearch {
            quality: LayerQuality {
                samples: self.samples,
                bounces: Bounces { count: TUNING.bounces, unseen: self.unseen },
            },
            rounds: self.rounds,
            steps: self.steps,
            min_gain: self.min_gain,
            prior: LightPrior {
                // The last fit decides which lamps are off.
                unlit: 0.0,
                out_of_view: self.out_of_view_weight,
                sun: self.sun_weight,
                ambient: self.ambient_weight,
                // The loss compares two shapes; a guess of the radiances does not affect it.
                tikhonov_weight: 0.0,
                hue_weight: 0.0,
                residual_weight: 0.0,
            },
        };
        let fit = fit_shapes(&receivers, &lights, &bounds, &search);
        report(&names, &fit, ctx);
        let given = inputs.shape.iter().zip(fit.shapes).map(|((id, given), found)| {
            (id.to_string(), if found == **given { Arc::clone(given) } else { Arc::new(found) })
        });
        Ok(RefineLightsOut { shape: Scatter(given.collect()) })
    }
}

tuning! {
    /// Constants of `RefineLights`.
    pub const TUNING: RefineLightsTuning {
        /// Bounces of the indirect light whose form is held while shapes change.
        bounces: usize = 1,
            unit "bounces", source Taste,
            effect "a larger value takes longer and follows indirect light more exactly";
    }
}

/// The light's shape with its degrees of freedom: those of a light out of view for `inv_lamp` and
/// `inv_window`.
fn light_variable<'a>(id: &str, shape: &Shape, inputs: &'a RefineLightsIn) -> LightVariable<'a> {
    let in_view = ![INV_LAMP, INV_WINDOW].contains(&id);
    LightVariable {
        shape: shape.clone(),
        mask: inputs.mask.get(id).map(|mask| &**mask),
        freedom: if in_view { DegreesOfFreedom::InView } else { DegreesOfFreedom::OutOfView },
        in_view,
    }
}

fn report(names: &[&str], fit: &ShapeFit, ctx: &Context) {
    let parameter = |i: usize| {
        let (light, name) = &fit.parameters[i];
        format!("{} of {}", name, names[*light])
    };
    let [before, after] = fit.loss;
    let moves = names.iter().zip(&fit.saved).filter(|(_, saved)| **saved > 0.0);
    let moves: Vec<String> =
        moves.map(|(name, saved)| format!("{name} saves {:.1} %", 100.0 * saved)).collect();
    let moves = if moves.is_empty() {
        "no light moved".to_owned()
    } else {
        format!("moved: {}", moves.join(", "))
    };
    let mut undetermined: Vec<String> = fit.underdetermined.iter().map(|&i| parameter(i)).collect();
    undetermined.dedup();
    let undetermined = if undetermined.is_empty() {
        String::new()
    } else {
        format!("; the photo does not determine the {}", undetermined.join(", "))
    };
    let number = fit.conditioning.number;
    ctx.note(format!(
        "misfit {before:.4} -> {after:.4}, condition number {number:.1e}, {moves}{undetermined}"
    ));
    if let Some([a, b]) =
        fit.conditioning.most_correlated.filter(|_| number > super::TUNING.confused_condition)
    {
        ctx.note(format!(
            "the photo hardly distinguishes the {} from the {}",
            parameter(a),
            parameter(b)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_out_of_range_are_told() {
        let node = RefineLights::default();
        assert_eq!(node.check(), Ok(()));
        for (bad, wanted) in [
            (RefineLights { rounds: 0, ..node.clone() }, "rounds: wanted 1..=10, got 0"),
            (RefineLights { receivers: 0, ..node.clone() }, "receivers: wanted 1..=100000, got 0"),
            (RefineLights { min_gain: 1.0, ..node.clone() }, "min_gain: wanted 0..1, got 1"),
            (RefineLights { unseen: f32::NAN, ..node.clone() }, "unseen: wanted 0..=1, got NaN"),
            (RefineLights { sun_weight: -1.0, ..node.clone() }, "sun_weight: wanted >= 0, got -1"),
        ] {
            assert_eq!(bad.check(), Err(wanted.to_owned()));
        }
    }
}
