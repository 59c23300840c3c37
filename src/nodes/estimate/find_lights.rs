//! `FindLights`
use std::sync::Arc;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Mask, Normal, Picture, Points, resize, write_png, Transfer};
use crate::nodes::artifacts::Files;
use crate::optics::{Finder, find_lights};
use crate::{params, ports};
use glam::Vec3;

params! {
    /// Finds
    pub struct FindLights {
        /// t
        threshold: f32 = 0.75,
        /// s
        smoothness: f32 = 1.0,
        /// a
        smallest: f32 = 0.0005,
        /// m
        most: usize = 16,
    }
}
ports! {
    pub input FindLightsIn {
        /// photo
        photo: Arc<Picture>,
        /// small
        small: Arc<Picture>,
        /// c
        clipped: Arc<Mask>,
        /// p
        points: Option<Arc<Points>>,
        /// n
        normal: Option<Arc<Normal>>,
    }
}
ports! {
    pub output FindLightsOut {
        /// f
        files: Arc<Files>,
    }
}
impl Node for FindLights {
    const KIND: &'static str = "FindLights";
    const VERSION: u32 = 1;
    type In = FindLightsIn;
    type Out = FindLightsOut;

    fn run(&self, inputs: FindLightsIn, ctx: &Context) -> Result<FindLightsOut, NodeError> {
        let finder = Finder { threshold: self.threshold, smoothness: self.smoothness, smallest: self.smallest, most: self.most };
        let room = inputs.points.as_deref().zip(inputs.normal.as_deref());
        let found = find_lights(&inputs.small, &inputs.clipped, room, &finder);
        let (w, h) = inputs.photo.0.size();
        let mut files = Vec::new();
        for (i, light) in found.iter().enumerate() {
            ctx.note(format!("lamp_{i}: {}", light.why));
            let full = resize(&light.mask.0, w, h).map(|m| if m >= 0.5 { Vec3::ONE } else { Vec3::ZERO });
            files.push((format!("masks/lamp_{i}.png"), write_png(&Picture(full), Transfer::Linear, false)));
        }
        Ok(FindLightsOut { files: Arc::new(Files(files)) })
    }
}
