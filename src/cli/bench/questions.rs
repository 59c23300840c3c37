//! The questions: which estimator, how many samples, which description of a light.

use relight::nodes::artifacts::{INV_LAMP, INV_WINDOW, Mask, Picture};

use super::Effort;
use super::measure::{Estimate, Point, Reference, direct, measure, repeat, shadowed};
use super::session::{Made, Session, Set};
use crate::cli::Stop;
use crate::cli::messages::message;

/// One light and one lobe that reaches what is seen.
struct Subject {
    name: String,
    lobe: usize,
    reference: Reference,
}

type Estimator = fn(&Session, &str, &[Set]) -> Result<Estimate, Stop>;

/// What one line of a plot asks for, and what it varies.
struct Line<'a> {
    plot: &'static str,
    series: &'a str,
    estimator: Estimator,
    fixed: Vec<Set>,
    at: Vec<At>,
}

#[derive(Clone, Copy)]
enum At {
    Samples(u32),
    Target(f64),
}

impl At {
    fn sets(self) -> Vec<Set> {
        match self {
            At::Samples(n) => [both("samples", n), both("target_error", 0)].concat(),
            At::Target(target) => both("target_error", target),
        }
    }
}

/// One parameter of all stages that sample lights.
fn both(field: &'static str, value: impl ToString) -> Vec<Set> {
    let value = value.to_string();
    vec![("Direct", field, value.clone()), ("Shadow", field, value)]
}

fn seeded(session: &Session, sets: &[Vec<Set>]) -> Vec<Set> {
    let seed = both("seed", session.seed());
    sets.iter().flatten().cloned().chain(seed).collect()
}

/// Sampling strategies: what the parameter `sampling` calls them, what the plots call them, fewest samples.
///
/// Where area and lobe come in turn, each of the four batches needs a sample of either.
pub const STRATEGIES: [(&str, &str, u32); 7] = [
    ("Area", "area only", 1),
    ("Lobe", "lobe only", 1),
    ("Balance", "MIS balance", 8),
    ("BalanceOneSample", "MIS balance, one-sample", 1),
    ("Power", "MIS power", 8),
    ("PowerOneSample", "MIS power, one-sample", 1),
    ("Best", "ours", 1),
];

/// Our own way, until a target is reached.
pub const ADAPTIVE: &str = "ours, adaptive";

fn strategy(name: &str) -> Vec<Set> {
    both("sampling", name)
}

/// Lobes that reach the seen room, each with its reference.
fn subjects(
    session: &Session,
    light: &str,
    effort: &Effort,
    estimator: Estimator,
    (samples, fixed): (u32, &[Set]),
) -> Result<Vec<Subject>, Stop> {
    let sets = [effort.small(), fixed.to_vec(), At::Samples(samples).sets()];
    let estimates = (0..effort.references).map(|_| estimator(session, light, &seeded(session, &sets)));
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

/// All marks of a line, for every subject of a light.
fn draw(
    session: &Session,
    light: &str,
    subjects: &[Subject],
    effort: &Effort,
    line: &Line,
) -> Result<Vec<Point>, Stop> {
    let mut points = Vec::new();
    for &at in &line.at {
        let sets = [effort.small(), line.fixed.clone(), at.sets()];
        let estimates = repeat(effort.repeat_seconds, || (line.estimator)(session, light, &seeded(session, &sets)))?;
        for subject in subjects {
            let got = measure(&estimates, subject.lobe, &subject.reference);
            let (samples, target) = match at {
                At::Samples(n) => (Some(n), None),
                At::Target(target) => (None, Some(target)),
            };
            points.push(Point {
                plot: line.plot,
                subject: subject.name.clone(),
                series: line.series.to_owned(),
                samples,
                target,
                bandwidth: None,
                seconds: got.seconds,
                rays: got.rays,
                error: got.error,
                claimed: Some(got.claimed),
            });
        }
    }
    tell(line.plot, &format!("{light}: {}", line.series));
    Ok(points)
}

fn tell(plot: &str, what: &str) {
    message!("{plot}: {what}");
}

/// The lights that the scene shows, or those that it does not when it shows none.
fn lights(session: &Session) -> Result<Vec<String>, Stop> {
    let (node, _) = session.layers()?;
    let (unseen, seen): (Vec<_>, Vec<_>) =
        session.members(node)?.into_iter().partition(|light| [INV_LAMP, INV_WINDOW].contains(&light.as_str()));
    Ok(if seen.is_empty() { unseen } else { seen })
}

/// Those of them that are windows of several lobes.
fn windows(session: &Session, effort: &Effort) -> Result<Vec<String>, Stop> {
    let mut windows = Vec::new();
    for light in lights(session)? {
        let sets = seeded(session, &[effort.small(), At::Samples(1).sets()]);
        if direct(session, &light, &sets)?.lobes.len() > 1 {
            windows.push(light);
        }
    }
    Ok(windows)
}

/// Error against time of every strategy, for each lobe of each window, unshadowed.
pub fn strategies(session: &Session, effort: &Effort) -> Result<Vec<Point>, Stop> {
    let mut points = Vec::new();
    for light in windows(session, effort)? {
        let subjects = subjects(session, &light, effort, direct, (effort.most(), &strategy("Best")))?;
        for (name, series, fewest) in STRATEGIES {
            let at = effort.samples.iter().filter(|n| **n >= fewest).map(|&n| At::Samples(n)).collect();
            let line = Line { plot: "strategies", series, estimator: direct, fixed: strategy(name), at };
            points.extend(draw(session, &light, &subjects, effort, &line)?);
        }
    }
    Ok(points)
}

/// Error of every strategy against the bandwidth of the lobe, for the first window, without and with its shadow.
pub fn bandwidths(session: &Session, effort: &Effort) -> Result<Vec<Point>, Stop> {
    let Some(light) = windows(session, effort)?.into_iter().next() else { return Ok(Vec::new()) };
    let mut points = Vec::new();
    let whole = vec![("Shadow", "half", "false".to_owned())];
    for (subject, estimator) in [("unshadowed", direct as Estimator), ("with its shadow", shadowed)] {
        for &bandwidth in &effort.bandwidths {
            // All lobes are alike, so that the time of the stages is that of one, three times.
            let outlook = ("InitLights", "outlook", format!("Daylight({bandwidth},{bandwidth},{bandwidth})"));
            let fixed = [whole.clone(), vec![outlook]].concat();
            let best = [fixed.clone(), strategy("Best")].concat();
            let reference = effort.most().min(8 * effort.sweep);
            let subjects = subjects(session, &light, effort, estimator, (reference, &best))?;
            for (name, series, fewest) in STRATEGIES {
                let at = vec![At::Samples(effort.sweep.max(fewest))];
                let fixed = [fixed.clone(), strategy(name)].concat();
                let line = Line { plot: "bandwidths", series, estimator, fixed, at };
                // Sun and sky stand in the same direction; the ground's lobe, when it is narrow, is seen from few places.
                let drawn = draw(session, &light, &subjects[..1.min(subjects.len())], effort, &line)?;
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

/// Error against time of direct light with its shadow: every strategy, and ours with samples taken until they are enough.
pub fn shadows(session: &Session, effort: &Effort) -> Result<Vec<Point>, Stop> {
    let windows = windows(session, effort)?;
    let mut points = Vec::new();
    let whole = vec![("Shadow", "half", "false".to_owned())];
    for light in lights(session)? {
        let most = effort.most().min(effort.most_rays);
        let subjects = subjects(session, &light, effort, shadowed, (most, &whole))?;
        // One-sample ways are told apart from the others in what is unshadowed.
        let compared = STRATEGIES.iter().filter(|(name, ..)| windows.contains(&light) || *name == "Best");
        for &(name, series, fewest) in compared.filter(|(name, ..)| !name.ends_with("OneSample")) {
            let samples = effort.samples.iter().filter(|n| (fewest..=most).contains(n));
            let at = samples.map(|&n| At::Samples(n)).collect();
            let fixed = [whole.clone(), strategy(name)].concat();
            let line = Line { plot: "shadows", series, estimator: shadowed, fixed, at };
            points.extend(draw(session, &light, &subjects, effort, &line)?);
        }
        let at = effort.targets.iter().map(|&target| At::Target(target)).collect();
        let fixed = [whole.clone(), both("max_samples", 4 * most)].concat();
        let line = Line { plot: "shadows", series: ADAPTIVE, estimator: shadowed, fixed, at };
        points.extend(draw(session, &light, &subjects, effort, &line)?);
    }
    Ok(points)
}

/// A picture with one light switched off, by the truth of that light alone.
struct Truth {
    light: String,
    /// Linear, as the photo and as the photo without this light.
    photo: Vec<f64>,
    wanted: Vec<f64>,
}

/// The lights whose own picture lies beside the scene, as `truth/light_ID.exr`; those of all lights sum to the photo.
fn truths(session: &Session) -> Result<Vec<Truth>, Stop> {
    let (node, _) = session.layers()?;
    let scene = session.node("ReadScene")?;
    let Some(folder) = session.scene() else { return Ok(Vec::new()) };
    let mut lights = Vec::new();
    for light in session.members(node)? {
        let path = folder.join(format!("truth/light_{light}.exr"));
        if path.is_file() {
            let sets = [("ReadScene", "photo", format!("{:?}", path.display().to_string()))];
            let picture = session.make::<Picture>(scene, "photo", &sets)?.value;
            lights.push((light, linear(&picture)));
        }
    }
    let pixels = lights.first().map_or(0, |(_, light)| light.len());
    let photo: Vec<f64> = (0..pixels).map(|i| lights.iter().map(|(_, light)| light[i]).sum()).collect();
    let truth = |(light, alone): (String, Vec<f64>)| {
        let wanted = photo.iter().zip(&alone).map(|(photo, alone)| photo - alone).collect();
        Truth { light, photo: photo.clone(), wanted }
    };
    Ok(lights.into_iter().map(truth).collect())
}

fn linear(picture: &Picture) -> Vec<f64> {
    picture.0.pixels().iter().flat_map(|rgb| rgb.to_array()).map(f64::from).collect()
}

/// The error of a change: 0 is perfect, 1 is doing nothing. In linear light clipped to what a picture can show, over the
/// pixels that show no light.
fn change_error(got: &[f64], truth: &Truth, counted: &[bool]) -> f64 {
    let clip = |x: f64| x.clamp(0.0, 1.0);
    let (mut missed, mut moved) = (0.0, 0.0);
    let channels = got.iter().zip(&truth.wanted).zip(&truth.photo).enumerate();
    for (_, ((got, wanted), photo)) in channels.filter(|(i, _)| counted[i / 3]) {
        missed += (clip(*got) - clip(*wanted)).abs();
        moved += (clip(*wanted) - clip(*photo)).abs();
    }
    missed / moved
}

/// Mean absolute difference of two pictures over the mean of the second, clipped to what a picture can show.
fn difference(got: &[f64], wanted: &[f64]) -> f64 {
    let clip = |x: &f64| x.clamp(0.0, 1.0);
    let missed: f64 = got.iter().zip(wanted).map(|(a, b)| (clip(a) - clip(b)).abs()).sum();
    missed / wanted.iter().map(clip).sum::<f64>()
}

/// Error of whole pictures against the time of a run that finds nothing in its cache.
pub fn pipeline(session: &Session, effort: &Effort) -> Result<Vec<Point>, Stop> {
    let truths = truths(session)?;
    let scene = session.node("ReadScene")?;
    let compose = session.node("Compose")?;
    let masks = session.members_of::<Mask>(scene, "full_mask")?;
    let pixels = truths.first().map_or(0, |truth| truth.photo.len() / 3);
    let counted: Vec<bool> =
        (0..pixels).map(|i| masks.iter().all(|mask| mask.0.pixels().get(i).is_none_or(|m| *m == 0.0))).collect();
    // Without truth, the lights that are seen are switched off.
    let (node, _) = session.layers()?;
    let lights_off: Vec<String> = match truths.is_empty() {
        true => session.members(node)?.into_iter().take(1).collect(),
        false => truths.iter().map(|truth| truth.light.clone()).collect(),
    };
    let pictures = |sets: &[Set], lights_off: &[String]| -> Result<Vec<Made<Picture>>, Stop> {
        let size = if effort.whole { Vec::new() } else { effort.small() };
        let off = |light| vec![("EditLights", "lights", format!("{{ {light:?}: Off }}"))];
        let ways: Vec<Vec<Set>> =
            lights_off.iter().map(|light| [sets.to_vec(), size.clone(), off(light)].concat()).collect();
        session.make_anew(compose, "picture", &ways)
    };
    let most = effort.pipeline.iter().copied().max().unwrap_or(1);
    let limit = pictures(&seeded(session, &[At::Samples(2 * most).sets()]), &lights_off)?;
    let limit: Vec<Vec<f64>> = limit.iter().map(|made| linear(&made.value)).collect();
    tell("pipeline", "its own limit");

    let samples: Vec<At> = effort.pipeline.iter().map(|&n| At::Samples(n)).collect();
    let targets: Vec<At> = effort.targets.iter().map(|&target| At::Target(target)).collect();
    let mut points = Vec::new();
    for (series, fixed, at) in [
        ("as shipped", Vec::new(), &samples),
        ("as shipped, adaptive", both("max_samples", 8 * most), &targets),
        ("1 lobe", vec![("InitLights", "outlook", "Even".to_owned())], &samples),
        ("lamps as boxes", vec![("InitLights", "lamps", "Box".to_owned())], &samples),
        ("lamps as plates", vec![("InitLights", "lamps", "Plates".to_owned())], &samples),
    ] {
        for &at in at {
            let sets = seeded(session, &[fixed.clone(), at.sets()]);
            let made = pictures(&sets, &lights_off)?;
            let again = if effort.whole { pictures(&sets, &lights_off[..1])? } else { Vec::new() };
            let seconds = made[..1].iter().chain(&again).map(|made| made.seconds).fold(f64::INFINITY, f64::min);
            let (samples, target) = match at {
                At::Samples(n) => (Some(n), None),
                At::Target(target) => (None, Some(target)),
            };
            let point = |plot, light: &str, error| Point {
                plot,
                subject: format!("{light} off"),
                series: series.to_owned(),
                samples,
                target,
                bandwidth: None,
                // What the first edit took from nothing, the better of two: the other edits find most of it done.
                seconds,
                rays: made[0].rays,
                error,
                claimed: None,
            };
            for (k, light) in lights_off.iter().enumerate() {
                let got = linear(&made[k].value);
                if let Some(truth) = truths.get(k) {
                    points.push(point("pipeline", light, change_error(&got, truth, &counted)));
                }
                // Other lights have another limit.
                if fixed.iter().all(|(kind, ..)| *kind != "InitLights") {
                    points.push(point("noise", light, difference(&got, &limit[k])));
                }
            }
        }
        tell("pipeline", series);
    }
    Ok(points)
}
