//! The client of an object store.
//!
//! One thread runs the requests beside the engine. A request that fails, or takes too long, is a
//! miss and a warning; after a few failures in a row the store is left alone for a while. Uploads
//! wait in a queue of bounded size, and [`Client::flush`] waits for them.

use std::fmt::{self, Debug};
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use futures_util::future::join_all;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutPayload};
use relight::graph::{BlobStore, Diagnostic};
use tokio::sync::{Semaphore, mpsc};

use super::Traffic;
use super::address::{self, PATIENCE};
use super::secrets::Secrets;
use crate::cli::messages::message;

/// Bytes a second below which a store counts as missing.
const SLOWEST: f64 = 1e6;
/// Failures in a row after which the store is left alone.
const FAILURES: u32 = 3;
/// The time for which it is left alone, doubled each time up to a limit.
const PAUSE: Duration = Duration::from_secs(30);
const LONGEST_PAUSE: Duration = Duration::from_secs(600);
/// Most bytes that wait for their upload.
const QUEUE: u64 = 256 << 20;
/// Requests at a time, of each kind.
const AT_ONCE: usize = 16;
/// Most time that the end of a command waits for uploads.
const LAST_WAIT: Duration = Duration::from_secs(120);

/// A store, reached by a thread of its own.
pub struct Client {
    state: Arc<State>,
    commands: Option<mpsc::UnboundedSender<Command>>,
    thread: Option<JoinHandle<()>>,
}

struct State {
    /// The address as it is shown.
    address: String,
    store: Box<dyn ObjectStore>,
    prefix: Path,
    secrets: Secrets,
    readers: Semaphore,
    writers: Semaphore,
    /// Bytes in the queue of uploads, and the number of results there.
    queue: Mutex<(u64, u64)>,
    moved: Condvar,
    health: Mutex<Health>,
    counts: Counts,
}

#[derive(Default)]
struct Health {
    /// Failures since the last success.
    in_a_row: u32,
    until: Option<Instant>,
    pauses: u32,
    /// The first failure since warnings were taken, and the number of the others.
    warning: Option<(String, u64)>,
}

#[derive(Default)]
struct Counts {
    gets: AtomicU64,
    found: AtomicU64,
    bytes_in: AtomicU64,
    puts: AtomicU64,
    bytes_out: AtomicU64,
    failed: AtomicU64,
    left_out: AtomicU64,
}

enum Command {
    Get(Vec<(String, u64)>, std::sync::mpsc::Sender<Vec<Option<Vec<u8>>>>),
    Put { blobs: Vec<(String, Vec<u8>)>, record: (String, Vec<u8>), size: u64 },
}

impl Client {
    /// Opens the store at `url`. No request is sent.
    ///
    /// # Errors
    /// The address or the settings of the environment cannot be used.
    pub fn open(url: &str) -> Result<Arc<Client>, Diagnostic> {
        let (store, prefix, secrets) = address::open(url)?;
        let state = Arc::new(State {
            address: url.to_owned(),
            store,
            prefix,
            secrets,
            readers: Semaphore::new(AT_ONCE),
            writers: Semaphore::new(AT_ONCE),
            queue: Mutex::default(),
            moved: Condvar::new(),
            health: Mutex::default(),
            counts: Counts::default(),
        });
        let cannot = |e: std::io::Error| {
            Diagnostic::file(url.as_ref(), format!("the client of the store cannot start: {e}"))
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(cannot)?;
        let (commands, received) = mpsc::unbounded_channel();
        let shared = state.clone();
        let run = move || {
            runtime.block_on(serve(shared, received));
            runtime.shutdown_background();
        };
        let thread = std::thread::Builder::new().name("store".to_owned()).spawn(run);
        let thread = Some(thread.map_err(cannot)?);
        Ok(Arc::new(Client { state, commands: Some(commands), thread }))
    }

    /// Requests and bytes since the start.
    pub fn traffic(&self) -> Traffic {
        let counts = &self.state.counts;
        let [gets, found, bytes_in, puts, bytes_out, failed, left_out] = [
            &counts.gets,
            &counts.found,
            &counts.bytes_in,
            &counts.puts,
            &counts.bytes_out,
            &counts.failed,
            &counts.left_out,
        ]
        .map(|count| count.load(Ordering::Relaxed));
        Traffic { gets, found, bytes_in, puts, bytes_out, failed, left_out }
    }

    /// Waits until all uploads are done or given up; returns the number of results that still wait
    /// after two minutes.
    pub fn flush(&self) -> u64 {
        let began = Instant::now();
        let mut queue = self.state.queue();
        while queue.1 > 0 && began.elapsed() < LAST_WAIT {
            let left = LAST_WAIT.saturating_sub(began.elapsed());
            let waited = self.state.moved.wait_timeout(queue, left);
            queue = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        queue.1
    }

    /// Counts the blobs below `folder`: their number, their bytes, and the age of the oldest.
    ///
    /// # Errors
    /// The store cannot be listed.
    pub fn count(&self, folder: &str) -> Result<(u64, u64, Option<Duration>), Diagnostic> {
        let state = &self.state;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let prefix = state.path(folder);
        let count = async {
            let mut all = state.store.list(Some(&prefix));
            let (mut blobs, mut bytes, mut oldest) = (0, 0, None);
            while let Some(blob) = all.next().await {
                let blob = blob.map_err(|e| state.secrets.redact(&e.to_string()))?;
                (blobs, bytes) = (blobs + 1, bytes + blob.size);
                let modified = std::time::SystemTime::from(blob.last_modified);
                oldest = oldest.max(modified.elapsed().ok());
            }
            Ok((blobs, bytes, oldest))
        };
        let counted =
            runtime.map_err(|e| e.to_string()).and_then(|runtime| runtime.block_on(count));
        let cannot = |why| format!("the store cannot be listed: {why}");
        counted.map_err(|why| Diagnostic::file(state.address.as_ref(), cannot(why)))
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        let left = self.flush();
        if left > 0 {
            message!("warning: {}: {left} results were not uploaded in time", self.state.address);
        }
        self.take_warnings().iter().for_each(|warning| message!("warning: {warning}"));
        self.commands = None;
        if let Some(thread) = self.thread.take().filter(|_| left == 0) {
            let _ = thread.join();
        }
    }
}

impl Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Client({})", self.state.address)
    }
}

impl BlobStore for Client {
    fn get(&self, blobs: &[(String, u64)]) -> Vec<Option<Vec<u8>>> {
        if !self.state.is_open() {
            return vec![None; blobs.len()];
        }
        let (reply, answer) = std::sync::mpsc::channel();
        let command = Command::Get(blobs.to_vec(), reply);
        let sent = self.commands.as_ref().is_some_and(|to| to.send(command).is_ok());
        sent.then(|| answer.recv().ok()).flatten().unwrap_or_else(|| vec![None; blobs.len()])
    }

    fn put(&self, blobs: Vec<(String, Vec<u8>)>, record: (String, Vec<u8>)) {
        let state = &self.state;
        if !state.is_open() {
            state.counts.left_out.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let size = blobs.iter().chain([&record]).map(|(_, bytes)| bytes.len() as u64).sum();
        {
            let mut queue = state.queue();
            while queue.0 > 0 && queue.0 + size > QUEUE {
                queue = state.moved.wait(queue).unwrap_or_else(PoisonError::into_inner);
            }
            *queue = (queue.0 + size, queue.1 + 1);
        }
        let command = Command::Put { blobs, record, size };
        if self.commands.as_ref().is_none_or(|to| to.send(command).is_err()) {
            state.uploaded(size);
        }
    }

    fn take_warnings(&self) -> Vec<String> {
        let warning = self.state.health().warning.take();
        let text = |(first, more): (String, u64)| {
            let more = if more > 0 { format!(", and {more} more failures") } else { String::new() };
            format!(
                "cache store {}: {first}{more}; what it does not return is computed, and the pictures are the same",
                self.state.address
            )
        };
        warning.map(text).into_iter().collect()
    }
}

impl State {
    fn queue(&self) -> MutexGuard<'_, (u64, u64)> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn health(&self) -> MutexGuard<'_, Health> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the store is not left alone at present.
    fn is_open(&self) -> bool {
        self.health().until.is_none_or(|until| Instant::now() >= until)
    }

    fn path(&self, name: &str) -> Path {
        let parts = name.split('/').map(object_store::path::PathPart::from);
        self.prefix.parts().chain(parts).collect()
    }

    fn uploaded(&self, size: u64) {
        let mut queue = self.queue();
        *queue = (queue.0 - size, queue.1 - 1);
        self.moved.notify_all();
    }

    fn succeeded(&self) {
        let mut health = self.health();
        (health.in_a_row, health.pauses, health.until) = (0, 0, None);
    }

    fn failed(&self, why: &str) {
        self.counts.failed.fetch_add(1, Ordering::Relaxed);
        let mut health = self.health();
        health.in_a_row += 1;
        let mut why = self.secrets.redact(why);
        let is_paused = health.until.is_some_and(|until| Instant::now() < until);
        if health.in_a_row >= FAILURES && !is_paused {
            let pause = (PAUSE * 2u32.pow(health.pauses.min(8))).min(LONGEST_PAUSE);
            health.until = Some(Instant::now() + pause);
            health.pauses += 1;
            tracing::warn!("{why}; the store is left alone for {} s", pause.as_secs());
            why.push_str(&format!(" (left alone for {} s)", pause.as_secs()));
        }
        match &mut health.warning {
            Some((_, more)) => *more += 1,
            warning => *warning = Some((why, 0)),
        }
    }

    /// Waits for an answer about so many bytes, and records how it went.
    async fn limited<T>(
        &self,
        bytes: u64,
        request: impl Future<Output = Result<T, Error>>,
    ) -> Option<T> {
        let limit = PATIENCE + Duration::from_secs_f64(bytes as f64 / SLOWEST);
        match tokio::time::timeout(limit, request).await {
            Ok(Ok(answer)) => {
                self.succeeded();
                return Some(answer);
            }
            Ok(Err(Error::NotFound { .. })) => self.succeeded(),
            Ok(Err(e)) => self.failed(&e.to_string()),
            Err(_) => self.failed(&format!("no answer in {:.0} s", limit.as_secs_f64())),
        }
        None
    }

    async fn get(&self, name: &str, most: u64) -> Option<Vec<u8>> {
        let _permit = self.readers.acquire().await.ok()?;
        if !self.is_open() {
            return None;
        }
        self.counts.gets.fetch_add(1, Ordering::Relaxed);
        let path = self.path(name);
        let read = async {
            let answer = self.store.get(&path).await?;
            if answer.meta.size > most {
                return Ok(None);
            }
            let mut bytes = Vec::with_capacity(answer.meta.size as usize);
            let mut pieces = answer.into_stream();
            while let Some(piece) = pieces.next().await {
                bytes.extend_from_slice(&piece?);
                if bytes.len() as u64 > most {
                    return Ok(None);
                }
            }
            Ok(Some(bytes))
        };
        let bytes = self.limited(most.min(1 << 30), read).await??;
        self.counts.found.fetch_add(1, Ordering::Relaxed);
        self.counts.bytes_in.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Some(bytes)
    }

    async fn put(&self, name: &str, bytes: Vec<u8>) -> Option<()> {
        let _permit = self.writers.acquire().await.ok()?;
        if !self.is_open() {
            return None;
        }
        let (path, size) = (self.path(name), bytes.len() as u64);
        self.counts.puts.fetch_add(1, Ordering::Relaxed);
        let write = async { self.store.put(&path, PutPayload::from(bytes)).await };
        self.limited(size, write).await?;
        self.counts.bytes_out.fetch_add(size, Ordering::Relaxed);
        Some(())
    }
}

/// Runs the requests of a client until it is dropped.
async fn serve(state: Arc<State>, mut commands: mpsc::UnboundedReceiver<Command>) {
    while let Some(command) = commands.recv().await {
        let state = state.clone();
        tokio::spawn(async move {
            match command {
                Command::Get(blobs, reply) => {
                    let all = blobs.iter().map(|(name, most)| state.get(name, *most));
                    let _ = reply.send(join_all(all).await);
                }
                Command::Put { blobs, record: (name, bytes), size } => {
                    let all = blobs.into_iter().map(|(name, bytes)| {
                        let state = &state;
                        async move { state.put(&name, bytes).await }
                    });
                    let is_whole = join_all(all).await.iter().all(Option::is_some);
                    // A record without its values would promise what nobody finds.
                    if !is_whole || state.put(&name, bytes).await.is_none() {
                        state.counts.left_out.fetch_add(1, Ordering::Relaxed);
                    }
                    state.uploaded(size);
                }
            }
        });
    }
}
