//! `FindSun`: sunlight that the photo shows.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Camera, RoomLayout, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Mask, Normal, Picture, Plane, Points, dilate};
use crate::nodes::artifacts::{Sun, Sunlight, same_size};
use crate::optics::inverse::{
    FoundSun, LampForms, OBSERVATIONS, SunWindow, SunlitRoom, drawn_sun, find_sun, visible_light,
};
use crate::optics::{LightKind, Shape};
use crate::{params, ports};

params! {
    /// Finds the sun whose light the photo shows on the surfaces of the room: its direction, and
    /// the pixels that it lights through each window in view.
    ///
    /// The direction is found from the rectangles of the windows, which may go on out of view, and
    /// the pixels by a minimum cut (see `optics::inverse::find_sun`). A photo without such light,
    /// or without a window in view, passes unchanged. A drawing by a person replaces the search for
    /// the pixels.
    pub struct FindSun {
        /// Least r^2 between the steps of log luminance within surfaces and those of the sunlight
        /// through the windows.
        min_explained: f64 = 0.048, in 0.0..=1.0,
    }
}

ports! {
    pub input FindSunIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// The camera at working size.
        camera: Arc<Camera>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The mesh of the room, which casts shadows.
        mesh: Arc<SceneMesh>,
        /// The cuboid of the room, whose sides are places for windows.
        layout: Option<Arc<RoomLayout>>,
        /// Pixels that are not part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// Pixels lit by the sun, drawn by a person, working size; all 0 for a photo without
        /// sunlight. Without a drawing it is empty or missing.
        drawn: Option<Arc<Mask>>,
    }
}

ports! {
    pub output FindSunOut {
        /// The photo without the direct light of the sun.
        photo: Arc<Picture>,
        /// The sun, and the windows through which it shines.
        sun: Arc<Sun>,
        /// The pixels that it lights through each visible light; none through lamps.
        sunlight: Scatter<Sunlight>,
    }
}

impl Node for FindSun {
    const KIND: &'static str = "FindSun";
    const VERSION: u32 = 5;
    type In = FindSunIn;
    type Out = FindSunOut;

    fn run(&self, inputs: FindSunIn, ctx: &Context) -> Result<FindSunOut, NodeError> {
        let size = inputs.photo.0.size();
        same_size("points", inputs.points.0.size(), "photo", size)?;
        same_size("normal", inputs.normal.0.size(), "photo", size)?;
        let windows = windows(&inputs);
        let (ids, windows): (Vec<&str>, Vec<SunWindow>) = windows.into_iter().unzip();
        let drawn = inputs.drawn.as_deref().filter(|drawn| !drawn.0.is_empty());
        if let Some(drawn) = drawn {
            same_size("drawn", drawn.0.size(), "photo", size)?;
        }
        let found = self.search(&inputs, &windows, drawn);
        ctx.check_cancelled()?;
        if found.is_none() && drawn.is_some_and(is_sunny) {
            ctx.warn(
                "the pixels that `sunlight` marks are not used: no window in view lets the sun through to them, or \
                they are too few"
                    .to_owned(),
            );
        }
        let lit = |id: &str| -> Option<&Plane<f32>> {
            let lit = &found.as_ref()?.lit[ids.iter().position(|window| *window == id)?];
            lit.pixels().iter().any(|&lit| lit > 0.0).then_some(lit)
        };
        let sunlight = |id: &str| match (lit(id), &found) {
            (Some(lit), Some(found)) => Sunlight { direction: found.direction, lit: lit.clone() },
            _ => Sunlight::none(),
        };
        let lights = inputs.mask.iter().map(|(id, _)| id);
        let sunlight = Scatter(lights.map(|id| (id.to_owned(), Arc::new(sunlight(id)))).collect());
        let Some(found) = &found else {
            let (photo, sun) = (Arc::clone(&inputs.photo), Arc::new(Sun::default()));
            return Ok(FindSunOut { photo, sun, sunlight });
        };
        let pixels: f32 = found.lit.iter().flat_map(|lit| lit.pixels()).sum();
        ctx.note(format!(
            "the sun lights {:.1} % of the photo, {:.1} times as bright as all other light, r^2 {:.2}",
            100.0 * pixels / (size.0 * size.1) as f32,
            found.ratio.element_sum() / 3.0,
            found.explained
        ));
        let windows = ids.iter().filter(|id| lit(id).is_some()).map(|&id| id.to_owned()).collect();
        let sun = Arc::new(Sun { direction: found.direction, windows });
        let photo = Arc::new(without(found, &inputs.photo, &inputs.normal));
        Ok(FindSunOut { photo, sun, sunlight })
    }
}

/// The visible windows with their preferred rectangles.
fn windows(inputs: &FindSunIn) -> Vec<(&str, SunWindow<'_>)> {
    let FindSunIn { photo, points, normal, .. } = inputs;
    let camera = inputs.camera.resized(photo.0.width(), photo.0.height());
    let layout = inputs.layout.as_deref();
    let window = |(id, mask)| {
        let kind = inputs.kind.get(id).filter(|kind| ***kind == LightKind::Window)?;
        let shapes =
            visible_light(**kind, LampForms::default(), mask, points, normal, &camera, layout);
        match shapes.into_iter().next() {
            Some(Shape::Window(window)) => Some((id, SunWindow { window, mask })),
            _ => None,
        }
    };
    inputs.mask.iter().map(|(id, mask)| (id, &**mask)).filter_map(window).collect()
}

impl FindSun {
    fn search(
        &self,
        inputs: &FindSunIn,
        windows: &[SunWindow],
        drawn: Option<&Mask>,
    ) -> Option<FoundSun> {
        if windows.is_empty() || drawn.is_some_and(|drawn| !is_sunny(drawn)) {
            return None;
        }
        let FindSunIn { photo, points, normal, mesh, .. } = inputs;
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask).chain([&*inputs.ignore]);
        let outside = &dilate(masks, photo.0.size(), OBSERVATIONS.margin);
        let up = inputs.layout.as_deref().map_or(Vec3::Y, RoomLayout::up);
        let room = SunlitRoom { photo, points, normal, mesh, outside, up };
        match drawn {
            Some(drawn) => drawn_sun(&room, windows, drawn),
            None => find_sun(&room, windows, self.min_explained),
        }
    }
}

/// Whether the drawing marks a pixel.
fn is_sunny(drawn: &Mask) -> bool {
    drawn.0.pixels().iter().any(|&lit| lit > 0.0)
}

/// The photo without the direct light of the sun: with k the ratio of the sun to the other light, c
/// the cosine to the sun and v the lit fraction, `I / (1 + k c v)`.
fn without(sun: &FoundSun, photo: &Picture, normal: &Normal) -> Picture {
    let (w, h) = photo.0.size();
    let pixel = |i: usize| {
        let lit: f32 = sun.lit.iter().map(|lit| lit.pixels()[i]).sum();
        let cosine = normal.0.pixels()[i].dot(sun.direction).max(0.0);
        photo.0.pixels()[i] / (Vec3::ONE + sun.ratio * (cosine * lit))
    };
    Picture(Plane::new(w, h, (0..w * h).map(pixel).collect()))
}
