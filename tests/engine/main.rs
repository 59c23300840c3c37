//! The engine, on stages that only add.

mod budget;
mod disk;
mod faults;
mod graphs;
mod hostile_cache;
mod nodes;
mod random;
