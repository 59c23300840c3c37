//! Networks behind one function: ONNX in, planes in, planes out, whichever backend computes them.
//!
//! [`Backend::Rten`] is there with the feature `rten`; [`Backend::OnnxRuntime`] once
//! [`find_onnxruntime`] has loaded its library. On one backend, the same inputs give the same bits
//! for any number of threads; between backends, results differ by rounding (tests/networks.rs).

mod guest;
mod onnxruntime;
mod planes;
mod precheck;
#[cfg(feature = "rten")]
mod rten;
#[cfg(not(feature = "rten"))]
#[path = "without_rten.rs"]
mod rten;
mod sandbox;
mod shipped;
mod tensor;
pub mod third_party;
pub mod view;
mod wire;

use serde::{Deserialize, Serialize};

use crate::tuning::Table;

pub use guest::serve;
pub use onnxruntime::find as find_onnxruntime;
pub use planes::{InputLayer, planes_of};
pub use precheck::precheck;
pub use sandbox::{Limits, Sandbox, Untrusted};
pub use shipped::{CARDS, ships};
pub use tensor::Tensor;

/// The constants of what networks take.
pub fn tuning() -> Vec<Table> {
    vec![view::ViewTuning::table()]
}

/// The library that computes a network.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Backend {
    /// In pure Rust, part of this program.
    #[default]
    Rten,
    /// A library of Microsoft's ONNX Runtime found at the start; the text names its build, as
    /// builds may differ in rounding.
    OnnxRuntime(String),
}

impl std::fmt::Display for Backend {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Backend::Rten => write!(f, "rten"),
            Backend::OnnxRuntime(_) => write!(f, "ONNX Runtime"),
        }
    }
}

/// Why a network gave nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum NetError {
    /// The file is not a network, or one that this backend cannot run.
    #[error("{0}")]
    Damaged(String),
    /// Its inputs or outputs differ from the expected ones.
    #[error("{0}")]
    Mismatch(String),
    /// The backend is not there.
    #[error("{0}")]
    NoBackend(String),
    /// It could not be computed.
    #[error("{0}")]
    Run(String),
    /// It takes more memory or time than its child process is allowed.
    #[error("{0}")]
    Limit(String),
    /// Its child process has ended.
    #[error("{0}")]
    Ended(String),
    /// The run was cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl NetError {
    /// Cuts the message of a process that is not trusted to [`MAX_TEXT`].
    fn shortened(mut self) -> NetError {
        use NetError::{Damaged, Ended, Limit, Mismatch, NoBackend, Run};
        if let Damaged(text) | Mismatch(text) | NoBackend(text) | Run(text) | Limit(text)
        | Ended(text) = &mut self
        {
            text.truncate(text.floor_char_boundary(MAX_TEXT));
        }
        self
    }
}

/// The longest message of a process that is not trusted, bytes.
const MAX_TEXT: usize = 1000;

/// An input or output: its name, and its shape as far as it is fixed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Name in the ONNX file.
    pub name: String,
    /// `None` for a dimension, or for all of them, that the file leaves open.
    pub shape: Option<Vec<Option<usize>>>,
}

/// A network that is loaded and ready.
pub struct Network {
    model: Loaded,
    caution: Option<&'static str>,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

enum Loaded {
    Rten(Box<rten::RtenNetwork>),
    OnnxRuntime(Box<onnxruntime::OrtNetwork>),
    Child(Box<sandbox::Process>),
}

impl Network {
    /// A network from the bytes of an ONNX file, computed in this process by at most `threads`
    /// threads. The file must be trusted: a hostile one can abort, hang or fill the process.
    ///
    /// # Errors
    /// `Damaged`, `NoBackend`.
    pub fn load(bytes: Vec<u8>, backend: &Backend, threads: usize) -> Result<Network, NetError> {
        let caution = caution(&bytes, backend);
        let (model, inputs, outputs) = match backend {
            Backend::Rten => {
                let (loaded, inputs, outputs) = rten::RtenNetwork::new(bytes, threads)?;
                (Loaded::Rten(Box::new(loaded)), inputs, outputs)
            }
            Backend::OnnxRuntime(build) => {
                let (loaded, inputs, outputs) =
                    onnxruntime::OrtNetwork::new(&bytes, build, threads)?;
                (Loaded::OnnxRuntime(Box::new(loaded)), inputs, outputs)
            }
        };
        Ok(Network { model, caution, inputs, outputs })
    }

    /// The same for a file that may be hostile: a child process with limits computes it, to the
    /// same bits. While a call waits for the child, it polls `cancelled`.
    ///
    /// # Errors
    /// `Damaged`, `NoBackend`, `Limit`, `Ended`, `Cancelled`.
    pub fn load_sandboxed(
        bytes: &[u8],
        backend: &Backend,
        threads: usize,
        sandbox: &Sandbox,
        cancelled: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<Network, NetError> {
        precheck(bytes).map_err(NetError::Damaged)?;
        let (process, inputs, outputs) =
            sandbox::Process::start(sandbox, bytes, backend, threads, cancelled)?;
        Ok(Network {
            model: Loaded::Child(Box::new(process)),
            caution: caution(bytes, backend),
            inputs,
            outputs,
        })
    }

    /// Why its results may be wrong on this backend, where they may.
    pub fn caution(&self) -> Option<&str> {
        self.caution
    }

    /// Returns the inputs, in the order of the file.
    pub fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    /// Returns the outputs, in the order of the file.
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    /// Whether these are its inputs and among its outputs, by name and shape.
    ///
    /// # Errors
    /// `Mismatch`, which names the first that is not.
    pub fn expect(&self, inputs: &[(&str, &[usize])], outputs: &[&str]) -> Result<(), NetError> {
        let names =
            |ports: &[Port]| ports.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ");
        for (name, wanted) in inputs {
            let Some(port) = self.inputs.iter().find(|port| port.name == *name) else {
                return Err(NetError::Mismatch(format!(
                    "wanted an input `{name}`, got {}",
                    names(&self.inputs)
                )));
            };
            let fits = port.shape.as_ref().is_none_or(|shape| {
                shape.len() == wanted.len()
                    && shape.iter().zip(*wanted).all(|(got, w)| got.is_none_or(|got| got == *w))
            });
            if !fits {
                return Err(NetError::Mismatch(format!(
                    "input `{name}`: wanted {wanted:?}, got {}",
                    shown(port)
                )));
            }
        }
        if let Some(port) =
            self.inputs.iter().find(|port| inputs.iter().all(|(name, _)| port.name != *name))
        {
            return Err(NetError::Mismatch(format!(
                "it has an input `{}` without a value",
                port.name
            )));
        }
        for name in outputs {
            if self.outputs.iter().all(|port| port.name != *name) {
                return Err(NetError::Mismatch(format!(
                    "wanted an output `{name}`, got {}",
                    names(&self.outputs)
                )));
            }
        }
        Ok(())
    }

    /// Computes the outputs of these names from all inputs.
    ///
    /// # Errors
    /// `Run`; `Mismatch` when an output that is not all finite 32-bit numbers comes out; `Limit`,
    /// `Ended` or `Cancelled` from a child process.
    pub fn run<const N: usize>(
        &self,
        inputs: Vec<(&str, Tensor)>,
        outputs: [&str; N],
    ) -> Result<[Tensor; N], NetError> {
        let got = self.run_to(inputs, &outputs)?;
        got.try_into().map_err(|_| {
            NetError::Run("it returned another number of outputs than requested".into())
        })
    }

    /// [`Network::run`] for any number of outputs.
    ///
    /// # Errors
    /// Those of [`Network::run`].
    pub fn run_to(
        &self,
        inputs: Vec<(&str, Tensor)>,
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, NetError> {
        let got = match &self.model {
            Loaded::Rten(model) => model.run(inputs, outputs)?,
            Loaded::OnnxRuntime(model) => model.run(inputs, outputs)?,
            Loaded::Child(process) => process.run(inputs, outputs)?,
        };
        for (name, tensor) in outputs.iter().zip(&got) {
            if let Some(wrong) = tensor.data().iter().find(|v| !v.is_finite()) {
                return Err(NetError::Mismatch(format!(
                    "output `{name}`: wanted finite numbers, got {wrong}"
                )));
            }
        }
        Ok(got)
    }
}

fn caution(bytes: &[u8], backend: &Backend) -> Option<&'static str> {
    if *backend == Backend::Rten { rten::caution(bytes) } else { None }
}

fn shown(port: &Port) -> String {
    let open = |n: &Option<usize>| n.map_or("?".to_owned(), |n| n.to_string());
    let shape =
        port.shape.as_ref().map(|shape| shape.iter().map(open).collect::<Vec<_>>().join(", "));
    shape.map_or("any shape".into(), |shape| format!("[{shape}]"))
}
