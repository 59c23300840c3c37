//! The engine, on stages that only add.

mod disk;
mod faults;
mod graphs;
mod nodes;
mod random;
