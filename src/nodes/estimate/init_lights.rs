//! `InitLights`: where the lights are, without a network.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, Scatter, check_range};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Segments, luminance};
use crate::nodes::artifacts::{Guess, INV_LAMP, INV_WINDOW};
use crate::optics::{
    Bounces, Column, Lamp, LampForm, LampForms, LayerQuality, LightKind, RadianceFit, Receivers, RoomBox, SeenRoom,
    Shape, Transport, UnitLayer, Window, fit_radiances, lamp_candidates, visible_light, window_candidates,
};
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Estimates the shapes of the lights: visible ones from their pixels and the depth, one lamp
    /// and one window out of view from a dictionary of candidates.
    ///
    /// The unit layer of each candidate, with shadows and indirect light, is fitted to the photo
    /// together with those of the visible lights and a constant ambient. The candidate with the
    /// least loss is kept if it saves enough. A light that is not needed is `Absent`. A network's
    /// guess is one of the candidates. Lights of one kind with the same mask have one shape, which
    /// is estimated once.
    pub struct InitLights {
        /// Whether the dictionary's candidates are tried; if not, only the networks' guesses are,
        /// where there are any.
        dictionary: bool = true,
        /// Least fraction of the loss that a light out of view must save.
        worth: f32 = 0.08, in 0.0..1.0,
        /// Shadow rays per receiver and light.
        samples: usize = 4, in 1..=1024,
        /// Upper bound of the rays per receiver for the indirect light of a candidate, of those
        /// that `transport` has.
        rays: usize = 32, in 4..,
        /// Radiosity of the unseen part of the room, as a multiple of the mean of the seen part.
        unseen: f32 = 0.5, in 0.0..=1.0,
        /// Cost of the constant ambient, as a fraction of the photo's energy. It makes lights
        /// preferable to the ambient.
        ambient_cost: f64 = 0.01, in 0.0..,
        /// Iterations of the fit per candidate.
        turns: usize = 8, in 1..=1000,
        /// Shape of visible lamps that are not ceiling panels: `Solid` (a sphere, or a box if the
        /// outline is long), `Box`, `Plates` (the seen surface, its mirror image and the ring
        /// between them), or `Likeliest` (`Solid`, unless `Plates` have a loss lower by 3 %).
        lamps: LampForm = LampForm::Solid,
        /// Upper bound of the plates of a lamp.
        plates: usize = 128, in 1..=512,
        /// Emission of windows: `Daylight(sun, sky, ground)`, three lobes of these bandwidths, each
        /// >= 0; `Even`, constant radiance, which is one lobe; or `Likeliest(sun, sky, ground)`,
        /// per window the former if its loss is lower by 5 %, else the latter.
        outlook: Outlook = Outlook::Likeliest(1e4, 1.5, 1.5),
    }
}

/// What windows look out on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outlook {
    /// The same radiance everywhere: a lamp of the window's shape.
    Even,
    /// Bandwidths of sun, sky and ground.
    Daylight(f32, f32, f32),
    /// The one of both that the photo asks for.
    Likeliest(f32, f32, f32),
}

impl Outlook {
    /// The window, if it is one, as it may be: the simplest first.
    fn through(self, shape: &Shape) -> Vec<Shape> {
        let Shape::Window(window) = shape else { return vec![shape.clone()] };
        let &Window { center, x, y, .. } = window;
        let even = Shape::Lamp(Lamp::Rect { center, x, y });
        let daylight = |bandwidths: [f32; 3]| {
            let mut window = window.clone();
            window.lobes.iter_mut().zip(bandwidths).for_each(|(lobe, bandwidth)| lobe.bandwidth = bandwidth);
            Shape::Window(window)
        };
        match self {
            Outlook::Even => vec![even],
            Outlook::Daylight(sun, sky, ground) => vec![daylight([sun, sky, ground])],
            Outlook::Likeliest(sun, sky, ground) => vec![even, daylight([sun, sky, ground])],
        }
    }
}

ports! {
    pub input InitLightsIn {
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
        /// The shadow casters.
        mesh: Arc<SceneMesh>,
        /// Rays of the receivers.
        transport: Arc<Transport>,
        /// Albedo, for the indirect light.
        albedo: Arc<Albedo>,
        /// Segments of one material each.
        segments: Arc<Segments>,
        /// Pixels that are not part of the room.
        ignore: Arc<Mask>,
        /// Pixels of each visible light.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// The networks' guesses, by light.
        guess: Gather<Guess>,
    }
}

ports! {
    pub output InitLightsOut {
        /// The shape of every visible light, of `inv_lamp` and of `inv_window`.
        shape: Scatter<Shape>,
    }
}

impl Node for InitLights {
    const KIND: &'static str = "InitLights";
    const VERSION: u32 = 5;
    type In = InitLightsIn;
    type Out = InitLightsOut;

    fn check_consistency(&self) -> Result<(), String> {
        match self.outlook {
            Outlook::Daylight(sun, sky, ground) | Outlook::Likeliest(sun, sky, ground) => {
                check_range("outlook", &[sun, sky, ground], 0.0..)
            }
            Outlook::Even => Ok(()),
        }
    }

    fn run(&self, inputs: InitLightsIn, ctx: &Context) -> Result<InitLightsOut, NodeError> {
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let transport = inputs.transport.thinned(self.rays);
        let scout = Scout::new(self, &inputs, &transport);
        let (points, normals): (Vec<Vec3>, Vec<Vec3>) = scout.receivers.places().into_iter().unzip();
        let room = RoomBox::around(&points, &normals);
        let forms = LampForms { form: self.lamps, plates: self.plates, ..LampForms::default() };
        let mut placed: Vec<Placed> = Vec::new();
        let mut twins: Vec<(&str, usize)> = Vec::new();
        for (id, mask) in inputs.mask.iter() {
            let is_twin = |light: &Placed| {
                let same = (inputs.kind.get(light.id), inputs.guess.get(light.id))
                    == (inputs.kind.get(id), inputs.guess.get(id));
                same && light.own == Some(&**mask)
            };
            if let Some(first) = placed.iter().position(is_twin) {
                twins.push((id, first));
                continue;
            }
            let kind = inputs
                .kind
                .get(id)
                .ok_or_else(|| NodeError::Failed(format!("visible light {id:?} is neither lamp nor window")))?;
            let own = || visible_light(**kind, forms, mask, &inputs.points, &inputs.normal, &camera, room.as_ref());
            match scout.likeliest(id, scout.ways(id, own), mask, &placed) {
                Some(light) => placed.push(light),
                None => ctx.warn(format!("visible light {id:?} has no pixel at working size; it is left out")),
            }
            ctx.check_cancelled()?;
        }
        if let Some(room) = room {
            let unseen = scout.out_of_view(&placed, &room, &camera, ctx)?;
            placed.extend(unseen);
        }
        let shapes = scout.shapes(&placed);
        let shape = |id: &str| {
            let twin = || twins.iter().find(|(twin, _)| *twin == id).map(|(_, first)| *first);
            let found = placed.iter().position(|light| light.id == id).or_else(twin).map(|i| shapes[i].clone());
            if found.is_none() && [INV_LAMP, INV_WINDOW].contains(&id) {
                ctx.warn(format!("no {id} is needed to explain the photo; it is left out"));
            }
            (id.to_owned(), Arc::new(found.unwrap_or(Shape::Absent)))
        };
        let ids = inputs.mask.iter().map(|(id, _)| id).chain([INV_LAMP, INV_WINDOW]);
        ctx.count_rays(scout.receivers.rays());
        let (fits, columns) = (scout.fits.into_inner(), scout.columns.into_inner());
        ctx.note(format!("{fits} fits of candidates with {columns} columns in all"));
        Ok(InitLightsOut { shape: Scatter(ids.map(shape).collect()) })
    }
}

tuning! {
    /// Constants of the candidate search of `InitLights`.
    pub const TUNING: InitLightsTuning {
        /// Loss of a photo that the ambient alone explains, as an ambient is not a light source.
        ambient_loss: f64 = 0.3,
            unit "mean misfit", source Taste, effect "a larger value prefers candidates that replace more of the ambient";
        /// Upper bound of the lights with a column each beside a candidate; more are summed into one column.
        max_columns: usize = 16,
            unit "lights", source Taste, effect "a larger value costs more time in scenes with many lights";
        /// Factor of the first shape's loss among the shapes of a visible light.
        first_shape_loss: f64 = 0.97,
            unit "1", source Taste, effect "a smaller value keeps the first shape (`Solid`) more often";
        /// Greatest ratio of losses at which a window gets lobes for sun, sky and ground.
        max_window_loss: f64 = 0.95,
            unit "1", source Measured("docs/estimation.md"), effect "a larger value gives more windows three lobes";
        /// Iterations of the fits whose losses decide a window's lobes, as more lobes converge more slowly.
        window_iterations: usize = 60,
            unit "iterations", source Taste, effect "a smaller value prefers windows of one lobe";
        /// Bounces of the indirect light of a candidate.
        bounces: usize = 2,
            unit "bounces", source Taste, effect "a larger value costs more time";
    }
}

/// The photo and the seen room on the receivers that take part, and how candidates are tried on them.
struct Scout<'a> {
    node: &'a InitLights,
    guess: &'a Gather<Guess>,
    receivers: Receivers<'a>,
    /// Fits done, and the columns of all of them.
    fits: AtomicUsize,
    columns: AtomicUsize,
}

/// A light that the photo needs.
struct Placed<'a> {
    id: &'a str,
    way: Way,
    /// Its pixels.
    own: Option<&'a Mask>,
    /// Its unit layer, of a window as a bright rectangle.
    layer: Vec<Vec3>,
}

impl<'a> Scout<'a> {
    fn new(node: &'a InitLights, inputs: &'a InitLightsIn, transport: &'a Transport) -> Scout<'a> {
        let InitLightsIn { photo, clipped, points, normal, mesh, albedo, segments, .. } = inputs;
        let room = SeenRoom { photo, clipped, points, normal, mesh, transport, albedo, segments };
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask).chain([&*inputs.ignore]);
        let receivers = Receivers::new(room, masks, usize::MAX);
        Scout { node, guess: &inputs.guess, receivers, fits: AtomicUsize::new(0), columns: AtomicUsize::new(0) }
    }

    /// Layers of lights as a candidate is fitted beside them: of more than [`InitLightsTuning::max_columns`] their sum, each with the radiance that it has
    /// among them.
    fn beside<'b>(&self, layers: Vec<&'b [Vec3]>) -> Vec<Cow<'b, [Vec3]>> {
        if layers.len() <= TUNING.max_columns {
            return layers.into_iter().map(Cow::Borrowed).collect();
        }
        let radiance = self.fit(&layers, self.node.turns).1.radiance;
        let sum = |p: usize| layers.iter().zip(&radiance).map(|(layer, w)| layer[p] * w).sum::<Vec3>();
        vec![Cow::Owned((0..self.receivers.ambient.len()).map(sum).collect())]
    }

    /// What a light may be: our own candidates, where they are wanted or nothing is guessed of it, and the guess.
    fn ways(&self, id: &str, own: impl FnOnce() -> Vec<Shape>) -> Vec<Way> {
        let guess = self.guess.get(id).filter(|guess| guess.shape != Shape::Absent);
        let own = if self.node.dictionary || guess.is_none() { own() } else { Vec::new() };
        own.into_iter().map(Way::Own).chain(guess.map(|guess| Way::Guess(Guess::clone(guess)))).collect()
    }

    /// Unit layers of the lobes on the receivers in use: shadowed direct and indirect light.
    fn lobes(&self, shape: &Shape, own: Option<&Mask>) -> Vec<Vec<Vec3>> {
        let bounces = Bounces { count: TUNING.bounces, unseen: self.node.unseen };
        let layers = self.receivers.layers(shape, own, LayerQuality { samples: self.node.samples, bounces });
        layers.iter().map(UnitLayer::sum).collect()
    }

    /// Unit layer of a lamp, of a window as a bright rectangle, of a guessed window with the shares of its lobes. `None` for a
    /// light that is not there.
    fn layer(&self, way: &Way, own: Option<&Mask>) -> Option<Vec<Vec3>> {
        match way {
            Way::Guess(Guess { shape: shape @ Shape::Window(_), radiance, .. }) => {
                let lobes = self.lobes(shape, own).into_iter().zip(&radiance.0);
                lobes
                    .map(|(layer, w)| layer.into_iter().map(|u| u * w).collect())
                    .reduce(|a: Vec<Vec3>, b| a.into_iter().zip(b).map(|(a, b)| a + b).collect())
            }
            Way::Own(shape) | Way::Guess(Guess { shape, .. }) => {
                self.lobes(&Shape::Lamp(flat(shape)?), own).into_iter().next()
            }
        }
    }

    /// The shapes of the lights: windows of our own with their outlook, of two the one that the photo asks for.
    fn shapes(&self, placed: &[Placed]) -> Vec<Shape> {
        let mut columns: Vec<Vec<Vec<Vec3>>> = placed.iter().map(|light| vec![light.layer.clone()]).collect();
        let loss = |columns: &[Vec<Vec<Vec3>>], i: usize| {
            if columns.len() <= TUNING.max_columns {
                return self
                    .loss(&columns.iter().flatten().map(Vec::as_slice).collect::<Vec<_>>(), TUNING.window_iterations);
            }
            let others = placed.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, light)| light.layer.as_slice());
            let others = self.beside(others.collect());
            let own = columns[i].iter().map(Vec::as_slice);
            self.loss(&others.iter().map(|layer| &**layer).chain(own).collect::<Vec<_>>(), TUNING.window_iterations)
        };
        let mut shape = |(i, light): (usize, &Placed)| match &light.way {
            Way::Guess(guess) => guess.shape.clone(),
            Way::Own(shape) => {
                let mut ways = self.node.outlook.through(shape).into_iter();
                let first = ways.next().expect("there is a way for each shape");
                ways.fold(first, |plain, rich| {
                    let before = loss(&columns, i);
                    let one = std::mem::replace(&mut columns[i], self.lobes(&rich, light.own));
                    let after = loss(&columns, i);
                    if after < TUNING.max_window_loss * before {
                        rich
                    } else {
                        columns[i] = one;
                        plain
                    }
                })
            }
        };
        placed.iter().enumerate().map(&mut shape).collect()
    }

    /// The layers and, as the last column, the ambient, fitted to the photo.
    fn fit<'b>(&'b self, layers: &[&'b [Vec3]], turns: usize) -> (Vec<Column<'b>>, RadianceFit) {
        let mut columns: Vec<Column> = layers.iter().map(|layer| Column { layer, penalty: 0.0, pull: 0.0 }).collect();
        columns.push(Column { layer: &self.receivers.ambient, penalty: self.node.ambient_cost, pull: 0.0 });
        let fit = fit_radiances(&self.receivers.evidence, &columns, turns);
        self.fits.fetch_add(1, Ordering::Relaxed);
        self.columns.fetch_add(columns.len(), Ordering::Relaxed);
        (columns, fit)
    }

    /// How badly these layers and the ambient explain the photo: the mean misfit, and what they leave to the ambient.
    fn loss(&self, layers: &[&[Vec3]], turns: usize) -> f64 {
        let (columns, fit) = self.fit(layers, turns);
        let share =
            |(column, w): (&Column, &Vec3)| -> f64 { column.layer.iter().map(|&u| f64::from(luminance(u * *w))).sum() };
        let shares: Vec<f64> = columns.iter().zip(&fit.radiance).map(share).collect();
        let total: f64 = shares.iter().sum();
        fit.loss + if total > 0.0 { TUNING.ambient_loss * shares[shares.len() - 1] / total } else { 0.0 }
    }

    /// Of several shapes for one visible light, the one that fits best beside the lights already placed; the first is kept
    /// unless another is clearly better.
    fn likeliest<'b>(&self, id: &'b str, ways: Vec<Way>, mask: &'b Mask, placed: &[Placed]) -> Option<Placed<'b>> {
        let only = ways.len() == 1;
        let others = if only { Vec::new() } else { self.beside(placed.iter().map(|light| &*light.layer).collect()) };
        let tried = ways.into_iter().enumerate().filter_map(|(i, way)| {
            let layer = self.layer(&way, Some(mask))?;
            let columns: Vec<&[Vec3]> = others.iter().map(|other| &**other).chain([&*layer]).collect();
            let loss = if only {
                0.0
            } else {
                self.loss(&columns, self.node.turns) * if i == 0 { TUNING.first_shape_loss } else { 1.0 }
            };
            Some((loss, Placed { id, way, own: Some(mask), layer }))
        });
        Some(tried.reduce(|a, b| if b.0 < a.0 { b } else { a })?.1)
    }

    /// The lamp and the window out of view, as far as they earn their places.
    fn out_of_view(
        &self,
        visible: &[Placed],
        room: &RoomBox,
        camera: &Camera,
        ctx: &Context,
    ) -> Result<Vec<Placed<'static>>, NodeError> {
        let base = self.beside(visible.iter().map(|light| &*light.layer).collect());
        let base: Vec<&[Vec3]> = base.iter().map(|layer| &**layer).collect();
        let windows = || window_candidates(room, camera).into_iter().map(Shape::Window).collect();
        let lamps = self.ways(INV_LAMP, || lamp_candidates(room, camera));
        let lamp_count = lamps.len();
        let candidates = [lamps, self.ways(INV_WINDOW, windows)].concat();
        let layers: Vec<Vec<Vec3>> =
            candidates.par_iter().map(|way| self.layer(way, None).unwrap_or_default()).collect();
        ctx.check_cancelled()?;
        // The best single candidate, then the best of the other kind beside it.
        let best = |given: &[&[Vec3]], range: std::ops::Range<usize>| -> Option<(usize, f64)> {
            let losses: Vec<(usize, f64)> = range
                .into_par_iter()
                .map(|i| (i, self.loss(&[given, &[layers[i].as_slice()]].concat(), self.node.turns)))
                .collect();
            losses.into_iter().reduce(|a, b| if b.1 < a.1 { b } else { a })
        };
        let enough = 1.0 - f64::from(self.node.worth);
        let mut found = Vec::new();
        if let Some((first, loss)) = best(&base, 0..candidates.len())
            && loss < enough * self.loss(&base, self.node.turns)
        {
            found.push(first);
            let others = if first < lamp_count { lamp_count..candidates.len() } else { 0..lamp_count };
            let with_first = [&base, &[layers[first].as_slice()][..]].concat();
            let second = best(&with_first, others).filter(|(_, both)| *both < enough * loss);
            found.extend(second.map(|(second, _)| second));
        }
        let light = |i: usize| Placed {
            id: if i < lamp_count { INV_LAMP } else { INV_WINDOW },
            way: candidates[i].clone(),
            own: None,
            layer: layers[i].clone(),
        };
        Ok(found.into_iter().map(light).collect())
    }
}

/// A light that may be the one.
#[derive(Clone)]
enum Way {
    Own(Shape),
    Guess(Guess),
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
        let one = |outlook: Outlook, shape: &Shape| outlook.through(shape);
        assert_eq!(one(Outlook::Even, &window), vec![lamp.clone()]);
        let [Shape::Window(seen)] = &one(Outlook::Daylight(7.0, 5.0, 0.0), &window)[..] else { panic!("a window") };
        assert_eq!(seen.lobes.map(|Lobe { bandwidth, .. }| bandwidth), [7.0, 5.0, 0.0]);
        assert_eq!(one(InitLights::default().outlook, &window), [lamp.clone(), window], "the default tries both");
        for shape in [lamp, Shape::Absent] {
            assert_eq!(one(InitLights::default().outlook, &shape), vec![shape.clone()]);
        }
        assert!(
            InitLights { outlook: Outlook::Daylight(f32::NAN, 1.0, 1.0), ..InitLights::default() }.check().is_err()
        );
    }
}
