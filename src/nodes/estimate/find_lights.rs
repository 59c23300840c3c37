//! `FindLights`: proposed masks of lamps and windows, to be corrected by hand and named in the
//! scene.

use std::fmt::Write as _;
use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Mask, Normal, Picture, Plane, Points, Transfer, annotate, resize, write_png};
use crate::nodes::artifacts::{Encoding, Files};
use crate::optics::LightKind;
use crate::optics::inverse::{LightSearch, RADIANCE_FIT, find_lights};
use crate::{params, ports};

params! {
    /// Proposes a mask for each visible lamp and window: a bright region with a sharp edge that is
    /// not a floor, a table or a bed.
    ///
    /// A proposal of low confidence is named `maybe_..` and left to a person. Lit walls and white
    /// objects under a near lamp can still be false positives, and the mask of a lamp may include
    /// its glare. Check `found.png`, correct the masks, and add `scene_lights.ron` to the scene
    /// (docs/find-lights.md).
    pub struct FindLights {
        /// Least brightness of a light, as a fraction of the photo's white.
        threshold: f32 = 0.75, in 0.1..=0.95,
        /// Weight of a smooth outline against the brightness of single pixels in the graph cut.
        smoothness: f32 = 1.0, in 0.0..=100.0,
        /// Least area of a light, as a fraction of the photo's pixels.
        smallest: f32 = 0.001, in 0.0..=1.0,
        /// Upper bound of the lights; the largest are kept.
        most: usize = 16, in 1..=RADIANCE_FIT.max_lights,
    }
}

ports! {
    pub input FindLightsIn {
        /// The photo at the size of the masks.
        photo: Arc<Picture>,
        /// Its encoding, for the overview.
        encoding: Arc<Encoding>,
        /// The photo at working size, linear.
        small: Arc<Picture>,
        /// Fraction of saturated pixels, working size.
        clipped: Arc<Mask>,
        /// Points at working size; with `normal`, they separate lamps before a wall from windows in
        /// it, and tables from both.
        points: Option<Arc<Points>>,
        /// Normals at working size.
        normal: Option<Arc<Normal>>,
    }
}

ports! {
    pub output FindLightsOut {
        /// `masks/lamp_0.png`, `masks/window_0.png`, .., white on black at the photo's size, the
        /// largest of a kind first, and `masks/maybe_lamp_0.png` and so on where the confidence is
        /// low; `found.png`, the photo with outlines and names; `scene_lights.ron`, the scene's
        /// `lights`, in which the latter are comments.
        files: Arc<Files>,
    }
}

impl Node for FindLights {
    const KIND: &'static str = "FindLights";
    const VERSION: u32 = 3;
    type In = FindLightsIn;
    type Out = FindLightsOut;

    fn run(&self, inputs: FindLightsIn, ctx: &Context) -> Result<FindLightsOut, NodeError> {
        let size = inputs.small.0.size();
        let planes = [
            ("clipped", Some(inputs.clipped.0.size())),
            ("points", inputs.points.as_ref().map(|points| points.0.size())),
            ("normal", inputs.normal.as_ref().map(|normal| normal.0.size())),
        ];
        for (name, got) in planes {
            if let Some(got) = got.filter(|got| *got != size) {
                return Err(NodeError::Failed(format!(
                    "{name}: wanted {size:?} pixels as `small`, got {got:?}"
                )));
            }
        }
        let &FindLights { threshold, smoothness, smallest, most } = self;
        let search = LightSearch { threshold, smoothness, smallest, most };
        let room = inputs.points.as_deref().zip(inputs.normal.as_deref());
        let found = find_lights(&inputs.small, &inputs.clipped, room, &search);
        ctx.check_cancelled()?;
        if found.is_empty() {
            ctx.warn("no light found: no region of the photo is bright, sharply bounded and off the floor");
        }

        let (width, height) = inputs.photo.0.size();
        let mut files = Vec::new();
        let mut overview = inputs.photo.0.clone();
        let mut scene = String::from("// For scene.ron, beside which masks/ belongs.\nlights: {\n");
        let mut counts = [0; 4];
        for light in &found {
            let (word, variant, kind, color) = match light.kind {
                LightKind::Lamp => ("lamp", "Lamp", 0, Vec3::new(1.0, 0.1, 0.0)),
                LightKind::Window => ("window", "Window", 1, Vec3::new(0.0, 0.3, 1.0)),
            };
            let certain = light.is_certain();
            let (maybe, remark, count, color) = match certain {
                true => ("", "", &mut counts[kind], color),
                false => ("maybe_", "// ", &mut counts[2 + kind], DOUBTFUL),
            };
            let id = format!("{maybe}{word}_{count}");
            *count += 1;
            let share = 100.0 * light.area as f32 / (size.0 * size.1) as f32;
            let confidence = format!("confidence {:.2}", light.confidence);
            ctx.note(format!(
                "{id}: {share:.1} % of the photo, contrast {:.1} at its edge, {confidence}{}",
                light.contrast,
                if certain { "" } else { ": not used" }
            ));
            let mask = upscale(&light.mask, width, height);
            annotate(&mut overview, &mask, &id, color);
            let white = Picture(mask.map(|inside| if inside { Vec3::ONE } else { Vec3::ZERO }));
            files.push((format!("masks/{id}.png"), write_png(&white, Transfer::Linear, false)));
            writeln!(
                scene,
                "    {remark}\"{id}\": {variant}(mask: \"masks/{id}.png\"), // {confidence}"
            )
            .expect("memory can be written to");
        }
        scene.push_str("},\n");
        files.push((
            "found.png".into(),
            write_png(&Picture(overview), inputs.encoding.transfer, false),
        ));
        files.push(("scene_lights.ron".into(), scene.into_bytes()));
        Ok(FindLightsOut { files: Arc::new(Files(files)) })
    }
}

/// The color of outlines of lights that are not used.
const DOUBTFUL: Vec3 = Vec3::new(0.6, 0.6, 0.6);

/// A mask in another size, its edge halfway between pixels that differ.
fn upscale(mask: &Plane<bool>, width: usize, height: usize) -> Plane<bool> {
    let share = mask.map(|inside| f32::from(u8::from(inside)));
    resize(&share, width, height).map(|share| share > 0.5)
}
