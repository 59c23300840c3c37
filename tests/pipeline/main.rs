//! The whole pipeline, as a person runs it: what comes out, what runs again, and what happens when something is wrong.

mod bad_input;
mod cache;
mod eval;
mod events;
mod extremes;
mod find_lights;
mod goldens;
mod layers;
mod planes;
mod project;
mod refine;
mod sameness;
mod scores;
