//! The engine, on stages that only add.

mod blobs;
mod budget;
mod conditions;
mod disk;
mod faults;
mod graphs;
mod hostile_cache;
mod nodes;
mod old_names;
mod random;
