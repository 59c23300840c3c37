//! Microsoft's ONNX Runtime, where its library is found: the faster backend.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{Outlet, ValueType};

use super::{Backend, NetError, Port, Tensor};

/// A process can hold one such library, and never gives it back.
static LIBRARY: OnceLock<Result<Library, String>> = OnceLock::new();

struct Library {
    path: PathBuf,
    environment: Environment,
    build: String,
}

/// Loads the library at `path`, or, of a bare file name, where the system looks for libraries. A
/// library that is loaded already stays.
///
/// # Errors
/// The reason why the library cannot be used.
pub fn find(path: &Path) -> Result<Backend, String> {
    let open = || -> Result<Library, String> {
        let builder = ort::init_from(path).map_err(|e| e.to_string())?;
        let environment = builder
            .with_name("relight")
            .with_telemetry(false)
            .build()
            .map_err(|e| e.to_string())?;
        Ok(Library { path: path.to_owned(), environment, build: build(ort::info()) })
    };
    match LIBRARY.get_or_init(open) {
        Ok(library) => Ok(Backend::OnnxRuntime(library.build.clone())),
        Err(message) => Err(message.clone()),
    }
}

/// The path of the loaded library.
pub fn library() -> Option<PathBuf> {
    Some(LIBRARY.get()?.as_ref().ok()?.path.clone())
}

/// The commit that a library was built from; its whole build string where that names none.
fn build(info: &str) -> String {
    let commit = info.split("git-commit-id=").nth(1).and_then(|rest| rest.split([',', ' ']).next());
    commit.filter(|commit| !commit.is_empty()).unwrap_or(info).to_owned()
}

pub struct OrtNetwork {
    /// A session computes one picture at a time.
    session: Mutex<Session>,
}

impl OrtNetwork {
    /// Loads a network with the library whose build is `wanted`; returns its inputs and outputs,
    /// too.
    ///
    /// # Errors
    /// No library or another build is loaded, or the library refuses the network.
    pub fn new(
        bytes: &[u8],
        wanted: &str,
        threads: usize,
    ) -> Result<(OrtNetwork, Vec<Port>, Vec<Port>), NetError> {
        let Some(Ok(Library { environment, build, .. })) = LIBRARY.get() else {
            return Err(NetError::NoBackend(
                "no ONNX Runtime is loaded: name its library, or use the backend rten".into(),
            ));
        };
        if build != wanted {
            return Err(NetError::NoBackend(format!(
                "wanted ONNX Runtime {wanted}, the library that is loaded is {build}"
            )));
        }
        let open = || -> ort::Result<Session> {
            Session::builder(environment)?
                .with_optimization_level(GraphOptimizationLevel::All)?
                .with_intra_threads(threads)?
                // Threads that wait by spinning would take the processor from the rays that are
                // traced beside.
                .with_intra_op_spinning(false)?
                .commit_from_memory(bytes)
        };
        let session = open().map_err(|e| NetError::Damaged(e.to_string()))?;
        let (inputs, outputs) = (
            session.inputs().iter().map(port).collect(),
            session.outputs().iter().map(port).collect(),
        );
        Ok((OrtNetwork { session: Mutex::new(session) }, inputs, outputs))
    }

    /// Computes the outputs of these names, in their order.
    ///
    /// # Errors
    /// The inputs do not fit the network, or computing it fails.
    pub fn run(
        &self,
        inputs: Vec<(&str, Tensor)>,
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, NetError> {
        let failed = |e: ort::Error| NetError::Run(e.to_string());
        let mut values = Vec::new();
        for (name, tensor) in inputs {
            let shape = tensor.shape().to_vec();
            let value =
                ort::value::Tensor::from_array((shape, tensor.into_data())).map_err(failed)?;
            values.push((name, value));
        }
        let mut session = self.session.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let got = session.run(values).map_err(failed)?;
        let taken = outputs.iter().map(|name| {
            let value = got
                .get(*name)
                .ok_or_else(|| NetError::Run(format!("it returned no output `{name}`")))?;
            let (shape, data) = value.try_extract_tensor::<f32>().map_err(failed)?;
            let shape: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
            Ok(Tensor::new(&shape, data.to_vec()))
        });
        taken.collect()
    }
}

fn port(outlet: &Outlet) -> Port {
    let shape = match outlet.dtype() {
        ValueType::Tensor { shape, .. } => {
            Some(shape.iter().map(|&n| usize::try_from(n).ok()).collect())
        }
        _ => None,
    };
    Port { name: outlet.name().to_owned(), shape }
}
