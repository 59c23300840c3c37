//! Inverse rendering and relighting of an indoor photograph.
//!
//! From a photograph, its depth and masks of the visible lamps and windows, the stages in [`nodes`]
//! estimate materials and physical light sources, and render the room under edited light. A graph
//! file wires the stages; the engine in [`graph`] computes its outputs and caches every result. The
//! mathematics is in [`optics`], [`geometry`] and [`image`], as functions without the engine.
//!
//! ```no_run
//! use relight::graph::{Cancel, Engine, EngineOptions};
//! use relight::{files, image::Picture, nodes};
//!
//! let registry = nodes::registry().with_library("models".into(), "");
//! let [graph, scene, edit] = ["graphs/indoor.ron", "scenes/demo", "edits/lamp_off.ron"].map(AsRef::as_ref);
//! let graph = files::load(graph, scene, edit, &registry).expect("the files are sound");
//! let wanted = graph.wanted(Some(&["compose.picture".to_owned()])).expect("the graph has a picture");
//! let engine = Engine::new(EngineOptions::default()).expect("threads can be started");
//! let report = engine.run(&graph, &wanted, &Cancel::default(), &());
//! let picture = report.value::<Picture>("compose.picture").expect("the run is complete");
//! println!("linear Rec. 709 at pixel (0, 0): {}", picture.0.get(0, 0));
//! ```
//!
//! `examples/` relights a photo, adds a stage and mixes the layers of a finished run.

#![warn(
    clippy::disallowed_methods,
    clippy::disallowed_types,
    clippy::print_stderr,
    clippy::print_stdout
)]
#![warn(clippy::unwrap_used)]

pub mod files;
mod formats;
pub mod geometry;
pub mod graph;
pub mod image;
pub mod net;
pub mod nodes;
pub mod optics;
pub mod tuning;
