//! Adds a stage: parameters, ports and a `run`, used by the graph file beside this one.
//!
//! `cargo run --release --example add_stage -- scenes/demo edits/lamp_off.ron out/exposed.png`

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use relight::graph::{Cancel, Context, Engine, EngineOptions, Node, NodeError};
use relight::image::{Picture, Transfer, write_png};
use relight::{files, nodes, params, ports};

params! {
    /// Multiplies a picture by a power of two, as the exposure of a camera does.
    pub struct Expose {
        /// The exposure value in stops, any finite number; 1 doubles the light.
        stops: f32 = 0.0,
    }
}
ports! {
    pub input ExposeIn {
        /// A picture in linear Rec. 709.
        picture: Arc<Picture>,
    }
}
ports! {
    pub output ExposeOut {
        /// 2^stops times the picture.
        picture: Arc<Picture>,
    }
}

impl Node for Expose {
    const KIND: &'static str = "Expose";
    const VERSION: u32 = 1;
    type In = ExposeIn;
    type Out = ExposeOut;

    fn run(&self, inputs: ExposeIn, _: &Context) -> Result<ExposeOut, NodeError> {
        let gain = self.stops.exp2();
        if !gain.is_finite() {
            return Err(NodeError::BadParameter(format!(
                "stops: wanted a finite exposure, got {}",
                self.stops
            )));
        }
        Ok(ExposeOut { picture: Arc::new(Picture(inputs.picture.0.map(|color| gain * color))) })
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, edit, out] = &arguments[..] else { return Err("wanted SCENE EDIT OUT.png".into()) };
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));

    // The shipped stages and the one above; from here on a graph file may name it, and the engine
    // caches it.
    let registry = nodes::registry().with::<Expose>().with_library(project.join("models"), "");
    let graph = files::load(
        &project.join("examples/add_stage.ron"),
        scene.as_ref(),
        edit.as_ref(),
        &registry,
    );
    let graph = graph.map_err(|faults| files::draw(&faults, false))?;

    let engine = Engine::new(EngineOptions::default())?;
    let wanted = graph.wanted(None).map_err(|fault| fault.to_string())?;
    let report = engine.run(&graph, &wanted, &Cancel::default(), &());
    if let Some((node, error)) = report.error() {
        return Err(format!("{node}: {error}").into());
    }
    let picture = report.value::<Picture>("exposed.picture").ok_or("the graph has no picture")?;
    std::fs::write(out, write_png(&picture, Transfer::Srgb, false))?;
    Ok(())
}
