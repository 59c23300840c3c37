//! Experiments on whole pictures.

use super::error::Point;
use super::{At, Effort, ParamSetting, Picture, Renderer, Truth, both, seeded};

/// The true picture with one light switched off.
struct LightOff {
    light: String,
    /// The photo, linear.
    photo: Vec<f64>,
    /// The photo without this light, linear.
    wanted: Vec<f64>,
}

/// One entry per light of the truth; the sum of all lights is the photo.
fn lights_off(truth: &Truth) -> Vec<LightOff> {
    let pixels = truth.lights.first().map_or(0, |(_, light)| light.len());
    let photo: Vec<f64> =
        (0..pixels).map(|i| truth.lights.iter().map(|(_, light)| light[i]).sum()).collect();
    let off = |(light, alone): &(String, Vec<f64>)| {
        let wanted = photo.iter().zip(alone).map(|(photo, alone)| photo - alone).collect();
        LightOff { light: light.clone(), photo: photo.clone(), wanted }
    };
    truth.lights.iter().map(off).collect()
}

/// Relative error of a change: 0 is perfect, 1 is doing nothing. The mean absolute error in
/// linear light clipped to 0..=1, over the pixels that show no light.
fn change_error(got: &[f64], truth: &LightOff, emitters: &[bool]) -> f64 {
    let clip = |x: f64| x.clamp(0.0, 1.0);
    let counts = |channel: usize| !emitters.get(channel / 3).copied().unwrap_or(false);
    let (mut missed, mut moved) = (0.0, 0.0);
    let channels = got.iter().zip(&truth.wanted).zip(&truth.photo).enumerate();
    for (_, ((got, wanted), photo)) in channels.filter(|(channel, _)| counts(*channel)) {
        missed += (clip(*got) - clip(*wanted)).abs();
        moved += (clip(*wanted) - clip(*photo)).abs();
    }
    missed / moved
}

/// Mean absolute difference of two pictures over the mean of the second, both clipped to 0..=1.
fn difference(got: &[f64], wanted: &[f64]) -> f64 {
    let clip = |x: &f64| x.clamp(0.0, 1.0);
    let missed: f64 = got.iter().zip(wanted).map(|(a, b)| (clip(a) - clip(b)).abs()).sum();
    missed / wanted.iter().map(clip).sum::<f64>()
}

/// A pipeline that is measured: name, settings, and samples or targets.
type Series<'a> = (&'static str, Vec<ParamSetting>, &'a [At]);

/// Error of whole pictures against the time of a run from an empty cache.
///
/// # Errors
/// A run fails or is cancelled.
pub(super) fn pipeline<R: Renderer>(renderer: &R, effort: &Effort) -> Result<Vec<Point>, R::Error> {
    let truth = renderer.truth()?;
    let edits = lights_off(&truth);
    // Without truth, one light is switched off.
    let lights: Vec<String> = match edits.is_empty() {
        true => renderer.lights()?.into_iter().take(1).map(|light| light.name).collect(),
        false => edits.iter().map(|edit| edit.light.clone()).collect(),
    };
    let most = effort.pipeline.iter().copied().max().unwrap_or(1);
    let limit = seeded(renderer, &[At::Samples(2 * most).settings()]);
    let limit = pictures(renderer, effort, &limit, &lights)?;
    renderer.message("pipeline: its own limit");

    let samples: Vec<At> = effort.pipeline.iter().map(|&n| At::Samples(n)).collect();
    let targets: Vec<At> = effort.targets.iter().map(|&target| At::Target(target)).collect();
    let all: [Series; 5] = [
        ("as shipped", Vec::new(), &samples),
        ("as shipped, adaptive", both("max_samples", 8 * most), &targets),
        ("1 lobe", vec![("InitLights", "window_emission", "Uniform".to_owned())], &samples),
        ("lamps as boxes", vec![("InitLights", "lamps", "Box".to_owned())], &samples),
        ("lamps as surfels", vec![("InitLights", "lamps", "Surfels".to_owned())], &samples),
    ];
    let mut points = Vec::new();
    for (series, fixed, at) in all {
        for &at in at {
            let settings = seeded(renderer, &[fixed.clone(), at.settings()]);
            let made = pictures(renderer, effort, &settings, &lights)?;
            let again = if effort.whole {
                pictures(renderer, effort, &settings, &lights[..1])?
            } else {
                Vec::new()
            };
            // The first edit alone computes everything; the better of two runs counts.
            let seconds = made[..1]
                .iter()
                .chain(&again)
                .map(|made| made.seconds)
                .fold(f64::INFINITY, f64::min);
            let point = |plot, light: &str, error| Point {
                plot,
                subject: format!("{light} off"),
                series: series.to_owned(),
                samples: at.samples(),
                target: at.target(),
                bandwidth: None,
                seconds,
                rays: made[0].rays,
                error,
                claimed: None,
            };
            for (k, light) in lights.iter().enumerate() {
                let got = &made[k].channels;
                if let Some(edit) = edits.get(k) {
                    points.push(point("pipeline", light, change_error(got, edit, &truth.emitters)));
                }
                // Other estimates of lights converge to another limit.
                if fixed.iter().all(|(kind, ..)| *kind != "InitLights") {
                    points.push(point("noise", light, difference(got, &limit[k].channels)));
                }
            }
        }
        renderer.message(&format!("pipeline: {series}"));
    }
    Ok(points)
}

/// Renders one picture per light with that light switched off.
fn pictures<R: Renderer>(
    renderer: &R,
    effort: &Effort,
    settings: &[ParamSetting],
    lights: &[String],
) -> Result<Vec<Picture>, R::Error> {
    let size = if effort.whole { Vec::new() } else { effort.small() };
    let off = |light: &String| vec![("EditLights", "lights", format!("{{ {light:?}: Off }}"))];
    let all: Vec<Vec<ParamSetting>> =
        lights.iter().map(|light| [settings.to_vec(), size.clone(), off(light)].concat()).collect();
    renderer.pictures(&all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_a_change_is_relative_to_the_change() {
        let truth = Truth {
            lights: vec![("a".to_owned(), vec![0.5; 6]), ("b".to_owned(), vec![0.25; 6])],
            emitters: vec![false, true],
        };
        let edits = lights_off(&truth);
        assert_eq!((edits.len(), edits[0].photo[0], edits[0].wanted[0]), (2, 0.75, 0.25));
        // The second pixel shows a light: its error does not count.
        for (got, wanted) in [(0.25, 0.0), (0.75, 1.0), (0.5, 0.5)] {
            assert_eq!(
                change_error(&[got, got, got, 9.0, 9.0, 9.0], &edits[0], &truth.emitters),
                wanted
            );
        }
    }
}
