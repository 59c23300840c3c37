//! Memory over disk over a shared store: where an engine keeps and finds results.

mod blobs;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use super::cache::{EarlierResults, Entry, Header, Memory};
use super::disk::{DiskCache, Found, Loss};
use super::key::{Why, first_change};
use super::resolved_graph::GraphNode;
use super::{Digest, Value};
pub(super) use blobs::Blobs;
use blobs::Recorded;

/// Why a node runs again whose key is the last one of its name.
pub(super) const STORED_NO_MORE: &str = "the cache has dropped its result";

/// Why a node runs again whose values are not stored ([`Node::STORED_UP_TO`](super::Node)).
pub(super) const NOT_STORED: &str = "a result of this size is quicker to make than to read";

const UNPOISONED: &str = "nothing panics while it fetches values";

pub(super) struct Store {
    memory: Memory,
    disk: Option<DiskCache>,
    disk_limit: u64,
    blobs: Option<Blobs>,
    earlier: Option<Arc<dyn EarlierResults>>,
    /// Held while the values of a result are fetched from the shared store, by first byte of its
    /// key: those who need the same result find it on disk afterwards.
    fetching: [Mutex<()>; 256],
    /// Set once storing failed: a full or read-only disk gives one warning and is not tried again.
    read_only: AtomicBool,
    warnings: Mutex<Vec<String>>,
    /// Set once an entry of another user was found: it gives one warning.
    met_foreign: AtomicBool,
    /// The project whose last keys are kept.
    project: String,
    latest: Mutex<BTreeMap<Arc<str>, Latest>>,
}

/// The last key of a node name, with its text where this process saw it.
#[derive(Clone)]
struct Latest {
    key: Digest,
    header: Option<Arc<Header>>,
}

/// The result of a look-up, and the damage found on the way.
pub(super) struct Lookup {
    pub entry: Option<Arc<Entry>>,
    pub damage: Option<String>,
}

impl Store {
    /// Creates a store. Limits of memory and disk are in bytes; `project` names the graph whose
    /// last keys the store keeps.
    pub fn new(
        (memory_bytes, disk_limit): (u64, u64),
        disk: Option<DiskCache>,
        blobs: Option<Blobs>,
        earlier: Option<Arc<dyn EarlierResults>>,
        project: String,
    ) -> Store {
        Store {
            memory: Memory::new(memory_bytes),
            disk,
            disk_limit,
            blobs,
            earlier,
            fetching: [const { Mutex::new(()) }; 256],
            read_only: AtomicBool::new(false),
            warnings: Mutex::default(),
            met_foreign: AtomicBool::new(false),
            project,
            latest: Mutex::default(),
        }
    }

    /// The result under `key`, without its values if it comes from disk.
    pub fn find(&self, key: &Digest, node: &GraphNode) -> Lookup {
        if let Some(entry) = self.memory.get(key) {
            return Lookup { entry: Some(entry), damage: None };
        }
        let damage = match self.disk.as_ref().map(|disk| disk.header(key)) {
            None | Some(Found::Nothing) => None,
            Some(Found::Header(header)) if fits(&header, node) => {
                return Lookup { entry: Some(self.found(*key, header)), damage: None };
            }
            Some(Found::Foreign(why)) => {
                self.warn_of_foreign(&why);
                None
            }
            Some(Found::Header(_)) => Some("its ports are not those of the node".to_owned()),
            Some(Found::Damaged(damage)) => Some(damage),
        };
        if let Some(damage) = &damage {
            self.drop_damaged(key, &node.name, damage);
        }
        match self.blobs.as_ref().map(|blobs| blobs.header(key)) {
            Some(Recorded::Header(header)) if fits(&header, node) => {
                return Lookup { entry: Some(self.found(*key, header)), damage: None };
            }
            Some(Recorded::Foreign(why)) => self.warn_of_foreign(&format!("{why} in the store")),
            _ => {}
        }
        Lookup { entry: None, damage }
    }

    fn found(&self, key: Digest, header: Header) -> Arc<Entry> {
        let entry = Arc::new(Entry::stored(key, header));
        self.memory.put(&entry);
        entry
    }

    /// One value of a result, read from disk, from the shared store or from the results of an
    /// earlier run if need be. A damaged result is dropped.
    ///
    /// # Errors
    /// The value is missing or damaged.
    pub fn value(&self, entry: &Arc<Entry>, index: usize, node: &GraphNode) -> Result<Value, Loss> {
        let here = || entry.value(index).or_else(|| self.memory.get(&entry.key)?.value(index));
        if let Some(value) = here() {
            return Ok(value);
        }
        let header = &entry.header.values[index];
        let (port, digest) = (header.port as usize, Digest(header.digest));
        if !entry.header.has_values
            && let Some(earlier) = &self.earlier
            && let Some(value) = earlier.value(&header.type_name)
            && (value.type_name(), value.digest()) == (&header.type_name, digest)
        {
            return Ok(value);
        }
        let disk = self.disk.as_ref().ok_or(Loss::Gone)?;
        let on_disk = || disk.value(&entry.key, index, &node.outputs[port], digest);
        let mut read = on_disk();
        if let (Err(loss), Some(blobs), true) = (&read, &self.blobs, entry.header.has_values) {
            let was_damaged = matches!(loss, Loss::Damaged(_));
            match self.fetch(blobs, disk, entry, index, was_damaged) {
                Some(Err(Loss::Gone)) => {}
                Some(fetched) => read = fetched,
                None => read = on_disk(),
            }
        }
        let decoded =
            read.and_then(|bytes| node.op.decode(port, bytes, digest).map_err(Loss::Damaged));
        match &decoded {
            Ok(value) => {
                entry.fill(index, value.clone());
                self.memory.put(entry);
            }
            Err(loss) => {
                self.memory.forget(&entry.key);
                if let Loss::Damaged(damage) = loss {
                    self.drop_damaged(&entry.key, &node.name, damage);
                }
            }
        }
        decoded
    }

    /// The bytes of one value from the shared store. All values of the result are fetched, so that
    /// the disk can keep it. `None` if another thread has done so meanwhile.
    fn fetch(
        &self,
        blobs: &Blobs,
        disk: &DiskCache,
        entry: &Entry,
        index: usize,
        is_damaged: bool,
    ) -> Option<Result<Vec<u8>, Loss>> {
        let _lock = self.fetching[usize::from(entry.key.0[0])].lock().expect(UNPOISONED);
        if !is_damaged && matches!(disk.header(&entry.key), Found::Header(_)) {
            return None;
        }
        let mut values = blobs.values(&entry.header);
        if values.iter().all(|value| matches!(value, Some(Ok(_)))) {
            let mut whole: Vec<Vec<u8>> = values.into_iter().flatten().flatten().collect();
            let store = |limit| disk.store_bytes(&entry.key, &entry.header, &whole, limit);
            self.write_to_disk(disk, store);
            return Some(Ok(whole.swap_remove(index)));
        }
        Some(match values.swap_remove(index) {
            None => Err(Loss::Gone),
            Some(value) => value.map_err(Loss::Damaged),
        })
    }

    /// Warns once of entries that somebody else made.
    fn warn_of_foreign(&self, why: &str) {
        if let Some(disk) = &self.disk
            && !self.met_foreign.swap(true, Ordering::Relaxed)
        {
            self.warn(format!(
                "cache {}: an entry is not used, as {why}; the cache may have more of them (`relight cache verify` counts them)",
                disk.folder().display()
            ));
        }
    }

    fn warn(&self, warning: String) {
        tracing::warn!("{warning}");
        self.warnings.lock().expect("nothing panics while it warns").push(warning);
    }

    fn drop_damaged(&self, key: &Digest, node: &str, damage: &str) {
        tracing::warn!(node, %key, damage, "dropped");
        if let Some(disk) = &self.disk {
            disk.drop_entry(key);
        }
    }

    /// Whether a result is too large to be kept in memory.
    pub fn is_large(&self, entry: &Entry) -> bool {
        entry.resident() > self.memory.limit()
    }

    /// The result under `key`, if memory holds it.
    pub fn in_memory(&self, key: &Digest) -> Option<Arc<Entry>> {
        self.memory.get(key)
    }

    /// Keeps a result in memory, as far as the limit allows.
    pub fn keep_in_memory(&self, entry: &Arc<Entry>) {
        self.memory.put(entry);
    }

    /// Writes a result that took `seconds` to disk and to the shared store.
    pub fn keep(&self, entry: &Entry, values: &[Value], seconds: f64) {
        self.keep_on_disk(entry, values);
        if let Some(blobs) = &self.blobs {
            blobs.put(&entry.key, &entry.header, values, seconds);
        }
    }

    /// Writes a result to disk.
    pub fn keep_on_disk(&self, entry: &Entry, values: &[Value]) {
        if let Some(disk) = &self.disk {
            self.write_to_disk(disk, |limit| disk.store(&entry.key, &entry.header, values, limit));
        }
    }

    /// The first failure is a warning, and the last attempt.
    fn write_to_disk(&self, disk: &DiskCache, store: impl FnOnce(u64) -> std::io::Result<()>) {
        if self.read_only.load(Ordering::Relaxed) {
            return;
        }
        if let Err(e) = store(self.disk_limit)
            && !self.read_only.swap(true, Ordering::Relaxed)
        {
            let folder = disk.folder().display();
            self.warn(format!("cache {folder}: {e}; the run goes on without storing results"));
        }
    }

    /// Warnings since the last call.
    pub fn take_warnings(&self) -> Vec<String> {
        let warnings = &mut *self.warnings.lock().expect("nothing panics while it warns");
        let mut warnings = std::mem::take(warnings);
        warnings.extend(self.blobs.iter().flat_map(Blobs::take_warnings));
        warnings
    }

    /// Reads the last keys again: another process may have run meanwhile.
    pub fn refresh_latest(&self) {
        let Some(disk) = &self.disk else { return };
        let mut latest = self.latest();
        for (name, key) in disk.latest(&self.project) {
            if latest.get(name.as_str()).map(|l| l.key) != Some(key) {
                latest.insert(name.into(), Latest { key, header: None });
            }
        }
    }

    /// Records the last key of each node instance, in memory and on disk.
    pub fn set_latest(&self, entries: impl Iterator<Item = (Arc<str>, Arc<Header>, Digest)>) {
        let mut changed = BTreeMap::new();
        let mut latest = self.latest();
        for (name, header, key) in entries {
            match latest.get_mut(&name) {
                Some(known) if known.key == key => {
                    known.header.get_or_insert(header);
                }
                _ => {
                    changed.insert(name.to_string(), key);
                    latest.insert(name, Latest { key, header: Some(header) });
                }
            }
        }
        drop(latest);
        if let Some(disk) = &self.disk
            && !changed.is_empty()
            && !self.read_only.load(Ordering::Relaxed)
            && let Err(e) = disk.set_latest(&self.project, &changed)
        {
            tracing::debug!("the last keys were not written: {e}");
        }
    }

    /// The last key of this node name and the header stored under it, if it is still known.
    fn last_key(&self, name: &str) -> Option<(Digest, Option<Arc<Header>>)> {
        let known = self.latest().get(name).cloned()?;
        let from_disk = || match self.disk.as_ref()?.header(&known.key) {
            Found::Header(header) => Some(Arc::new(header)),
            Found::Nothing | Found::Damaged(_) | Found::Foreign(_) => None,
        };
        Some((known.key, known.header.or_else(from_disk)))
    }

    /// The reason why a node has no result under its key.
    pub fn why(&self, name: &str, key: &Digest, text: &str) -> Why {
        match self.last_key(name) {
            None => Why::plain("new"),
            Some((last, _)) if last == *key => Why::plain(STORED_NO_MORE),
            Some((_, None)) => Why::plain("changed, and the cache has dropped its last key"),
            Some((_, Some(header))) => first_change(&header.key_manifest, text)
                .unwrap_or_else(|| Why::plain("the format of its key changed")),
        }
    }

    fn latest(&self) -> MutexGuard<'_, BTreeMap<Arc<str>, Latest>> {
        self.latest.lock().expect("nothing panics while it holds the last keys")
    }
}

/// Whether a stored result has the output ports of `node`: a stage may have got others without a
/// new version.
fn fits(header: &Header, node: &GraphNode) -> bool {
    use super::Arity::{Many, One, Optional};
    let ports_exist = header.values.iter().all(|value| {
        node.outputs.get(value.port as usize).is_some_and(|port| {
            port.type_name == value.type_name && (port.arity == Many) == value.member.is_some()
        })
    });
    let counts_are_right = node.outputs.iter().enumerate().all(|(i, port)| match port.arity {
        One => header.port(i).count() == 1,
        Optional => header.port(i).count() <= 1,
        Many => true,
    });
    ports_exist && counts_are_right
}
