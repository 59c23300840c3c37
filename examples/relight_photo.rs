//! Relights a photograph: loads a graph, a scene and an edit, runs them and writes the picture as a
//! PNG.
//!
//! `cargo run --release --example relight_photo -- scenes/demo edits/lamp_off.ron out/relit.png`

use std::error::Error;
use std::path::Path;

use relight::graph::{Cancel, Engine, EngineOptions};
use relight::image::{Picture, Transfer, write_png};
use relight::{files, nodes};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, edit, out] = &arguments[..] else { return Err("wanted SCENE EDIT OUT.png".into()) };
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));

    // The stages, with the networks that ship; the graph file wires them.
    let registry = nodes::registry().with_library(project.join("models"), "");
    let graph =
        files::load(&project.join("graphs/indoor.ron"), scene.as_ref(), edit.as_ref(), &registry);
    let graph = graph.map_err(|faults| files::draw(&faults, false))?;

    // The engine computes this output and its dependencies, on all cores.
    let engine = Engine::new(EngineOptions::default())?;
    let wanted =
        graph.wanted(Some(&["compose.picture".to_owned()])).map_err(|fault| fault.to_string())?;
    let report = engine.run(&graph, &wanted, &Cancel::default(), &());
    if let Some((node, error)) = report.error() {
        return Err(format!("{node}: {error}").into());
    }

    // A picture is linear, scene-referred Rec. 709 in units of the photo; the PNG encodes it as
    // sRGB.
    let picture = report.value::<Picture>("compose.picture").ok_or("the graph has no picture")?;
    std::fs::write(out, write_png(&picture, Transfer::Srgb, false))?;
    println!("{out}: {} nodes", report.nodes.len());
    Ok(())
}
