//! `InitLights`: shapes of the lights, from geometry and the estimates of networks.

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, LayoutGuess, RoomLayout, SceneMesh};
use crate::graph::{Context, Gather, Node, NodeError, Scatter, check_range};
use crate::image::{Albedo, Mask, Normal, Picture, Points, Segments};
use crate::nodes::artifacts::{Guess, INV_LAMP, INV_WINDOW, Sun};
use crate::optics::inverse::{
    Accepted, Candidate, CandidateSearch, CandidateSettings, LampForm, LampForms, LayerQuality,
    LightPrior, Receivers, SeenRoom, lamp_candidates, visible_light, window_candidates,
};
use crate::optics::{Bounces, Lamp, LightKind, LightTransport, RectLamp, Shape, Window};
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
        min_gain: f32 = 0.07, in 0.0..1.0,
        /// Shadow rays per receiver and light.
        samples: usize = 4, in 1..=1024,
        /// Upper bound of the rays per receiver for the indirect light of a candidate, of those
        /// that `transport` has.
        rays: usize = 32, in 4..,
        /// Radiosity of the unseen part of the room, as a multiple of the mean of the seen part.
        unseen: f32 = 0.5, in 0.0..=1.0,
        /// Cost of the constant ambient, as a fraction of the photo's energy. It makes lights
        /// preferable to the ambient.
        ambient_weight: f64 = 0.01, in 0.0..,
        /// Iterations of the fit per candidate.
        iterations: usize = 8, in 1..=1000,
        /// Shape of visible lamps that are not ceiling panels: `Solid` (a sphere, or a box if the
        /// outline is long), `Box`, `Surfels` (the seen surface, its mirror image and the ring
        /// between them), or `Best` (`Solid`, unless `Surfels` have a loss lower by 3 %).
        lamps: LampForm = LampForm::Solid,
        /// Upper bound of the surfels of a lamp.
        surfels: usize = 128, in 1..=512,
        /// Emission of windows: `Daylight(sun, sky, ground)`, three lobes of these bandwidths, each
        /// >= 0; `Uniform`, constant radiance, which is one lobe; or `Best(sun, sky, ground)`,
        /// per window the former if its loss is lower by 5 %, else the latter.
        window_emission: WindowEmission = WindowEmission::Best(1e4, 1.5, 1.5),
    }
}

/// Lobes that a window emits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum WindowEmission {
    /// The same radiance everywhere: a lamp of the window's shape.
    #[serde(alias = "Even")]
    Uniform,
    /// Bandwidths of sun, sky and ground.
    Daylight(f32, f32, f32),
    /// Three lobes of these bandwidths if they lower the loss by 5 %, else the same radiance
    /// everywhere.
    #[serde(alias = "Likeliest")]
    Best(f32, f32, f32),
}

impl WindowEmission {
    /// The shape with this emission, and a second one with sun, sky and ground where both are to be
    /// tried. A window through which the photo shows the `sun` has all three. A lamp stays.
    fn through(self, shape: &Shape, sun: Option<Vec3>) -> (Shape, Option<Shape>) {
        let Shape::Window(window) = shape else { return (shape.clone(), None) };
        let &Window { center, x, y, .. } = window;
        let even = Shape::Lamp(Lamp::Rect(RectLamp { center, x, y }));
        let daylight = |bandwidths: [f32; 3]| {
            let mut window = window.clone();
            window
                .lobes
                .iter_mut()
                .zip(bandwidths)
                .for_each(|(lobe, bandwidth)| lobe.bandwidth = bandwidth);
            window.lobes[0].direction = sun.unwrap_or(window.lobes[0].direction);
            Shape::Window(window)
        };
        match self {
            WindowEmission::Uniform => (even, None),
            WindowEmission::Best(a, b, c) if sun.is_none() => (even, Some(daylight([a, b, c]))),
            WindowEmission::Daylight(a, b, c) | WindowEmission::Best(a, b, c) => {
                (daylight([a, b, c]), None)
            }
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
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// Estimates of lights by networks, by name.
        guess: Gather<Guess>,
        /// The sun whose light the photo shows. `photo` is without its direct light.
        sun: Option<Arc<Sun>>,
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
    const VERSION: u32 = 10;
    type In = InitLightsIn;
    type Out = InitLightsOut;

    fn check_consistency(&self) -> Result<(), String> {
        match self.window_emission {
            WindowEmission::Daylight(sun, sky, ground) | WindowEmission::Best(sun, sky, ground) => {
                check_range("window_emission", &[sun, sky, ground], 0.0..)
            }
            WindowEmission::Uniform => Ok(()),
        }
    }

    fn run(&self, inputs: InitLightsIn, ctx: &Context) -> Result<InitLightsOut, NodeError> {
        let transport = inputs.transport.thinned(self.rays);
        let InitLightsIn { photo, clipped, points, normal, mesh, albedo, segments, .. } = &inputs;
        let seen = SeenRoom {
            photo,
            clipped,
            points,
            normal,
            mesh,
            transport: &transport,
            layout: inputs.layout.as_deref(),
            albedo,
            segments,
        };
        let masks = inputs.mask.iter().map(|(_, mask)| &**mask).chain([&*inputs.ignore]);
        let search = CandidateSearch::new(Receivers::new(seen, masks, usize::MAX), self.settings());
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let find = || RoomLayout::find(mesh, points, normal, &camera, &LayoutGuess::default());
        let found = inputs.layout.is_none().then(find);
        let room = inputs.layout.as_deref().or(found.as_ref());
        let (mut accepted, twins) = self.visible(&inputs, &search, room, ctx)?;
        if let Some(room) = room {
            accepted.extend(self.out_of_view(&inputs, &search, room, &accepted, ctx)?);
        }
        let shapes = search.shapes(&accepted, |light, shape| {
            let sun = inputs.sun.as_ref().and_then(|sun| sun.through(light));
            self.window_emission.through(shape, sun)
        });
        let shape = |id: &str| {
            let twin = || twins.iter().find(|(twin, _)| *twin == id).map(|(_, first)| *first);
            let found = accepted
                .iter()
                .position(|light| light.id == id)
                .or_else(twin)
                .map(|i| shapes[i].clone());
            if found.is_none() && [INV_LAMP, INV_WINDOW].contains(&id) {
                ctx.warn(format!("the photo is explained without {id}; it is left out"));
            }
            (id.to_owned(), Arc::new(found.unwrap_or(Shape::Absent)))
        };
        let ids = inputs.mask.iter().map(|(id, _)| id).chain([INV_LAMP, INV_WINDOW]);
        ctx.count_rays(search.receivers().rays());
        let (fits, columns) = search.counts();
        ctx.note(format!("{fits} fits of candidates with {columns} columns in all"));
        Ok(InitLightsOut { shape: Scatter(ids.map(shape).collect()) })
    }
}

impl InitLights {
    /// Settings of the search for candidates.
    fn settings(&self) -> CandidateSettings {
        let bounces = Bounces { count: TUNING.bounces, unseen: self.unseen };
        CandidateSettings {
            quality: LayerQuality { samples: self.samples, bounces },
            prior: LightPrior {
                ambient: self.ambient_weight,
                hue_weight: 0.0,
                residual_weight: TUNING.residual_weight,
                // `min_gain` decides over lights out of view, and three lobes must lower the loss
                // by 5 %.
                // The last fit decides which lamps are off.
                unlit: 0.0,
                out_of_view: 0.0,
                sun: 0.0,
                // Candidates are compared by how well they explain the photo.
                tikhonov_weight: 0.0,
            },
            iterations: self.iterations,
            min_gain: f64::from(self.min_gain),
        }
    }

    /// Candidates for a light: those from the geometry, if they are requested or no network has an
    /// estimate, and the estimate.
    fn candidates(
        &self,
        guess: Option<&Guess>,
        geometric: impl FnOnce() -> Vec<Shape>,
    ) -> Vec<Candidate> {
        let guess = guess.filter(|guess| guess.shape != Shape::Absent);
        let geometric = if self.dictionary || guess.is_none() { geometric() } else { Vec::new() };
        let estimate =
            guess.map(|guess| Candidate::Estimate(guess.shape.clone(), guess.radiance.clone()));
        geometric.into_iter().map(Candidate::Shape).chain(estimate).collect()
    }

    /// The visible lights, each beside those before it, and the names of lights that have the shape
    /// of another: those of one kind with the same pixels and the same estimate.
    fn visible<'a>(
        &self,
        inputs: &'a InitLightsIn,
        search: &CandidateSearch,
        room: Option<&RoomLayout>,
        ctx: &Context,
    ) -> Result<(Vec<Accepted<'a>>, Twins<'a>), NodeError> {
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let forms =
            LampForms { form: self.lamps, most_surfels: self.surfels, ..LampForms::default() };
        let (mut accepted, mut twins): (Vec<Accepted>, Twins) = Default::default();
        for (id, mask) in inputs.mask.iter() {
            let is_twin = |light: &Accepted| {
                let same = (inputs.kind.get(light.id), inputs.guess.get(light.id))
                    == (inputs.kind.get(id), inputs.guess.get(id));
                same && light.mask == Some(&**mask)
            };
            if let Some(first) = accepted.iter().position(is_twin) {
                twins.push((id, first));
                continue;
            }
            let kind = inputs.kind.get(id).ok_or_else(|| {
                NodeError::Failed(format!("visible light {id:?} is neither lamp nor window"))
            })?;
            let geometric = || {
                visible_light(**kind, forms, mask, &inputs.points, &inputs.normal, &camera, room)
            };
            let candidates = self.candidates(inputs.guess.get(id).map(|guess| &**guess), geometric);
            match search.select(id, candidates, mask, &accepted) {
                Some(light) => accepted.push(light),
                None => ctx.warn(format!(
                    "visible light {id:?} has no pixel at working size; it is left out"
                )),
            }
            ctx.check_cancelled()?;
        }
        Ok((accepted, twins))
    }

    /// The lamp and the window out of view, if they lower the loss enough.
    fn out_of_view(
        &self,
        inputs: &InitLightsIn,
        search: &CandidateSearch,
        room: &RoomLayout,
        visible: &[Accepted],
        ctx: &Context,
    ) -> Result<Vec<Accepted<'static>>, NodeError> {
        let camera = inputs.camera.resized(inputs.photo.0.width(), inputs.photo.0.height());
        let guess = |id: &str| inputs.guess.get(id).map(|guess| &**guess);
        let seen: Vec<&Window> = visible
            .iter()
            .filter_map(|light| match light.shape() {
                Shape::Window(window) => Some(window),
                Shape::Lamp(_) | Shape::Absent => None,
            })
            .collect();
        let windows =
            || window_candidates(room, &camera, &seen).into_iter().map(Shape::Window).collect();
        let lamps = self.candidates(guess(INV_LAMP), || lamp_candidates(room, &camera));
        let windows = self.candidates(guess(INV_WINDOW), windows);
        let (lamps, windows) = (search.trace(lamps, None), search.trace(windows, None));
        ctx.check_cancelled()?;
        Ok(search.select_out_of_view((INV_LAMP, lamps), (INV_WINDOW, windows), visible))
    }
}

tuning! {
    /// Constants of `InitLights`.
    pub const TUNING: InitLightsTuning {
        /// Loss of a photo that the ambient light alone explains.
        residual_weight: f64 = 0.3,
            unit "mean of log(1 + r^2)", source Measured("rooms of docs/accuracy.md"),
            effect "a larger value accepts more lights";
        /// Bounces of the indirect light of a candidate.
        bounces: usize = 2,
            unit "bounces", source Measured("run time; no page records it"),
            effect "a smaller value underestimates indirect light";
    }
}

/// Names of lights, each with the index of the accepted light whose shape it shares.
type Twins<'a> = Vec<(&'a str, usize)>;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Lobe;

    #[test]
    fn window_emission_changes_windows_only() {
        let (center, x, y) = (Vec3::NEG_Z, Vec3::X * 0.5, Vec3::Y);
        let window =
            Shape::Window(Window { center, x, y, lobes: Window::daylight(Vec3::Z, Vec3::Y) });
        let lamp = Shape::Lamp(Lamp::Rect(RectLamp { center, x, y }));
        let one = |emission: WindowEmission, shape: &Shape| emission.through(shape, None);
        assert_eq!(one(WindowEmission::Uniform, &window), (lamp.clone(), None));
        let (Shape::Window(seen), None) = one(WindowEmission::Daylight(7.0, 5.0, 0.0), &window)
        else {
            panic!("a window")
        };
        assert_eq!(seen.lobes.map(|Lobe { bandwidth, .. }| bandwidth), [7.0, 5.0, 0.0]);
        let both = (lamp.clone(), Some(window.clone()));
        assert_eq!(
            one(InitLights::default().window_emission, &window),
            both,
            "the default tries both"
        );
        for shape in [lamp, Shape::Absent] {
            assert_eq!(one(InitLights::default().window_emission, &shape), (shape.clone(), None));
        }
        assert!(
            InitLights {
                window_emission: WindowEmission::Daylight(f32::NAN, 1.0, 1.0),
                ..InitLights::default()
            }
            .check()
            .is_err()
        );
    }
}
