//! Search for the lights that a photo needs: each candidate is fitted beside the lights that are
//! already accepted.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::{
    Column, LayerQuality, LightPrior, RadianceFit, Receivers, Role, UnitLayer, fit_radiances,
};
use crate::image::Mask;
use crate::optics::{Lamp, Radiance, RectLamp, Shape, Window};
use crate::tuning::tuning;

tuning! {
    /// Constants of the search for the lights that a photo needs.
    pub const TUNING: CandidateSearchTuning {
        /// Largest number of lights that a candidate is fitted beside one by one; more become one
        /// column.
        max_separate: usize = 16,
            unit "lights", source Measured("run time; no page records it"),
            effect "a larger value makes fits of many lights slower and more exact";
        /// Factor on the loss of a visible light's first candidate.
        first_candidate_factor: f64 = 0.97,
            unit "1", source Taste, effect "a smaller value makes the search keep the first candidate more often";
        /// Factor below which sun, sky and ground must bring the loss of a window of one lobe.
        three_lobes_factor: f64 = 0.95,
            unit "1", source Measured("docs/estimation.md"), effect "a smaller value gives fewer windows three lobes";
        /// Iterations of the fits that compare one lobe with three: more lobes converge later.
        three_lobes_iterations: usize = 60,
            unit "iterations", source Measured("no page records it"), effect "a smaller value favors one lobe";
    }
}

/// A light that may be the one.
#[derive(Clone, Debug)]
pub enum Candidate {
    /// A shape from the geometry of the room. A window is tried as a rectangle of even radiance.
    Shape(Shape),
    /// An estimate of a shape together with the radiance of each of its lobes.
    Estimate(Shape, Radiance),
}

impl Candidate {
    /// The shape of the light.
    pub fn shape(&self) -> &Shape {
        match self {
            Candidate::Shape(shape) | Candidate::Estimate(shape, _) => shape,
        }
    }
}

/// A candidate with its unit layer on the receivers.
#[derive(Clone, Debug)]
pub struct TracedCandidate {
    candidate: Candidate,
    layer: Vec<Vec3>,
}

/// A light that the photo needs.
#[derive(Clone, Debug)]
pub struct Accepted<'a> {
    /// Name of the light.
    pub id: &'a str,
    /// Its pixels; `None` for a light out of view.
    pub mask: Option<&'a Mask>,
    traced: TracedCandidate,
}

impl Accepted<'_> {
    /// The shape of the light.
    pub fn shape(&self) -> &Shape {
        self.traced.candidate.shape()
    }

    fn column(&self) -> Column<'_> {
        let role = if self.mask.is_some() { Role::Visible } else { Role::OutOfView };
        Column::new(role, &self.traced.layer)
    }
}

/// Settings of a [`CandidateSearch`].
#[derive(Clone, Copy, Debug)]
pub struct CandidateSettings {
    /// Quality of the candidates' layers.
    pub quality: LayerQuality,
    /// Prior of the radiances, and weight of the residual in the loss that is compared.
    pub prior: LightPrior,
    /// Most iterations of the fit of each candidate.
    pub iterations: usize,
    /// Fraction of the loss that a light out of view must save, in 0..1.
    pub min_gain: f64,
}

/// The photo on the receivers, and the fits of candidates to it.
pub struct CandidateSearch<'a> {
    receivers: Receivers<'a>,
    settings: CandidateSettings,
    fits: AtomicUsize,
    columns: AtomicUsize,
}

/// Role of a lobe, and its unit layer.
type RoleLayer = (Role, Vec<Vec3>);

/// Lights that a candidate is fitted beside: their columns, or the sum of many as one.
enum Companions<'b> {
    Separate(Vec<Column<'b>>),
    Sum(Vec<Vec3>),
}

impl Companions<'_> {
    fn columns(&self) -> Vec<Column<'_>> {
        match self {
            Companions::Separate(columns) => columns.clone(),
            Companions::Sum(layer) => vec![Column::new(Role::Visible, layer)],
        }
    }
}

impl<'a> CandidateSearch<'a> {
    /// A search on these receivers.
    pub fn new(receivers: Receivers<'a>, settings: CandidateSettings) -> CandidateSearch<'a> {
        CandidateSearch {
            receivers,
            settings,
            fits: AtomicUsize::new(0),
            columns: AtomicUsize::new(0),
        }
    }

    /// The receivers.
    pub fn receivers(&self) -> &Receivers<'a> {
        &self.receivers
    }

    /// Number of fits so far, and of the columns of all of them.
    pub fn counts(&self) -> (usize, usize) {
        (self.fits.load(Ordering::Relaxed), self.columns.load(Ordering::Relaxed))
    }

    /// The candidates with their unit layers, in order; those that are absent are left out. `mask`
    /// marks the light's pixels.
    pub fn trace(&self, candidates: Vec<Candidate>, mask: Option<&Mask>) -> Vec<TracedCandidate> {
        let traced = candidates.into_par_iter().map(|candidate| {
            let layer = self.layer(&candidate, mask)?;
            Some(TracedCandidate { candidate, layer })
        });
        traced.collect::<Vec<_>>().into_iter().flatten().collect()
    }

    /// The candidate for one visible light that fits best beside the accepted lights. The first one
    /// is kept unless another lowers the loss by 3 %. `None` without candidates.
    pub fn select<'b>(
        &self,
        id: &'b str,
        candidates: Vec<Candidate>,
        mask: &'b Mask,
        accepted: &[Accepted],
    ) -> Option<Accepted<'b>> {
        let only = candidates.len() == 1;
        let others =
            if only { Vec::new() } else { accepted.iter().map(Accepted::column).collect() };
        let others = self.companions(others);
        let tried =
            self.trace(candidates, Some(mask)).into_iter().enumerate().map(|(i, traced)| {
                let light = Accepted { id, mask: Some(mask), traced };
                if only {
                    return (0.0, light);
                }
                let columns = [others.columns(), vec![light.column()]].concat();
                let factor = if i == 0 { TUNING.first_candidate_factor } else { 1.0 };
                (self.loss(&columns, self.settings.iterations) * factor, light)
            });
        Some(tried.reduce(|a, b| if b.0 < a.0 { b } else { a })?.1)
    }

    /// The lamp and the window out of view, named `lamp_id` and `window_id`: the best single
    /// candidate, and the best of the other kind beside it, each if it lowers the loss by at least
    /// `min_gain`.
    pub fn select_out_of_view<'b>(
        &self,
        (lamp_id, lamps): (&'b str, Vec<TracedCandidate>),
        (window_id, windows): (&'b str, Vec<TracedCandidate>),
        visible: &[Accepted],
    ) -> Vec<Accepted<'b>> {
        let base = self.companions(visible.iter().map(Accepted::column).collect());
        let base = base.columns();
        let lamp_count = lamps.len();
        let light = |(id, traced)| Accepted { id, mask: None, traced };
        let lamps = lamps.into_iter().map(|traced| (lamp_id, traced));
        let mut lights: Vec<Option<Accepted>> = lamps
            .chain(windows.into_iter().map(|traced| (window_id, traced)))
            .map(light)
            .map(Some)
            .collect();
        let enough = 1.0 - self.settings.min_gain;
        let Some((first, loss)) = self.best(&base, &lights) else { return Vec::new() };
        let is_needed = loss < enough * self.loss(&base, self.settings.iterations);
        if !is_needed {
            return Vec::new();
        }
        let Some(first_light) = lights[first].take() else { return Vec::new() };
        let same_kind = if first < lamp_count { 0..lamp_count } else { lamp_count..lights.len() };
        lights[same_kind].fill(None);
        let with_first = [base, vec![first_light.column()]].concat();
        let second = self.best(&with_first, &lights).filter(|(_, both)| *both < enough * loss);
        let second = second.and_then(|(second, _)| lights[second].take());
        [Some(first_light), second].into_iter().flatten().collect()
    }

    /// The light of least loss beside `given`, and its loss; the first of equal ones.
    fn best(&self, given: &[Column], lights: &[Option<Accepted>]) -> Option<(usize, f64)> {
        let loss = |(i, light): (usize, &Option<Accepted>)| {
            let columns = [given, &[light.as_ref()?.column()]].concat();
            Some((i, self.loss(&columns, self.settings.iterations)))
        };
        let losses: Vec<Option<(usize, f64)>> = lights.par_iter().enumerate().map(loss).collect();
        losses.into_iter().flatten().reduce(|a, b| if b.1 < a.1 { b } else { a })
    }

    /// The shapes of the accepted lights. An estimate keeps its shape; for another light `variants`
    /// returns a plain shape, and one with sun, sky and ground where that is to be tried: it is
    /// taken if it lowers the loss by 5 %.
    pub fn shapes(
        &self,
        accepted: &[Accepted],
        variants: impl Fn(&str, &Shape) -> (Shape, Option<Shape>),
    ) -> Vec<Shape> {
        let mut lobes: Vec<Vec<RoleLayer>> = Vec::new();
        for light in accepted {
            lobes.push(vec![(light.column().role, light.traced.layer.clone())]);
        }
        let mut shapes = Vec::new();
        for (i, light) in accepted.iter().enumerate() {
            let (plain, rich) = match &light.traced.candidate {
                Candidate::Estimate(shape, _) => (shape.clone(), None),
                Candidate::Shape(shape) => variants(light.id, shape),
            };
            let Some(rich) = rich else {
                shapes.push(plain);
                continue;
            };
            let before = self.loss_among(accepted, &lobes, i);
            let of_lobe = |(lobe, layer)| (Role::of_lobe(&rich, lobe, light.mask.is_some()), layer);
            let traced =
                self.lobes(&rich, light.mask).into_iter().enumerate().map(of_lobe).collect();
            let even = std::mem::replace(&mut lobes[i], traced);
            if self.loss_among(accepted, &lobes, i) < TUNING.three_lobes_factor * before {
                shapes.push(rich);
            } else {
                lobes[i] = even;
                shapes.push(plain);
            }
        }
        shapes
    }

    /// Loss of all lights with these lobes; of more than `TUNING.max_separate`, of light `i` with
    /// its lobes beside the others.
    fn loss_among(&self, accepted: &[Accepted], lobes: &[Vec<RoleLayer>], i: usize) -> f64 {
        if lobes.len() <= TUNING.max_separate {
            let all: Vec<Column> =
                lobes.iter().flatten().map(|(role, layer)| Column::new(*role, layer)).collect();
            return self.loss(&all, TUNING.three_lobes_iterations);
        }
        let others =
            accepted.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, light)| light.column());
        let others = self.companions(others.collect());
        let mut all = others.columns();
        all.extend(lobes[i].iter().map(|(role, layer)| Column::new(*role, layer)));
        self.loss(&all, TUNING.three_lobes_iterations)
    }

    /// Columns as a candidate is fitted beside them: of more than `TUNING.max_separate` their sum,
    /// each with its radiance among them.
    fn companions<'b>(&self, columns: Vec<Column<'b>>) -> Companions<'b> {
        if columns.len() <= TUNING.max_separate {
            return Companions::Separate(columns);
        }
        let radiance = self.fit(&columns, self.settings.iterations).1.radiance;
        let sum = |p: usize| {
            columns.iter().zip(&radiance).map(|(column, w)| column.layer[p] * w).sum::<Vec3>()
        };
        Companions::Sum((0..self.receivers.ambient.len()).map(sum).collect())
    }

    /// Unit layers of the lobes on the receivers in use: shadowed direct and indirect light.
    fn lobes(&self, shape: &Shape, mask: Option<&Mask>) -> Vec<Vec<Vec3>> {
        self.receivers
            .layers(shape, mask, self.settings.quality)
            .iter()
            .map(UnitLayer::sum)
            .collect()
    }

    /// Unit layer of a candidate: of a lamp, of a window as an even rectangle, of an estimated
    /// window its lobes times their radiances. `None` for an absent light.
    fn layer(&self, candidate: &Candidate, mask: Option<&Mask>) -> Option<Vec<Vec3>> {
        match candidate {
            Candidate::Estimate(shape @ Shape::Window(_), radiance) => {
                let lobes = self.lobes(shape, mask).into_iter().zip(&radiance.0);
                lobes
                    .map(|(layer, w)| layer.into_iter().map(|u| u * w).collect())
                    .reduce(|a: Vec<Vec3>, b| a.into_iter().zip(b).map(|(a, b)| a + b).collect())
            }
            other => self.lobes(&Shape::Lamp(even(other.shape())?), mask).into_iter().next(),
        }
    }

    /// The columns and, as the last one, the ambient, fitted to the photo.
    fn fit<'b>(
        &'b self,
        lights: &[Column<'b>],
        iterations: usize,
    ) -> (Vec<Column<'b>>, RadianceFit) {
        let mut columns = lights.to_vec();
        columns.push(Column::new(Role::Ambient, &self.receivers.ambient));
        let fit =
            fit_radiances(&self.receivers.observations, &columns, &self.settings.prior, iterations);
        self.fits.fetch_add(1, Ordering::Relaxed);
        self.columns.fetch_add(columns.len(), Ordering::Relaxed);
        (columns, fit)
    }

    /// Selection loss of the fit of these columns and the ambient.
    fn loss(&self, lights: &[Column], iterations: usize) -> f64 {
        let (columns, fit) = self.fit(lights, iterations);
        fit.selection_loss(&columns, &self.settings.prior)
    }
}

/// The light as a lamp of even radiance: a window without its sun is close to a bright rectangle.
fn even(shape: &Shape) -> Option<Lamp> {
    match shape {
        Shape::Absent => None,
        Shape::Lamp(lamp) => Some(lamp.clone()),
        Shape::Window(Window { center, x, y, .. }) => {
            Some(Lamp::Rect(RectLamp { center: *center, x: *x, y: *y }))
        }
    }
}
