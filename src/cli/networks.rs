//! The folder and the backend of the networks.

use std::path::{Path, PathBuf};

use relight::graph::{Diagnostic, Registry};
use relight::net::{Backend, Limits, Sandbox, Untrusted, find_onnxruntime, serve};
use relight::nodes;

use super::args::{Networks, RunNetwork, WhichBackend};
use super::exit::{CliError, Exit};
use super::messages::message;
use super::shipped;

/// The parameter that selects the backend, of every stage with a network.
pub const FIELD: &str = "backend";
const HELP: &str = "the networks ship in the folder models/: keep it beside the program, or name it with --models DIR";

/// All stages, with the folder of their networks.
pub fn registry(args: &Networks) -> Registry {
    let folder = args.models.clone().map_or_else(shipped::networks, Ok);
    // Without the folder, the networks are missing, and the error of a stage that needs one says
    // so.
    let folder = folder.unwrap_or_else(|fault| {
        message!("warning: {fault}");
        "models".into()
    });
    nodes::registry().with_library(folder, HELP)
}

/// The service that computes third-party networks by `relight run-network`, each in its own
/// process.
pub fn untrusted() -> Untrusted {
    // The system finds ONNX Runtime and the libraries that it needs by these.
    let names = ["LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "PATH", "SYSTEMROOT"];
    let environment =
        names.into_iter().filter_map(|name| Some((name.into(), std::env::var_os(name)?)));
    Untrusted::Sandboxed(Sandbox {
        // A program that cannot be found is an error when it is to be started.
        program: std::env::current_exe().unwrap_or_default(),
        arguments: vec!["run-network".into()],
        environment: environment.collect(),
        limits: Limits::default(),
    })
}

/// `relight run-network`.
///
/// # Errors
/// A request cannot be read, or an answer cannot be written.
pub fn run_network(args: &RunNetwork) -> Result<Exit, CliError> {
    let end = || std::process::exit(Exit::Done.code().into());
    serve(args.memory_bytes, args.cpu_seconds, std::io::stdin(), std::io::stdout().lock(), end)
        .map_err(|e| {
            Diagnostic::file("run-network".as_ref(), format!("the network cannot be served: {e}"))
        })?;
    Ok(Exit::Done)
}

/// The backend of the networks, and the reason for it.
pub struct Choice {
    pub backend: Backend,
    pub why: String,
}

/// Chooses the backend; searches ONNX Runtime unless the arguments name rten.
///
/// # Errors
/// A library that the arguments name or require cannot be used.
pub fn choose(args: &Networks) -> Result<Choice, Diagnostic> {
    let named = args.onnxruntime.clone().map(|path| (path, "--onnxruntime"));
    let variable = || std::env::var_os("ORT_DYLIB_PATH").filter(|v| !v.is_empty());
    let named = named.or_else(|| variable().map(|path| (PathBuf::from(path), "ORT_DYLIB_PATH")));
    let found = |backend, path: &Path, how: &str| Choice {
        backend,
        why: format!("found at {} ({how})", path.display()),
    };
    match (args.backend, named) {
        (WhichBackend::Rten, _) => {
            Ok(Choice { backend: Backend::Rten, why: "requested with --backend".into() })
        }
        (_, Some((path, how))) => match find_onnxruntime(&path) {
            Ok(backend) => Ok(found(backend, &path, how)),
            Err(e) => Err(Diagnostic::file(
                &path,
                format!("wanted a library of ONNX Runtime 1.17 or later ({how}): {e}"),
            )
            .help(match cfg!(feature = "rten") {
                true => "--backend rten needs no library",
                false => "this program was built without rten, the backend that needs no library",
            })),
        },
        (which, None) => {
            let path = Path::new(SYSTEM);
            match find_onnxruntime(path) {
                Ok(backend) => Ok(found(backend, path, "in the library path of the system")),
                Err(_) if which == WhichBackend::Auto => Ok(Choice {
                    backend: Backend::Rten,
                    why: "no ONNX Runtime was found; it is about twice as fast: --onnxruntime PATH names its library"
                        .into(),
                }),
                Err(e) => Err(Diagnostic::file("--backend".as_ref(), format!("no ONNX Runtime was found: {e}"))
                    .help("name its library with --onnxruntime PATH")),
            }
        }
    }
}

#[cfg(windows)]
const SYSTEM: &str = "onnxruntime.dll";
#[cfg(target_os = "macos")]
const SYSTEM: &str = "libonnxruntime.dylib";
#[cfg(not(any(windows, target_os = "macos")))]
const SYSTEM: &str = "libonnxruntime.so";

/// Whether nodes of this kind have a network.
pub fn has_network(registry: &Registry, kind: &str) -> bool {
    registry.get(kind).is_some_and(|spec| spec.params.iter().any(|param| param.name == FIELD))
}
