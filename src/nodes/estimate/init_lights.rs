//! `InitLights`: where the lights are, without a network.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Segments, luminance};
use crate::nodes::artifacts::{Guess, INV_LAMP, INV_WINDOW};
use crate::optics::{
    Bounces, Column, Lamp, LampForm, LampForms, LayerQuality, LightKind, Receivers, RoomBox, SeenRoom, Shape,
    Transport, Window, fit_radiances, lamp_candidates, visible_light, window_candidates,
};
use crate::{params, ports};

params! {
    /// Places the lights: visible ones from their pixels and the depth, one lamp and one window out of view from a dictionary.
    ///
    /// Each candidate's unit layer, with its own shadow and its own indirect light, is fitted to the photo together with
    /// those of the visible lights and a constant ambient; the one that explains most is kept if it explains enough. A light
    /// that is not needed is `Absent`. What networks guess of a light is a candidate among the others.
    pub struct InitLights {
        /// Whether candidates of our own are tried, too; else guesses only, where there are any.
        dictionary: bool = true,
        /// Share of the unexplained part that a light out of view must explain; 0..1.
        worth: f32 = 0.08,
        /// Shadow rays per receiver and light.
        samples: usize = 4,
        /// Radiosity of what is unseen, as a multiple of the mean of what is seen; 0..=1.
        unseen: f32 = 0.5,
        /// Cost of the constant ambient, as a share of the photo's energy: what a light can explain is the light's.
        ambient_cost: f64 = 0.01,
        /// Rounds of the fit per candidate.
        turns: usize = 8,
        /// Shape of visible lamps that are no ceiling panels: `Solid` (a ball, or a box when the outline is long), `Box`, `Plates`
        /// (the seen surface, its mirror image and the ring between them), or `Likeliest` (`Solid`, unless `Plates` explain the
        /// photo better by 3 %).
        lamps: LampForm = LampForm::Solid,
        /// Most plates that a lamp of them has; 1..=512.
        plates: usize = 128,
        /// What windows look out on: `Daylight(sun, sky, ground)`, three lobes of these bandwidths, each >= 0; or `Even`, the same
        /// radiance everywhere, which is one lobe.
        outlook: Outlook = Outlook::Daylight(1e4, 1.5, 1.5),
    }
}

/// What windows look out on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outlook {
    /// The same radiance everywhere: a lamp of the window's shape.
    Even,
    /// Bandwidths of sun, sky and ground.
    Daylight(f32, f32, f32),
}

impl Outlook {
    fn through(self, shape: Shape) -> Shape {
        match (self, shape) {
            (Outlook::Even, Shape::Window(Window { center, x, y, .. })) => Shape::Lamp(Lamp::Rect { center, x, y }),
            (Outlook::Daylight(sun, sky, ground), Shape::Window(mut window)) => {
                window
                    .lobes
                    .iter_mut()
                    .zip([sun, sky, ground])
                    .for_each(|(lobe, bandwidth)| lobe.bandwidth = bandwidth);
                Shape::Window(window)
            }
            (_, shape) => shape,
        }
    }
}

ports! {
    pub input InitLightsIn {
        /// The linear photo, working size.
        photo: Arc<Picture>,
        /// Share of saturated pixels.
        clipped: Arc<Mask>,
        /// The camera at working size.
        camera: Arc<Camera>,
        /// Points of the seen surface.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// What casts shadows.
        mesh: Arc<SceneMesh>,
        /// What the receivers see.
        transport: Arc<Transport>,
        /// Albedo, for the indirect light.
        albedo: Arc<Albedo>,
        /// Pixels of one material.
        segments: Arc<Segments>,
        /// Pixels that are no part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// What each visible light is.
        kind: Gather<LightKind>,
        /// What networks say of lights, by name.
        guess: Gather<Guess>,
    }
}

ports! {
    pub output InitLightsOut {
        /// Every visible light, `inv_lamp` and `inv_window`.
        shape: Scatter<Shape>,
    }
}

impl Node for InitLights {
    const KIND: &'static str = "InitLights";
    const VERSION: u32 = 3;
    type In = InitLightsIn;
    type Out = InitLightsOut;

    fn check(&self) -> Result<(), String> {
        if !(0.0..1.0).contains(&self.worth) {
            return Err(format!("worth: wanted 0..1, got {}", self.worth));
        }
        if !(1..=1024).contains(&self.samples) {
            return Err(format!("samples: wanted 1..=1024, got {}", self.samples));
        }
        if !(0.0..=1.0).contains(&self.unseen) {
            return Err(format!("unseen: wanted 0..=1, got {}", self.unseen));
        }
        if !(1..=1000).contains(&self.turns) {
            return Err(format!("turns: wanted 1..=1000, got {}", self.turns));
        }
        if !(1..=512).contains(&self.plates) {
            return Err(format!("plates: wanted 1..=512, got {}", self.plates));
        }
        if !(self.ambient_cost >= 0.0 && self.ambient_cost.is_finite()) {
            return Err(format!("ambient_cost: wanted a number >= 0, got {}", self.ambient_cost));
        }
        if let Outlook::Daylight(sun, sky, ground) = self.outlook
            && let Some(wrong) = [sun, sky, ground].into_iter().find(|b| !(*b >= 0.0 && b.is_finite()))
        {
            return Err(format!("outlook: wanted bandwidths >= 0, got {wrong}"));
        }
        Ok(())
    }

    fn run(&self, inputs: InitLightsIn, ctx: &Context) -> Result<InitLightsOut, NodeError> {
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let scout = Scout::new(self, &inputs);
        let (points, normals): (Vec<Vec3>, Vec<Vec3>) = scout.receivers.places().into_iter().unzip();
        let room = RoomBox::around(&points, &normals);
        let forms = LampForms { form: self.lamps, plates: self.plates, ..LampForms::default() };
        let mut shapes: Vec<(String, Arc<Shape>)> = Vec::new();
        let mut layers: Vec<Vec<Vec3>> = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let kind = inputs
                .kind
                .get(id)
                .ok_or_else(|| NodeError::Failed(format!("visible light {id:?} is neither lamp nor window")))?;
            let guess = guessed(&inputs.guess, id);
            let own = if self.dictionary || guess.is_none() {
                visible_light(**kind, forms, mask, &inputs.points, &inputs.normal, &camera, room.as_ref())
            } else {
                Vec::new()
            };
            let ways = own.into_iter().map(Way::Own).chain(guess.map(Way::Guess)).collect();
            match scout.likeliest(ways, mask, &layers) {
                Some((shape, layer)) => {
                    shapes.push((id.into(), Arc::new(shape)));
                    layers.push(layer);
                }
                None => {
                    ctx.warn(format!("visible light {id:?} has no pixel at working size; it is left out"));
                    shapes.push((id.into(), Arc::new(Shape::Absent)));
                }
            }
            ctx.check_cancelled()?;
        }
        let (lamp, window) = match room {
            Some(room) => scout.out_of_view(&layers, &room, &camera, &inputs.guess, ctx)?,
            None => (Shape::Absent, Shape::Absent),
        };
        for (id, found) in [(INV_LAMP, &lamp), (INV_WINDOW, &window)] {
            if *found == Shape::Absent {
                ctx.warn(format!("no {id} is needed to explain the photo; it is left out"));
            }
        }
        shapes.push((INV_LAMP.into(), Arc::new(lamp)));
        shapes.push((INV_WINDOW.into(), Arc::new(window)));
        Ok(InitLightsOut { shape: Scatter(shapes) })
    }
}

/// Misfit that counts as much as a photo explained by the ambient alone: an ambient is no light source.
const AMBIENT_LOSS: f64 = 0.3;

/// The photo and the seen room on the receivers that take part, and how candidates are tried on them.
struct Scout<'a> {
    node: &'a InitLights,
    receivers: Receivers<'a>,
}

impl<'a> Scout<'a> {
    fn new(node: &'a InitLights, inputs: &'a InitLightsIn) -> Scout<'a> {
        let InitLightsIn { photo, clipped, points, normal, mesh, transport, albedo, segments, .. } = inputs;
        let room = SeenRoom { photo, clipped, points, normal, mesh, transport, albedo, segments };
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask).chain([&*inputs.ignore]);
        Scout { node, receivers: Receivers::new(room, masks, usize::MAX) }
    }

    /// Unit layer on the receivers in use, shadowed direct and indirect light: of a lamp, of a window as a bright rectangle, of a
    /// guessed window with the shares of its lobes. `None` for a light that is not there.
    fn layer(&self, way: &Way, own: Option<&Mask>) -> Option<Vec<Vec3>> {
        let bounces = Bounces { count: 2, unseen: self.node.unseen };
        let quality = LayerQuality { samples: self.node.samples, bounces };
        let layers = |shape: &Shape| self.receivers.layers(shape, own, quality);
        match way {
            Way::Guess(Guess { shape: shape @ Shape::Window(_), radiance, .. }) => {
                let lobes = layers(shape).into_iter().zip(&radiance.0).map(|(layer, w)| (layer.sum(), *w));
                lobes
                    .map(|(layer, w)| layer.into_iter().map(|u| u * w).collect())
                    .reduce(|a: Vec<Vec3>, b| a.into_iter().zip(b).map(|(a, b)| a + b).collect())
            }
            Way::Own(shape) | Way::Guess(Guess { shape, .. }) => Some(layers(&Shape::Lamp(flat(shape)?))[0].sum()),
        }
    }

    /// The shape of a way, windows of our own with their outlook.
    fn shape(&self, way: &Way) -> Shape {
        match way {
            Way::Own(shape) => self.node.outlook.through(shape.clone()),
            Way::Guess(guess) => guess.shape.clone(),
        }
    }

    /// How badly these layers and the ambient explain the photo: the mean misfit, and what they leave to the ambient.
    fn loss(&self, layers: &[&[Vec3]]) -> f64 {
        let mut columns: Vec<Column> = layers.iter().map(|layer| Column { layer, penalty: 0.0 }).collect();
        columns.push(Column { layer: &self.receivers.ambient, penalty: self.node.ambient_cost });
        let fit = fit_radiances(&self.receivers.evidence, &columns, self.node.turns);
        let share =
            |(column, w): (&Column, &Vec3)| -> f64 { column.layer.iter().map(|&u| f64::from(luminance(u * *w))).sum() };
        let shares: Vec<f64> = columns.iter().zip(&fit.radiance).map(share).collect();
        let total: f64 = shares.iter().sum();
        fit.loss + if total > 0.0 { AMBIENT_LOSS * shares[shares.len() - 1] / total } else { 0.0 }
    }

    /// Of several shapes for one visible light, the one that fits best beside the layers already placed; the first is kept
    /// unless another is clearly better.
    fn likeliest(&self, ways: Vec<Way>, mask: &Mask, placed: &[Vec<Vec3>]) -> Option<(Shape, Vec<Vec3>)> {
        let only = ways.len() == 1;
        let tried = ways.into_iter().enumerate().filter_map(|(i, way)| {
            let layer = self.layer(&way, Some(mask))?;
            let columns: Vec<&[Vec3]> = placed.iter().chain([&layer]).map(Vec::as_slice).collect();
            let loss = if only { 0.0 } else { self.loss(&columns) * if i == 0 { 0.97 } else { 1.0 } };
            Some((loss, way, layer))
        });
        let (_, way, layer) = tried.reduce(|a, b| if b.0 < a.0 { b } else { a })?;
        Some((self.shape(&way), layer))
    }

    /// The lamp and the window out of view, each `Absent` unless it earns its place.
    fn out_of_view(
        &self,
        visible: &[Vec<Vec3>],
        room: &RoomBox,
        camera: &Camera,
        guesses: &Gather<Guess>,
        ctx: &Context,
    ) -> Result<(Shape, Shape), NodeError> {
        let base: Vec<&[Vec3]> = visible.iter().map(Vec::as_slice).collect();
        let ways = |id: &str, own: Vec<Shape>| -> Vec<Way> {
            let guess = guessed(guesses, id);
            let own = own.into_iter().filter(|_| self.node.dictionary || guess.is_none());
            own.map(Way::Own).chain(guess.iter().cloned().map(Way::Guess)).collect()
        };
        let lamps = ways(INV_LAMP, lamp_candidates(room, camera));
        let windows = window_candidates(room, camera).into_iter().map(Shape::Window).collect();
        let lamp_count = lamps.len();
        let candidates = [lamps, ways(INV_WINDOW, windows)].concat();
        let layers: Vec<Vec<Vec3>> =
            candidates.par_iter().map(|way| self.layer(way, None).unwrap_or_default()).collect();
        ctx.check_cancelled()?;
        // The best single candidate, then the best of the other kind beside it.
        let best = |given: &[&[Vec3]], range: std::ops::Range<usize>| -> Option<(usize, f64)> {
            let losses: Vec<(usize, f64)> =
                range.into_par_iter().map(|i| (i, self.loss(&[given, &[layers[i].as_slice()]].concat()))).collect();
            losses.into_iter().reduce(|a, b| if b.1 < a.1 { b } else { a })
        };
        let enough = 1.0 - f64::from(self.node.worth);
        let mut found = (Shape::Absent, Shape::Absent);
        let mut keep = |i: usize| {
            let slot = if i < lamp_count { &mut found.0 } else { &mut found.1 };
            *slot = self.shape(&candidates[i]);
        };
        let nothing = self.loss(&base);
        if let Some((first, loss)) = best(&base, 0..candidates.len())
            && loss < enough * nothing
        {
            keep(first);
            let others = if first < lamp_count { lamp_count..candidates.len() } else { 0..lamp_count };
            let with_first = [&base, &[layers[first].as_slice()][..]].concat();
            if let Some((second, both)) = best(&with_first, others)
                && both < enough * loss
            {
                keep(second);
            }
        }
        Ok(found)
    }
}

/// A light that may be the one.
#[derive(Clone)]
enum Way {
    Own(Shape),
    Guess(Guess),
}

/// What is guessed of a light, if anything shines there.
fn guessed(guesses: &Gather<Guess>, id: &str) -> Option<Guess> {
    let guess = guesses.get(id)?;
    (guess.shape != Shape::Absent).then(|| Guess::clone(guess))
}

/// The light as a lamp of even radiance: a window, on the whole, is a bright rectangle.
fn flat(shape: &Shape) -> Option<Lamp> {
    match shape {
        Shape::Absent => None,
        Shape::Lamp(lamp) => Some(lamp.clone()),
        Shape::Window(Window { center, x, y, .. }) => Some(Lamp::Rect { center: *center, x: *x, y: *y }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Lobe;

    #[test]
    fn an_outlook_changes_windows_only() {
        let (center, x, y) = (Vec3::NEG_Z, Vec3::X * 0.5, Vec3::Y);
        let window = Shape::Window(Window { center, x, y, lobes: Window::daylight(Vec3::Z) });
        let lamp = Shape::Lamp(Lamp::Rect { center, x, y });
        assert_eq!(Outlook::Even.through(window.clone()), lamp);
        let Shape::Window(seen) = Outlook::Daylight(7.0, 5.0, 0.0).through(window.clone()) else { panic!("a window") };
        assert_eq!(seen.lobes.map(|Lobe { bandwidth, .. }| bandwidth), [7.0, 5.0, 0.0]);
        assert_eq!(InitLights::default().outlook.through(window.clone()), window, "the default is that of daylight");
        for shape in [lamp, Shape::Absent] {
            assert_eq!(Outlook::Even.through(shape.clone()), shape);
        }
        assert!(
            InitLights { outlook: Outlook::Daylight(f32::NAN, 1.0, 1.0), ..InitLights::default() }.check().is_err()
        );
    }
}
