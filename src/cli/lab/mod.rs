//! `relight bench` and `relight eval`: the experiments of `relight-lab`, run on graphs of this
//! program. The feature `lab` turns them on.

mod args;
mod bench;
mod eval;
mod session;
mod target;

pub use args::{Bench, Eval};
pub use bench::bench;
pub use eval::eval;
