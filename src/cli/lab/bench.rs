//! `relight bench`: error against run time.

use std::time::Instant;

use relight::nodes::artifacts::{INV_LAMP, INV_WINDOW, Mask, Picture, UnitDirect, Visibility};
use relight_lab::bench::{
    self as lab, Estimate, LobeEstimate, ParamSetting, Renderer, SceneLight, Truth,
};

use super::args::Bench;
use super::session::{Session, Timed};
use crate::cli::exit::{CliError, Exit, Stop, ended};
use crate::cli::messages::message;
use crate::cli::report;
use crate::cli::write::{self, Output};

/// Runs `relight bench`.
///
/// # Errors
/// Files or arguments that cannot be used.
pub fn bench(args: &Bench, began: Instant) -> Result<Exit, CliError> {
    ended(measure(args, began))
}

fn measure(args: &Bench, began: Instant) -> Result<(), Stop> {
    let session = Session::new(args)?;
    let out = Output::new(&args.out, [args.graph.clone()], false)?; // fails before the work, not after it
    let points = lab::measure(&session, &args.options)?;
    let report = lab::BenchReport {
        relight: env!("CARGO_PKG_VERSION"),
        graph: args.graph.display().to_string(),
        scene: session.scene().map(|path| path.display().to_string()),
        threads: session.threads(),
        seconds: began.elapsed().as_secs_f64(),
        side: args.options.side,
        points,
    };
    let json = report::text(&report);
    let files = [("bench.json".to_owned(), json.clone())].into_iter().chain(report.files());
    for path in out.write(&files.collect::<Vec<_>>())? {
        message!("{}", path.display());
    }
    write::print(&if args.json { json } else { report.markdown() })?;
    Ok(())
}

impl Renderer for Session {
    type Error = Stop;

    fn seed(&self) -> u64 {
        Session::seed(self)
    }

    fn lights(&self) -> Result<Vec<SceneLight>, Stop> {
        let (direct, _) = self.layers()?;
        let visible = |name: &str| ![INV_LAMP, INV_WINDOW].contains(&name);
        let lights = self.members(direct)?.into_iter();
        Ok(lights.map(|name| SceneLight { visible: visible(&name), name }).collect())
    }

    fn direct(&self, light: &str, settings: &[ParamSetting]) -> Result<Estimate, Stop> {
        let (node, _) = self.layers()?;
        let made = self.make::<UnitDirect>(&format!("{node}[{light}]"), "direct", settings)?;
        let planes = made.value.lobes.iter().zip(&made.value.stderr);
        let lobes = layers(planes.map(|(value, stderr)| [value.pixels(), stderr.pixels()]));
        Ok(Estimate { lobes, seconds: made.seconds, rays: made.rays })
    }

    fn visibility(&self, light: &str, settings: &[ParamSetting]) -> Result<Estimate, Stop> {
        let (_, node) = self.layers()?;
        let made = self.make::<Visibility>(&format!("{node}[{light}]"), "visibility", settings)?;
        let planes = made.value.lit.iter().zip(&made.value.stderr);
        let lobes = layers(planes.map(|(value, stderr)| [value.pixels(), stderr.pixels()]));
        Ok(Estimate { lobes, seconds: made.seconds, rays: made.rays })
    }

    /// Reads the lights whose own picture lies beside the scene, as `truth/light_ID.exr`.
    fn truth(&self) -> Result<Truth, Stop> {
        let (node, _) = self.layers()?;
        let scene = self.node("ReadScene")?;
        let Some(folder) = self.scene() else { return Ok(Truth::default()) };
        let mut lights = Vec::new();
        for light in self.members(node)? {
            let path = folder.join(format!("truth/light_{light}.exr"));
            if path.is_file() {
                let settings =
                    [("ReadScene", "photo", format!("{:?}", path.display().to_string()))];
                let picture = self.make::<Picture>(scene, "photo", &settings)?.value;
                lights.push((light, linear(&picture)));
            }
        }
        let pixels = lights.first().map_or(0, |(_, channels)| channels.len() / 3);
        let masks = self.members_of::<Mask>(scene, "full_mask")?;
        let emits = |pixel: usize| {
            masks.iter().any(|mask| mask.0.pixels().get(pixel).is_some_and(|m| *m != 0.0))
        };
        Ok(Truth { lights, emitters: (0..pixels).map(emits).collect() })
    }

    fn pictures(&self, settings: &[Vec<ParamSetting>]) -> Result<Vec<lab::Picture>, Stop> {
        let made = self.make_anew::<Picture>(self.node("Compose")?, "picture", settings)?;
        let picture = |made: Timed<Picture>| lab::Picture {
            channels: linear(&made.value),
            seconds: made.seconds,
            rays: made.rays,
        };
        Ok(made.into_iter().map(picture).collect())
    }

    fn message(&self, text: &str) {
        message!("{text}");
    }
}

/// Layers of all lobes, from the pixels of their values and standard errors.
fn layers<'a>(lobes: impl Iterator<Item = [&'a [f32]; 2]>) -> Vec<LobeEstimate> {
    lobes
        .map(|[value, stderr]| LobeEstimate { value: value.to_vec(), stderr: stderr.to_vec() })
        .collect()
}

fn linear(picture: &Picture) -> Vec<f64> {
    picture.0.pixels().iter().flat_map(|rgb| rgb.to_array()).map(f64::from).collect()
}
