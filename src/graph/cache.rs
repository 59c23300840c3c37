//! Results, their headers, the bounded memory cache, and the stores behind all caches.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::{Arc, Mutex, MutexGuard};

use serde::{Deserialize, Serialize};

use super::artifact::Value;
use super::{Digest, PortValue};

/// A store of named blobs. It may be slow, fail, lose blobs or return others; its implementation
/// bounds the time of each request.
pub trait BlobStore: Debug + Send + Sync {
    /// The contents of these blobs, in order. `None` where a blob is not there, is longer than the
    /// number of bytes beside its name, or cannot be had in time.
    fn get(&self, blobs: &[(String, u64)]) -> Vec<Option<Vec<u8>>>;

    /// Takes blobs and a record that names them. The record is written once all others are. The
    /// call need not wait for either.
    fn put(&self, blobs: Vec<(String, Vec<u8>)>, record: (String, Vec<u8>));

    /// Warnings since the last call.
    fn take_warnings(&self) -> Vec<String>;
}

/// A place outside of the cache where values of an earlier run may lie, such as the files that it
/// wrote: asked for values that the cache does not store ([`Node::STORED_UP_TO`](super::Node)).
pub trait EarlierResults: Debug + Send + Sync {
    /// The value of the type of this name ([`Artifact::TYPE`](super::Artifact)), if one lies there.
    /// The engine uses it only if it has the wanted digest.
    fn value(&self, type_name: &str) -> Option<Value>;
}

/// A header describes a result without its values.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Header {
    pub key_manifest: String,
    /// Port by port, members in their order.
    pub values: Vec<ValueHeader>,
    /// Whether the disk holds the values, too; else they are made again where they are needed.
    pub has_values: bool,
    pub stderr: Option<f64>,
    pub warnings: Vec<String>,
    pub notes: Vec<String>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct ValueHeader {
    pub port: u32,
    /// Set where the port scatters.
    pub member: Option<String>,
    pub type_name: String,
    pub digest: [u8; 32],
    /// Memory that the value takes.
    pub memory: u64,
    /// Length of the canonical bytes, as they are stored.
    pub length: u64,
}

impl Header {
    /// Indices of the values of one port.
    pub fn port(&self, port: usize) -> impl Iterator<Item = usize> {
        (0..self.values.len()).filter(move |&i| self.values[i].port as usize == port)
    }

    /// Length of the values on disk, bytes.
    pub fn stored(&self) -> u64 {
        if self.has_values { self.values.iter().map(|v| v.length).sum() } else { 0 }
    }

    /// Returns the memory that all values take, bytes.
    pub fn memory(&self) -> u64 {
        self.values.iter().map(|v| v.memory).sum()
    }
}

/// A result. Its values are filled in when something needs them.
pub(super) struct Entry {
    pub key: Digest,
    pub header: Arc<Header>,
    /// True if the budget ended the stage early: the result is not the one that its key denotes, so
    /// that nothing outside of its run may hold it.
    pub cut_short: bool,
    values: Mutex<Vec<Option<Value>>>,
}

impl Entry {
    /// A result whose values all lie on disk.
    pub fn stored(key: Digest, header: Header) -> Entry {
        let values = Mutex::new(vec![None; header.values.len()]);
        Entry { key, header: Arc::new(header), cut_short: false, values }
    }

    /// Returns the result without the values of one port.
    pub fn without(&self, port: usize) -> Entry {
        let mut values = self.lock().clone();
        self.header.port(port).for_each(|i| values[i] = None);
        Entry {
            key: self.key,
            header: self.header.clone(),
            cut_short: self.cut_short,
            values: Mutex::new(values),
        }
    }

    /// A result just made: one [`PortValue`] per output port. Values of more than `stored_up_to`
    /// bytes in all are not for the disk.
    pub fn made(
        key: Digest,
        mut header: Header,
        outputs: &[PortValue],
        (cut_short, stored_up_to): (bool, u64),
    ) -> Entry {
        let mut values = Vec::new();
        for (port, output) in outputs.iter().enumerate() {
            let mut push = |member: Option<&String>, value: &Value| {
                let (member, digest, memory) =
                    (member.cloned(), value.digest().0, value.bytes as u64);
                let type_name = value.type_name().to_owned();
                let (port, length) = (port as u32, value.length);
                header.values.push(ValueHeader { port, member, type_name, digest, memory, length });
                values.push(Some(value.clone()));
            };
            match output {
                PortValue::One(value) => push(None, value),
                PortValue::Missing => {}
                PortValue::Many(all) => {
                    all.iter().for_each(|(member, value)| push(Some(member), value))
                }
            }
        }
        header.has_values = header.stored() <= stored_up_to;
        Entry { key, header: Arc::new(header), cut_short, values: Mutex::new(values) }
    }

    /// Returns the value at `index`, if it is in memory.
    ///
    /// # Panics
    /// The result has no value of this index.
    pub fn value(&self, index: usize) -> Option<Value> {
        self.lock()[index].clone()
    }

    /// Puts the value at `index` into memory.
    ///
    /// # Panics
    /// The result has no value of this index.
    pub fn fill(&self, index: usize, value: Value) {
        self.lock()[index] = Some(value);
    }

    /// All values, if all are in memory.
    pub fn all(&self) -> Option<Vec<Value>> {
        self.lock().iter().cloned().collect()
    }

    /// Memory that the values here take.
    pub fn resident(&self) -> u64 {
        self.lock().iter().flatten().map(|v| v.bytes as u64).sum()
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Option<Value>>> {
        self.values.lock().expect("nothing panics while it holds the values of a result")
    }
}

/// Results in memory; the longest unused go first.
pub(super) struct Memory {
    limit: u64,
    state: Mutex<CacheState>,
}

#[derive(Default)]
struct CacheState {
    #[expect(
        clippy::disallowed_types,
        reason = "found by key only, never walked: the order of age is in `by_age`"
    )]
    held: std::collections::HashMap<Digest, Held>,
    by_age: BTreeMap<u64, Digest>,
    clock: u64,
    bytes: u64,
}

struct Held {
    entry: Arc<Entry>,
    age: u64,
    bytes: u64,
}

impl Memory {
    /// Creates an empty cache that holds at most `limit` bytes.
    pub fn new(limit: u64) -> Memory {
        Memory { limit, state: Mutex::default() }
    }

    /// Returns the limit, bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Returns the entry under `key`, if it is held, and marks it as used last.
    pub fn get(&self, key: &Digest) -> Option<Arc<Entry>> {
        let state = &mut *self.lock();
        let held = state.held.get_mut(key)?;
        state.by_age.remove(&held.age);
        state.clock += 1;
        held.age = state.clock;
        state.by_age.insert(held.age, *key);
        Some(held.entry.clone())
    }

    /// Takes an entry in, or counts it anew after more of its values were filled in.
    pub fn put(&self, entry: &Arc<Entry>) {
        let bytes = entry.resident() + entry.header.key_manifest.len() as u64 + 256;
        let state = &mut *self.lock();
        state.forget(&entry.key);
        if bytes > self.limit {
            return;
        }
        state.clock += 1;
        let age = state.clock;
        state.held.insert(entry.key, Held { entry: entry.clone(), age, bytes });
        state.by_age.insert(age, entry.key);
        state.bytes += bytes;
        while state.bytes > self.limit {
            let oldest =
                *state.by_age.first_key_value().expect("bytes are held, so something holds them").1;
            state.forget(&oldest);
        }
    }

    /// Removes the entry under `key`, if it is held.
    pub fn forget(&self, key: &Digest) {
        self.lock().forget(key);
    }

    fn lock(&self) -> MutexGuard<'_, CacheState> {
        self.state.lock().expect("nothing panics while it holds the memory cache")
    }
}

impl CacheState {
    fn forget(&mut self, key: &Digest) {
        if let Some(held) = self.held.remove(key) {
            self.by_age.remove(&held.age);
            self.bytes -= held.bytes;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(name: u8, bytes: usize) -> Arc<Entry> {
        #[derive(Serialize, Deserialize)]
        struct Block(usize);
        impl crate::graph::Artifact for Block {
            const TYPE: &'static str = "Block";
            fn bytes(&self) -> usize {
                self.0
            }
        }
        let header = Header {
            key_manifest: String::new(),
            values: vec![],
            has_values: true,
            stderr: None,
            warnings: vec![],
            notes: vec![],
        };
        Arc::new(Entry::made(
            Digest([name; 32]),
            header,
            &[PortValue::One(Value::new(Arc::new(Block(bytes))))],
            (false, u64::MAX),
        ))
    }

    #[test]
    fn the_longest_unused_goes_first_and_the_bound_holds() {
        let memory = Memory::new(10_000);
        for name in 0..3 {
            memory.put(&entry(name, 3000 - 256));
        }
        assert!(memory.get(&Digest([0; 32])).is_some());
        memory.put(&entry(3, 3000 - 256));
        let there: Vec<bool> = (0..4).map(|n| memory.get(&Digest([n; 32])).is_some()).collect();
        assert_eq!(there, [true, false, true, true]);
        assert_eq!(memory.lock().bytes, 9000);
        memory.put(&entry(4, 20_000));
        assert!(memory.get(&Digest([4; 32])).is_none(), "larger than the whole memory");
        assert_eq!(memory.lock().bytes, 9000);
    }
}
