//! Inverse rendering and relighting of an indoor photograph.
//!
//! From a photograph, its depth and masks of the visible lamps and windows, the stages in [`nodes`]
//! estimate materials and physical light sources, and render the room under edited light. A graph
//! file wires the stages; the engine in [`graph`] computes its outputs and caches every result. The
//! mathematics is in [`optics`], [`geometry`] and [`image`], as functions without the engine.
//!
//! ```
//! use relight::graph::{Cancel, Engine, EngineOptions};
//! use relight::{files, image::Picture, nodes};
//!
//! // graphs/indoor.ron is better, and needs the networks:
//! // `nodes::registry().with_library("models".into(), "")`.
//! let files = ["graphs/physics.ron", "tests/scenes/small", "edits/lamp_off.ron"];
//! let [graph, scene, edit] = files.map(AsRef::as_ref);
//! let graph = files::load(graph, scene, edit, &nodes::registry()).expect("the files are sound");
//! let wanted = graph.wanted(Some(&["compose.picture".to_owned()])).expect("the graph has a picture");
//! let engine = Engine::new(EngineOptions::default()).expect("threads can be started");
//! let report = engine.run(&graph, &wanted, &Cancel::default(), &());
//! let picture = report.value::<Picture>("compose.picture").expect("the run is complete");
//! assert_eq!(picture.0.size(), (320, 240)); // linear Rec. 709, in units of the photo
//! ```
//!
//! `examples/` relights a photo, adds a stage and mixes the layers of a finished run.
//!
//! # Features
//!
//! All but `rten` and `heic` are for the program, and leave the library as it is.
//!
//! - `bundled-networks` (default): the networks that ship, 18 MB.
//! - `rten` (default): the runtime of networks in pure Rust; without it, networks need the library
//!   of ONNX Runtime.
//! - `serve` (default): `relight serve`.
//! - `lab` (default): `relight bench` and `relight eval`.
//! - `store` (default): `--cache-store`, a cache in an object store.
//! - `heic`: photos in HEIC and AVIF by libheif, a C++ library of the system; the library reads
//!   them, too.
//!
//! # Stability
//!
//! [`graph`], [`files`], [`image`], and parameters and ports of [`nodes`] follow Semantic
//! Versioning; functions of [`optics`] and [`geometry`] change with their algorithms
//! (docs/stability.md).

#![forbid(unsafe_code)]
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
