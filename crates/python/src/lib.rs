//! The Python module `relight._relight`, on which `python/relight/__init__.py` stands.

mod errors;
mod run;
mod values;

use pyo3::prelude::*;

/// Native part of the package `relight`.
#[pymodule]
mod _relight {
    #[pymodule_export]
    use super::errors::{Fault, RelightError, StageError};
    #[pymodule_export]
    use super::run::{Run, Scene};
    #[pymodule_export]
    use super::values::Buffer;

    /// Version of the program that this module contains.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name of a version")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
