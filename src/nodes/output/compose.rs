//! `Compose`: from shading to a picture, and to one picture per light.
//!
//! Away from lights, a pixel I of the photo under the shading E = sum E_k + R, with the residual R
//! that no light explains, becomes `sum B E'_k + B R' + U` after an edit. In the mode `Ratio`, the
//! reflectance B is I / E, at most 1, and U = I - B E is unexplained light (a highlight, an unseen
//! sun), which stays and is part of the residual layer. So the identity edit gives the photo back,
//! texture and resolution survive, and each term is linear in its light's radiance. In the mode
//! `Physical`, B is the estimated albedo and U = 0.
//!
//! Some pixels belong to one light: those that show it, those of its glare, and those that it
//! saturates, where I / E does not determine the surface. There the photo is the surface under all
//! other lights, and a remainder that goes with the light: I = B (E - E_k) + G with B = min(A, I /
//! (E - E_k)). In the light's own pixels A is the albedo of a shade or a pane, elsewhere I / E of
//! the surface around. Both ways are blended where saturation and glare begin, so that no boundary
//! shows.
//!
//! `src/image/ops/relight.rs` has these equations for one pixel. [`LightLayers`] and
//! [`ObjectLayers`] are the inputs as one pixel needs them, [`Pixels`] visits all pixels.

mod light_layers;
mod object_layers;
mod pixels;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, Objects};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Albedo, Depth, GlareMask, Layer, Mask, PaintLayers, Picture, Plane, Shading};
use crate::optics::{LightKind, Radiance, Reflections, Shape, SpecularChange};
use crate::{params, ports};

use light_layers::LightLayers;
use object_layers::ObjectLayers;
use pixels::Pixels;

/// Model of the reflectance of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Photo over shading: keeps all texture.
    Ratio,
    /// The estimated albedo.
    Physical,
}

params! {
    /// Puts the edited shading onto the photo, at the photo's own size.
    ///
    /// Shading is brought to the photo's size by joint bilateral upsampling against depth and
    /// color; the photo's pixels are never resampled.
    pub struct Compose {
        /// `Ratio` or `Physical`.
        mode: Mode = Mode::Ratio,
        /// Albedo shown by the surface of a lamp that is switched off; 0..=1.
        lamp_albedo: f32 = 0.5, in 0.0..=1.0,
        /// Albedo shown by the pane of a window that is switched off; 0..=1.
        pane_albedo: f32 = 0.05, in 0.0..=1.0,
        /// Radiance of the unseen part of the room in reflections, as a multiple of the mean of the
        /// seen part, 0..=1. The lighting of a network takes its place where there is one.
        unseen: f32 = 0.5, in 0.0..=1.0,
    }
}

ports! {
    pub input ComposeIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar z at the photo's size.
        full_depth: Arc<Depth>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Planar z at working size.
        depth: Arc<Depth>,
        /// Estimated albedo, working size.
        albedo: Arc<Albedo>,
        /// Photo over shading, filled in where a light hides it, working size.
        paint: Arc<Albedo>,
        /// Paint that the edit puts over it, photo size.
        coats: Arc<PaintLayers>,
        /// Shading by each light as estimated, working size.
        before: Gather<Shading>,
        /// Shading by each light after the edit, working size.
        after: Gather<Shading>,
        /// Residual shading, which no light explains, working size.
        rest: Arc<Shading>,
        /// Residual shading after the edit.
        edited_rest: Arc<Shading>,
        /// The own pixels of each visible light and its glare, photo size.
        zone: Gather<GlareMask>,
        /// The kind of each visible light.
        kind: Gather<LightKind>,
        /// The lights as estimated.
        estimated: Gather<Shape>,
        /// Their radiances.
        estimated_radiance: Gather<Radiance>,
        /// The lights after the edit.
        shape: Gather<Shape>,
        /// Their radiances.
        radiance: Gather<Radiance>,
        /// Radiance after over before.
        gain: Gather<Radiance>,
        /// Pixels covered by the bodies of inserted lights, photo size.
        cover: Gather<Mask>,
        /// Inserted objects as they are seen.
        objects: Arc<Objects>,
        /// Their diffuse reflection of each light.
        object: Gather<Picture>,
        /// Their diffuse reflection of the residual.
        object_rest: Arc<Picture>,
        /// The specular reflection of shiny objects; empty without them.
        reflected: Option<Arc<Reflections>>,
        /// The change of specular reflection of surfaces with an edited roughness or specular
        /// level; empty without them.
        polish: Option<Arc<SpecularChange>>,
    }
}

ports! {
    pub output ComposeOut {
        /// Linear, photo size, not clamped: the sum of all layers.
        picture: Arc<Picture>,
        /// The contribution of each light.
        layer: Scatter<Layer>,
        /// The residual, which no light explains.
        rest: Arc<Layer>,
    }
}

impl Node for Compose {
    const KIND: &'static str = "Compose";
    const VERSION: u32 = 8;
    type In = ComposeIn;
    type Out = ComposeOut;

    fn run(&self, inputs: ComposeIn, ctx: &Context) -> Result<ComposeOut, NodeError> {
        let size = inputs.photo.0.size();
        let lights = LightLayers::new(&inputs, [self.lamp_albedo, self.pane_albedo])?;
        let objects = ObjectLayers::new(&inputs, &lights, self.unseen)?;
        let pixels = Pixels::new(self.mode, &inputs, &lights);
        ctx.check_cancelled()?;
        if inputs.polish.is_none() && objects.is_empty() {
            // No pixel depends on another: halves at once, so that no layer is ever in memory as
            // floats.
            if let Some((picture, layers)) = pixels.half_layers(ctx)? {
                return Ok(output(&lights, size, picture, layers));
            }
        }
        let mut planes = pixels.planes(ctx)?;
        if let Some(change) = &inputs.polish {
            ctx.check_cancelled()?;
            objects.change_specular(change, &mut planes)?;
        }
        if !objects.is_empty() {
            objects.cover(&mut planes)?;
        }
        let sum = |i: usize| planes.iter().map(|plane| plane[i]).sum::<Vec3>();
        let picture = (0..size.0 * size.1).into_par_iter().with_min_len(size.0.max(1)).map(sum).collect();
        let layers = planes.into_iter().map(|plane| Layer::new(Plane::new(size.0, size.1, plane))).collect();
        Ok(output(&lights, size, picture, layers))
    }
}

/// The picture and its layers, of each light in its order and then of the residual.
fn output(
    lights: &LightLayers,
    (width, height): (usize, usize),
    picture: Vec<Vec3>,
    mut layers: Vec<Layer>,
) -> ComposeOut {
    let residual = layers.pop().expect("the residual follows the lights");
    let names = lights.names.iter().map(|id| id.to_string());
    ComposeOut {
        picture: Arc::new(Picture(Plane::new(width, height, picture))),
        layer: Scatter(names.zip(layers.into_iter().map(Arc::new)).collect()),
        rest: Arc::new(residual),
    }
}
