//! Exceptions with the places of faults in files.

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use relight::files;
use relight::graph::{Diagnostic, RunReport};

create_exception!(
    relight,
    RelightError,
    PyException,
    "Files or arguments that cannot be used; `faults` lists each with its place."
);
create_exception!(
    relight,
    StageError,
    RelightError,
    "A stage gave no result; `faults` lists each failed node and its error."
);

/// A fault in a file or an argument.
#[pyclass(frozen, get_all, module = "relight")]
#[derive(Clone)]
pub struct Fault {
    /// The file, or the name of an argument or a node; empty without one.
    file: String,
    /// Line in the file, from 1.
    line: Option<usize>,
    /// Column in the file in characters, from 1.
    column: Option<usize>,
    /// The wanted and the actual content.
    message: String,
    /// A remedy.
    help: Option<String>,
}

#[pymethods]
impl Fault {
    fn __repr__(&self) -> String {
        let Fault { file, line, column, message, .. } = self;
        match (line, column) {
            (Some(line), Some(column)) => format!("Fault({file}:{line}:{column}: {message})"),
            _ => format!("Fault({file}: {message})"),
        }
    }
}

/// The exception for faults in files.
pub fn refused(py: Python, diagnostics: &[Diagnostic]) -> PyErr {
    let fault = |diagnostic: &Diagnostic| {
        let place = diagnostic.origin.as_ref().map(|origin| origin.line_column());
        Fault {
            file: diagnostic.path.display().to_string(),
            line: place.map(|(line, _)| line),
            column: place.map(|(_, column)| column),
            message: diagnostic.message.clone(),
            help: diagnostic.help.clone(),
        }
    };
    let text = files::draw(diagnostics, false);
    let error = RelightError::new_err(text.trim_end().to_owned());
    with_faults(py, error, diagnostics.iter().map(fault).collect())
}

/// The exception for a run whose stages failed.
pub fn failed(py: Python, report: &RunReport) -> PyErr {
    let faults: Vec<Fault> = report
        .failed()
        .map(|node| Fault {
            file: node.name.clone(),
            line: None,
            column: None,
            message: node.error.clone().unwrap_or_default(),
            help: None,
        })
        .collect();
    let lines: Vec<String> =
        faults.iter().map(|fault| format!("{}: {}", fault.file, fault.message)).collect();
    with_faults(py, StageError::new_err(lines.join("\n")), faults)
}

fn with_faults(py: Python, error: PyErr, faults: Vec<Fault>) -> PyErr {
    match error.value(py).setattr("faults", faults) {
        Ok(()) => error,
        Err(other) => other,
    }
}
