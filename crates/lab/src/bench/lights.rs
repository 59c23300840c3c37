//! Experiments on single lights: which estimator, at how many samples.

use super::error::{Estimate, Point, Reference, measure, repeat};
use super::{At, Effort, ParamSetting, Renderer, both, seeded};

/// A lobe of a light that reaches the room, with its reference.
struct Subject {
    name: String,
    lobe: usize,
    reference: Reference,
}

/// A quantity that is estimated of a light.
#[derive(Clone, Copy)]
enum Estimator {
    /// Unshadowed direct shading.
    Direct,
    /// Direct shading times visibility.
    Shadowed,
}

impl Estimator {
    fn estimate<R: Renderer>(
        self,
        renderer: &R,
        light: &str,
        settings: &[ParamSetting],
    ) -> Result<Estimate, R::Error> {
        let direct = renderer.direct(light, settings)?;
        match self {
            Estimator::Direct => Ok(direct),
            Estimator::Shadowed => Ok(direct.shadowed(renderer.visibility(light, settings)?)),
        }
    }
}

/// A line of a plot: an estimator under fixed settings, at varied samples or targets.
struct Line<'a> {
    plot: &'static str,
    series: &'a str,
    estimator: Estimator,
    fixed: Vec<ParamSetting>,
    at: Vec<At>,
}

/// Sampling strategies: value of the parameter `sampling`, name in the plots, smallest number of
/// samples. Strategies that alternate between area and lobe need a sample of either in each of the
/// four batches.
pub(super) const STRATEGIES: [(&str, &str, u32); 7] = [
    ("Area", "area only", 1),
    ("Lobe", "lobe only", 1),
    ("Balance", "MIS balance", 8),
    ("BalanceOneSample", "MIS balance, one-sample", 1),
    ("Power", "MIS power", 8),
    ("PowerOneSample", "MIS power, one-sample", 1),
    ("Best", "ours", 1),
];

/// Series of the default strategy, sampled until a target is reached.
pub(super) const ADAPTIVE: &str = "ours, adaptive";

fn strategy(name: &str) -> Vec<ParamSetting> {
    both("sampling", name)
}

/// Lobes of a light that reach the visible room, each with its reference at `samples`.
fn subjects<R: Renderer>(
    renderer: &R,
    light: &str,
    effort: &Effort,
    estimator: Estimator,
    (samples, fixed): (u32, &[ParamSetting]),
) -> Result<Vec<Subject>, R::Error> {
    let settings = [effort.small(), fixed.to_vec(), At::Samples(samples).settings()];
    let estimates = (0..effort.references)
        .map(|_| estimator.estimate(renderer, light, &seeded(renderer, &settings)));
    let references = Reference::of(&estimates.collect::<Result<Vec<_>, _>>()?);
    let count = references.len();
    let name = |lobe: usize| match (count, lobe) {
        (3, 0) => format!("{light}, sun"),
        (3, 1) => format!("{light}, sky"),
        (3, _) => format!("{light}, ground"),
        _ => light.to_owned(),
    };
    let all = references.into_iter().enumerate();
    let subject = |(lobe, reference)| Subject { name: name(lobe), lobe, reference };
    Ok(all.map(subject).filter(|subject| subject.reference.shines()).collect())
}

/// Measures all marks of a line, for every subject of a light.
fn draw<R: Renderer>(
    renderer: &R,
    light: &str,
    subjects: &[Subject],
    effort: &Effort,
    line: &Line,
) -> Result<Vec<Point>, R::Error> {
    let mut points = Vec::new();
    for &at in &line.at {
        let settings = [effort.small(), line.fixed.clone(), at.settings()];
        let estimates = repeat(effort.repeat_seconds, || {
            line.estimator.estimate(renderer, light, &seeded(renderer, &settings))
        })?;
        for subject in subjects {
            let got = measure(&estimates, subject.lobe, &subject.reference);
            points.push(Point {
                plot: line.plot,
                subject: subject.name.clone(),
                series: line.series.to_owned(),
                samples: at.samples(),
                target: at.target(),
                bandwidth: None,
                seconds: got.seconds,
                rays: got.rays,
                error: got.error,
                claimed: Some(got.claimed),
            });
        }
    }
    renderer.message(&format!("{}: {light}: {}", line.plot, line.series));
    Ok(points)
}

/// Names of the visible lights; of the others where the photo shows none.
fn lights<R: Renderer>(renderer: &R) -> Result<Vec<String>, R::Error> {
    let (visible, others): (Vec<_>, Vec<_>) =
        renderer.lights()?.into_iter().partition(|light| light.visible);
    let chosen = if visible.is_empty() { others } else { visible };
    Ok(chosen.into_iter().map(|light| light.name).collect())
}

/// Names of the windows with several lobes among [`lights`].
fn windows<R: Renderer>(renderer: &R, effort: &Effort) -> Result<Vec<String>, R::Error> {
    let mut windows = Vec::new();
    for light in lights(renderer)? {
        let settings = seeded(renderer, &[effort.small(), At::Samples(1).settings()]);
        if renderer.direct(&light, &settings)?.lobes.len() > 1 {
            windows.push(light);
        }
    }
    Ok(windows)
}

/// Error against time of every strategy, for each lobe of each window, unshadowed.
///
/// # Errors
/// A run fails or is cancelled.
pub(super) fn strategies<R: Renderer>(
    renderer: &R,
    effort: &Effort,
) -> Result<Vec<Point>, R::Error> {
    let mut points = Vec::new();
    for light in windows(renderer, effort)? {
        let subjects = subjects(
            renderer,
            &light,
            effort,
            Estimator::Direct,
            (effort.most(), &strategy("Best")),
        )?;
        for (name, series, fewest) in STRATEGIES {
            let at =
                effort.samples.iter().filter(|n| **n >= fewest).map(|&n| At::Samples(n)).collect();
            let line = Line {
                plot: "strategies",
                series,
                estimator: Estimator::Direct,
                fixed: strategy(name),
                at,
            };
            points.extend(draw(renderer, &light, &subjects, effort, &line)?);
        }
    }
    Ok(points)
}

/// Error of every strategy against the bandwidth of the lobe, for the first window, without and
/// with its shadow.
///
/// # Errors
/// A run fails or is cancelled.
pub(super) fn bandwidths<R: Renderer>(
    renderer: &R,
    effort: &Effort,
) -> Result<Vec<Point>, R::Error> {
    let Some(light) = windows(renderer, effort)?.into_iter().next() else { return Ok(Vec::new()) };
    let mut points = Vec::new();
    let whole = vec![("Shadow", "half", "false".to_owned())];
    for (subject, estimator) in
        [("unshadowed", Estimator::Direct), ("with its shadow", Estimator::Shadowed)]
    {
        for &bandwidth in &effort.bandwidths {
            // All lobes are equal, so the stages take three times as long as one lobe does.
            let emission = (
                "InitLights",
                "window_emission",
                format!("Daylight({bandwidth},{bandwidth},{bandwidth})"),
            );
            let fixed = [whole.clone(), vec![emission]].concat();
            let best = [fixed.clone(), strategy("Best")].concat();
            let reference = effort.most().min(8 * effort.sweep);
            let subjects = subjects(renderer, &light, effort, estimator, (reference, &best))?;
            for (name, series, fewest) in STRATEGIES {
                let at = vec![At::Samples(effort.sweep.max(fewest))];
                let fixed = [fixed.clone(), strategy(name)].concat();
                let line = Line { plot: "bandwidths", series, estimator, fixed, at };
                // Sun and sky share a direction; few receivers see a narrow lobe of the ground.
                let drawn =
                    draw(renderer, &light, &subjects[..1.min(subjects.len())], effort, &line)?;
                points.extend(drawn.into_iter().map(|point| Point {
                    subject: format!("{light}, {subject}"),
                    bandwidth: Some(bandwidth),
                    ..point
                }));
            }
        }
    }
    Ok(points)
}

/// Error against time of direct light with its shadow: every strategy, and the default one with
/// adaptive sampling.
///
/// # Errors
/// A run fails or is cancelled.
pub(super) fn shadows<R: Renderer>(renderer: &R, effort: &Effort) -> Result<Vec<Point>, R::Error> {
    let windows = windows(renderer, effort)?;
    let mut points = Vec::new();
    let whole = vec![("Shadow", "half", "false".to_owned())];
    for light in lights(renderer)? {
        let most = effort.most().min(effort.most_rays);
        let subjects = subjects(renderer, &light, effort, Estimator::Shadowed, (most, &whole))?;
        // The unshadowed experiment compares one-sample strategies with the others.
        let compared =
            STRATEGIES.iter().filter(|(name, ..)| windows.contains(&light) || *name == "Best");
        for &(name, series, fewest) in compared.filter(|(name, ..)| !name.ends_with("OneSample")) {
            let samples = effort.samples.iter().filter(|n| (fewest..=most).contains(n));
            let at = samples.map(|&n| At::Samples(n)).collect();
            let fixed = [whole.clone(), strategy(name)].concat();
            let line = Line { plot: "shadows", series, estimator: Estimator::Shadowed, fixed, at };
            points.extend(draw(renderer, &light, &subjects, effort, &line)?);
        }
        let at = effort.targets.iter().map(|&target| At::Target(target)).collect();
        let fixed = [whole.clone(), both("max_samples", 4 * most)].concat();
        let line =
            Line { plot: "shadows", series: ADAPTIVE, estimator: Estimator::Shadowed, fixed, at };
        points.extend(draw(renderer, &light, &subjects, effort, &line)?);
    }
    Ok(points)
}
