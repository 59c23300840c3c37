//! The whole pipeline through the command and the library: results, repeated runs, and faults.

#[path = "../common/mod.rs"]
mod common;

mod adapters;
mod bad_input;
mod cache;
mod damaged_networks;
mod depth_conventions;
mod eval;
mod events;
mod export;
mod extremes;
mod find_lights;
mod golden_networks;
mod goldens;
mod grain;
mod hostile;
mod layers;
mod lights;
mod materials;
mod mix;
mod networks;
mod objects;
mod old_names;
mod onnx;
mod page;
mod planes;
mod polish;
mod project;
mod provenance;
mod refine;
mod rooms;
mod sameness;
mod scores;
mod sequence;
mod stages;

mod untrusted_networks;
mod work;
