//! A network in a child process with limits: the child's side. It limits itself, then loads and
//! computes on request.

use std::io::{BufReader, Read, Result, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc;

use super::wire::{self, Request, read_head, read_tensors, write_head, write_numbers};
use super::{Backend, NetError, Network, Tensor, onnxruntime};

/// A request with all its bytes.
enum Work {
    Load { network: Vec<u8>, backend: Backend, library: Option<std::path::PathBuf>, threads: usize },
    Run { names: Vec<String>, inputs: Vec<Tensor>, outputs: Vec<String> },
}

/// Serves the program that started this process until that closes `input` or ends. Then another
/// thread calls `end`, which must end the process.
///
/// `main` calls this before it opens a file: on Unix, all files but the three standard ones are
/// closed, and the process is limited to `memory_bytes` of memory and `cpu_seconds` of processor
/// time.
///
/// # Errors
/// A limit cannot be set, or an answer cannot be written.
pub fn serve(
    memory_bytes: u64,
    cpu_seconds: u64,
    input: impl Read + Send + 'static,
    mut output: impl Write,
    end: impl FnOnce() + Send + 'static,
) -> Result<()> {
    #[cfg(unix)]
    confine(memory_bytes, cpu_seconds)?;
    #[cfg(not(unix))]
    let _ = (memory_bytes, cpu_seconds);
    let (send, work) = mpsc::channel();
    // This thread reads while the network computes, and so notices at once that the program has
    // ended.
    std::thread::spawn(move || {
        let mut input = BufReader::new(input);
        while read_work(&mut input).is_ok_and(|work| send.send(work).is_ok()) {}
        end();
    });
    let mut network = Err(NetError::Run("no network was loaded".into()));
    for work in work {
        match work {
            Work::Load { network: bytes, backend, library, threads } => {
                network = load(bytes, &backend, library, threads);
                let ports = network
                    .as_ref()
                    .map(|network| (network.inputs().to_vec(), network.outputs().to_vec()));
                let ports: wire::LoadAnswer = ports.map_err(NetError::clone);
                write_head(&mut output, &ports)?;
            }
            Work::Run { names, inputs, outputs } => {
                let inputs = names.iter().map(String::as_str).zip(inputs).collect();
                let computed = network
                    .as_ref()
                    .map_err(NetError::clone)
                    .and_then(|n| compute(n, inputs, &outputs));
                let shapes = computed
                    .as_ref()
                    .map(|all| all.iter().map(|tensor| tensor.shape().to_vec()).collect());
                let shapes: wire::Computed = shapes.map_err(NetError::clone);
                write_head(&mut output, &shapes)?;
                computed
                    .iter()
                    .flatten()
                    .try_for_each(|tensor| write_numbers(&mut output, tensor))?;
            }
        }
        output.flush()?;
    }
    Ok(())
}

fn read_work(input: &mut impl Read) -> Result<Work> {
    match read_head(input)? {
        Request::Load { backend, library, threads, bytes } => {
            let mut network = Vec::with_capacity(bytes as usize);
            input.take(bytes).read_to_end(&mut network)?;
            Ok(Work::Load { network, backend, library, threads })
        }
        Request::Run { inputs, outputs } => {
            let (names, shapes): (Vec<_>, Vec<_>) = inputs.into_iter().unzip();
            Ok(Work::Run { names, inputs: read_tensors(input, &shapes)?, outputs })
        }
    }
}

fn load(
    bytes: Vec<u8>,
    backend: &Backend,
    library: Option<std::path::PathBuf>,
    threads: usize,
) -> std::result::Result<Network, NetError> {
    if let Some(library) = library {
        onnxruntime::find(&library).map_err(NetError::NoBackend)?;
    }
    Network::load(bytes, backend, threads)
}

fn compute(
    network: &Network,
    inputs: Vec<(&str, Tensor)>,
    outputs: &[String],
) -> std::result::Result<Vec<Tensor>, NetError> {
    let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
    let computed = catch_unwind(AssertUnwindSafe(|| network.run_to(inputs, &outputs)));
    computed.unwrap_or_else(|_| Err(NetError::Run("computing it panicked".into())))
}

/// Address space for the program itself, its libraries, the stacks of its threads and the
/// allocator's reserves, bytes.
#[cfg(target_os = "linux")]
const ROOM: u64 = 1 << 30;
/// The most open files; ONNX Runtime opens some while it is loaded.
#[cfg(unix)]
const FILES: u64 = 64;

#[cfg(unix)]
fn confine(memory_bytes: u64, cpu_seconds: u64) -> Result<()> {
    use nix::sys::resource::{Resource, getrlimit, setrlimit};
    // Files that the program had inherited and not marked, or that a library of it opened so, were
    // passed on.
    let open: Vec<i32> = std::fs::read_dir("/dev/fd")?
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .collect();
    for file in open.into_iter().filter(|file| *file > 2) {
        // The listing itself had one, which is closed already.
        let _ = nix::unistd::close(file);
    }
    for (resource, most) in [
        (Resource::RLIMIT_DATA, memory_bytes),
        // Other systems count shared libraries that no process uses.
        #[cfg(target_os = "linux")]
        (Resource::RLIMIT_AS, memory_bytes.saturating_add(ROOM)),
        (Resource::RLIMIT_CPU, cpu_seconds),
        (Resource::RLIMIT_NOFILE, FILES),
        (Resource::RLIMIT_CORE, 0),
    ] {
        let set = getrlimit(resource)
            .and_then(|(_, hard)| setrlimit(resource, most.min(hard), most.min(hard)));
        // Linux has all of these limits; other systems may refuse one.
        if cfg!(target_os = "linux") {
            set?;
        }
    }
    Ok(())
}
