//! `DrawScene`: depth, horizon, lights and room over the photo, for a person to check them.

use std::sync::Arc;

use glam::Vec3;

use super::draw_edges;
use crate::geometry::{Camera, RoomLayout};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{
    Depth, Mask, Picture, Plane, annotate, draw_line, fit, nearness, resize, text_size, write_png,
    write_text,
};
use crate::nodes::artifacts::{Encoding, Files};
use crate::optics::LightKind;
use crate::tuning::tuning;
use crate::{params, ports};

tuning! {
    /// Constants of the picture of a scene.
    pub const TUNING: DrawSceneTuning {
        /// Width of the horizon.
        horizon_width: f32 = 2.2,
            unit "pixels", source Taste, effect "a larger value hides more of the photo";
        /// Least share of a pixel that a mask covers where it is drawn.
        covered: f32 = 0.5,
            unit "1", source Taste, effect "a smaller value draws larger outlines";
        /// Bands of 1 / z from the nearest to the farthest, whose edges are contours of the depth.
        bands: f32 = 12.0,
            unit "bands", source Taste, effect "a larger value draws more contours";
        /// Factor on the brightness of every other band.
        band_dim: f32 = 0.75,
            unit "1", source Taste, effect "a smaller value makes contours stronger";
    }
}

params! {
    /// Draws a scene for a person to check: on the left the photo with the outlines of its lights
    /// (lamps red, windows blue), the room's edges and the horizon (yellow); on the right the
    /// depth, white is near, with contours and the room's edges.
    pub struct DrawScene {
        /// Longer side of each half, pixels; a smaller photo is not enlarged.
        long_side: u32 = 800, in 16..=4096,
    }
}

ports! {
    pub input DrawSceneIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// Its camera.
        camera: Arc<Camera>,
        /// Its encoding, which the picture has as well.
        encoding: Arc<Encoding>,
        /// Planar depth, of any size.
        depth: Arc<Depth>,
        /// The cuboid of the room.
        layout: Arc<RoomLayout>,
        /// The pixels of each visible light, of any size.
        masks: Gather<Mask>,
        /// Kind of each visible light, under the same names.
        kinds: Gather<LightKind>,
    }
}

ports! {
    pub output DrawSceneOut {
        /// `look.png`.
        files: Arc<Files>,
    }
}

impl Node for DrawScene {
    const KIND: &'static str = "DrawScene";
    const VERSION: u32 = 2;
    type In = DrawSceneIn;
    type Out = DrawSceneOut;

    fn run(&self, inputs: DrawSceneIn, ctx: &Context) -> Result<DrawSceneOut, NodeError> {
        let DrawSceneIn { photo, camera, encoding, depth, layout, masks, kinds } = inputs;
        let (width, height) = photo.0.size();
        let (width, height) = fit(width, height, self.long_side as usize);
        let camera = camera.resized(width, height);
        let mut left = resize(&photo.0, width, height).map(|c| c.min(Vec3::ONE));
        let mut right = resize(&bands(&nearness(&depth)), width, height).map(Vec3::splat);
        for half in [&mut left, &mut right] {
            draw_edges(half, &layout, &camera, false);
        }
        draw_horizon(&mut left, &layout, &camera);
        for (name, mask) in masks.iter() {
            let color = match kinds.get(name).map(|kind| **kind) {
                Some(LightKind::Window) => Vec3::new(0.0, 0.3, 1.0),
                _ => Vec3::new(1.0, 0.1, 0.0),
            };
            let inside = resize(&mask.0, width, height).map(|share| share >= TUNING.covered);
            annotate(&mut left, &inside, name, color);
        }
        let z = depth.0.pixels();
        let (near, far) =
            z.iter().fold((f32::MAX, 0.0f32), |(near, far), &z| (near.min(z), far.max(z)));
        caption(&mut right, &format!("depth {near:.2} to {far:.2} m"));
        let [_, pitch, _] = layout.camera_angles();
        ctx.note(format!("depth from {near:.2} m to {far:.2} m; pitch {pitch:.1} degrees"));
        ctx.note(layout.summary());
        let both = Plane::from_fn(2 * width, height, |x, y| {
            if x < width { left.get(x, y) } else { right.get(x - width, y) }
        });
        let bytes = write_png(&Picture(both), encoding.transfer, false);
        Ok(DrawSceneOut { files: Arc::new(Files(vec![("look.png".into(), bytes)])) })
    }
}

/// Nearness with every other band darker.
fn bands(nearness: &Plane<f32>) -> Plane<f32> {
    nearness.map(|near| {
        let is_even = (near * TUNING.bands) as i32 % 2 == 0;
        near * if is_even { 1.0 } else { TUNING.band_dim }
    })
}

/// The line of the directions that are level.
fn draw_horizon(picture: &mut Plane<Vec3>, layout: &RoomLayout, camera: &Camera) {
    let up = layout.up();
    let forward = Vec3::NEG_Z.reject_from(up);
    let ends = [-1.0, 1.0].map(|side| camera.project(forward + side * 0.5 * forward.cross(up)));
    if let [Some(from), Some(to)] = ends {
        // The line goes on to both edges of the picture.
        let along = to - from;
        let yellow = Vec3::new(1.0, 0.8, 0.0);
        draw_line(picture, from - 8.0 * along, to + 8.0 * along, yellow, TUNING.horizon_width);
    }
}

/// A line of text in the lower left corner, where it fits.
fn caption(picture: &mut Plane<Vec3>, text: &str) {
    let (width, height) = picture.size();
    let scale = (width.max(height) / 640).max(1);
    let (text_width, text_height) = text_size(text, scale);
    if text_width <= width && text_height <= height {
        let green = Vec3::new(0.05, 0.9, 0.15);
        write_text(picture, (0, height - text_height), text, green, scale);
    }
}
