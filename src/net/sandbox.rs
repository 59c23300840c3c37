//! A network in a child process with limits: the program's side. The child's side is
//! [`super::guest`].
//!
//! The child is not trusted: its answers are held against limits, its time is limited from here,
//! and its standard error is read only to recognize a failed allocation.

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::wire::{self, Request, read_head, read_tensors, write_head, write_numbers};
use super::{Backend, NetError, Port, Tensor, onnxruntime};

/// The process that computes networks which do not ship with relight. An engine lends it to its
/// stages as a service; without it, stages refuse such networks.
#[derive(Clone, Debug)]
pub enum Untrusted {
    /// This process, which a hostile file can abort, hang or fill: for programs that trust their
    /// networks.
    InProcess,
    /// A child process for each.
    Sandboxed(Sandbox),
}

/// The command that starts a child process: `program arguments.. MEMORY_BYTES CPU_SECONDS`. It must
/// call [`super::serve`].
#[derive(Clone, Debug)]
pub struct Sandbox {
    /// Path of the executable.
    pub program: PathBuf,
    /// Arguments before the two limits.
    pub arguments: Vec<OsString>,
    /// The child's whole environment, but for two variables that limit libraries.
    pub environment: Vec<(OsString, OsString)>,
    /// Memory and time that the child may use.
    pub limits: Limits,
}

/// Limits of a child process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Memory, on Unix.
    pub memory_bytes: u64,
    /// Time to load the network.
    pub load: Duration,
    /// Time to compute its outputs once.
    pub run: Duration,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            memory_bytes: 4 << 30,
            load: Duration::from_secs(60),
            run: Duration::from_secs(600),
        }
    }
}

/// The interval at which a waiting program checks for a cancelled run and for the limit.
const POLL: Duration = Duration::from_millis(20);
/// Bytes that are kept of the child's standard error.
const MAX_SAID: u64 = 4096;

pub struct Process {
    running: Mutex<Running>,
    limits: Limits,
    cancelled: Box<dyn Fn() -> bool + Send + Sync>,
}

struct Running {
    child: Child,
    requests: ChildStdin,
    replies: ChildStdout,
    errors: Option<JoinHandle<Vec<u8>>>,
}

impl Process {
    /// Starts a child that holds the network of `bytes`; returns its inputs and outputs too.
    ///
    /// # Errors
    /// The child cannot be started, exceeds a limit, or refuses the network.
    pub fn start(
        sandbox: &Sandbox,
        bytes: &[u8],
        backend: &Backend,
        threads: usize,
        cancelled: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<(Process, Vec<Port>, Vec<Port>), NetError> {
        let running = Running::spawn(sandbox, threads).map_err(|e| {
            NetError::Ended(format!(
                "its process, {}, cannot be started: {e}",
                sandbox.program.display()
            ))
        })?;
        let process = Process {
            running: Mutex::new(running),
            limits: sandbox.limits.clone(),
            cancelled: Box::new(cancelled),
        };
        let request = Request::Load {
            backend: backend.clone(),
            library: onnxruntime::library().filter(|_| *backend != Backend::Rten),
            threads,
            bytes: bytes.len() as u64,
        };
        let (inputs, outputs) =
            process.ask("loading", sandbox.limits.load, |requests, replies| {
                write_head(requests, &request)?;
                requests.write_all(bytes)?;
                read_head::<wire::LoadAnswer>(replies)
            })?;
        Ok((process, inputs, outputs))
    }

    /// Computes the outputs of these names in the child process, in their order.
    ///
    /// # Errors
    /// The network fails, or the child exceeds a limit or ends.
    pub fn run(
        &self,
        inputs: Vec<(&str, Tensor)>,
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, NetError> {
        let head = Request::Run {
            inputs: inputs
                .iter()
                .map(|(name, tensor)| ((*name).to_owned(), tensor.shape().to_vec()))
                .collect(),
            outputs: outputs.iter().map(|name| (*name).to_owned()).collect(),
        };
        self.ask("computing", self.limits.run, |requests, replies| {
            write_head(requests, &head)?;
            inputs.iter().try_for_each(|(_, tensor)| write_numbers(requests, tensor))?;
            match read_head::<wire::Computed>(replies)? {
                Ok(shapes) if shapes.len() == outputs.len() => {
                    Ok(Ok(read_tensors(replies, &shapes)?))
                }
                Ok(shapes) => Err(std::io::Error::new(
                    std::io::ErrorKind::InvalidData,
                    format!("wanted {} outputs, got {}", outputs.len(), shapes.len()),
                )),
                Err(error) => Ok(Err(error)),
            }
        })
    }

    /// Exchanges messages with the child on a thread of its own, so that this thread can end the
    /// exchange: it kills the child, which closes the pipes.
    fn ask<T: Send>(
        &self,
        doing: &str,
        limit: Duration,
        exchange: impl FnOnce(&mut ChildStdin, &mut ChildStdout) -> std::io::Result<Result<T, NetError>>
        + Send,
    ) -> Result<T, NetError> {
        #[expect(
            clippy::disallowed_methods,
            reason = "limits the time of the child; a result does not depend on it"
        )]
        let began = Instant::now();
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let Running { child, requests, replies, errors } = &mut *running;
        let (done, answers) = mpsc::channel();
        let mut stopped = None;
        let answer = std::thread::scope(|scope| {
            // The receiver outlives this thread.
            scope.spawn(move || drop(done.send(exchange(requests, replies))));
            loop {
                match answers.recv_timeout(POLL) {
                    Err(mpsc::RecvTimeoutError::Timeout) => {}
                    answer => break answer.ok(),
                }
                if stopped.is_none() && (self.cancelled)() {
                    stopped = Some(NetError::Cancelled);
                } else if stopped.is_none() && began.elapsed() > limit {
                    stopped = Some(NetError::Limit(format!(
                        "{doing} it took longer than the {} s that are allowed",
                        limit.as_secs_f32()
                    )));
                } else {
                    continue;
                }
                // This fails only for a child that has ended.
                drop(child.kill());
            }
        });
        match (stopped, answer) {
            (Some(stopped), _) => Err(stopped),
            (None, Some(Ok(answer))) => answer.map_err(NetError::shortened),
            (None, _) if (self.cancelled)() => Err(NetError::Cancelled),
            (None, Some(Err(error))) if error.kind() == std::io::ErrorKind::InvalidData => {
                drop(child.kill());
                Err(NetError::Ended(format!(
                    "its process returned an answer that cannot be read: {error}"
                )))
            }
            (None, _) => Err(self.cause(child, errors)),
        }
    }

    /// Returns the cause of the child's end; its pipes are closed.
    fn cause(&self, child: &mut Child, errors: &mut Option<JoinHandle<Vec<u8>>>) -> NetError {
        let ended = match ended(child) {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let said = errors.take().and_then(|errors| errors.join().ok()).unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        tracing::debug!(%ended, ?said, "the process of a network ended");
        if said.contains("memory allocation of ") {
            let gib = self.limits.memory_bytes as f64 / (1u64 << 30) as f64;
            return NetError::Limit(format!(
                "it wanted more memory than the {gib} GiB that are allowed"
            ));
        }
        NetError::Ended(format!("its process ended before it answered: {ended}"))
    }
}

/// Returns the exit status of a child that has closed its pipes; one that stays is killed after a
/// second.
fn ended(child: &mut Child) -> std::io::Result<ExitStatus> {
    for _ in 0..50 {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        std::thread::sleep(POLL);
    }
    child.kill()?;
    child.wait()
}

impl Running {
    fn spawn(sandbox: &Sandbox, threads: usize) -> std::io::Result<Running> {
        let Limits { memory_bytes, load, run } = &sandbox.limits;
        let cpu_seconds = (load.as_secs() + run.as_secs() + 1).saturating_mul(threads as u64 + 1);
        let mut command = Command::new(&sandbox.program);
        command.args(&sandbox.arguments).arg(memory_bytes.to_string()).arg(cpu_seconds.to_string());
        command.env_clear().envs(sandbox.environment.iter().map(|(name, value)| (name, value)));
        // Each of glibc's arenas reserves address space, which is limited.
        command.env("MALLOC_ARENA_MAX", "4");
        // ONNX Runtime 1.32 keeps a file of telemetry.
        command.env("ORT_DISABLE_TELEMETRY", "1");
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C in a terminal is for the program alone, which then ends the child.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(requests), Some(replies), Some(mut errors)) = pipes else {
            unreachable!("all three are piped")
        };
        let errors = std::thread::spawn(move || {
            let mut kept = Vec::new();
            // The rest goes nowhere, so that the child never waits for a reader.
            let all = errors.by_ref().take(MAX_SAID).read_to_end(&mut kept);
            drop(all.and_then(|_| std::io::copy(&mut errors, &mut std::io::sink())));
            kept
        });
        Ok(Running { child, requests, replies, errors: Some(errors) })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}
