//! Results in a store of blobs that several machines share, behind memory and disk.
//!
//! ```text
//! ac/ab/KEY        the record of a result: its header, signed as on disk
//! cas/ab/DIGEST    the canonical bytes of a value, by its digest
//! ```
//! A record is written after its values, so that a reader who finds it finds them, too, unless
//! somebody deleted them. Writers need no locks: a name stands for one content. Nothing that the
//! store returns is trusted: a record has the signature of the user's key and its own key's
//! manifest, a value has its digest and keeps the rules of its type.

use std::sync::Arc;

use crate::graph::artifact::{Value, digest_on_one_thread};
use crate::graph::cache::{BlobStore, Header};
use crate::graph::disk::{CacheKey, Unusable, read_signed, signed};
use crate::graph::{Digest, key};

/// A record has a key manifest and a line per value: a few kilobytes. A longer one has no place.
const MAX_RECORD: u64 = 1 << 20;
/// Time that a reader waits for a value in any case, seconds.
const LATENCY: f64 = 0.05;
/// Bytes a second of a store that is not near.
const RATE: f64 = 25e6;

/// Whether values are worth a place in the store: it takes less time to get them than to compute
/// them again.
fn is_worth_it(seconds: f64, bytes: u64) -> bool {
    seconds > LATENCY + bytes as f64 / RATE
}

/// A store and the key of its records.
pub struct Blobs {
    store: Arc<dyn BlobStore>,
    key: CacheKey,
}

/// The answer of the store to the key of a result.
pub enum Recorded {
    Nothing,
    Header(Header),
    /// Signed with another key.
    Foreign(String),
}

impl Blobs {
    pub fn new(store: Arc<dyn BlobStore>, key: CacheKey) -> Blobs {
        Blobs { store, key }
    }

    /// The header of the result under `key`. A record that is damaged counts as missing; the run's
    /// own result replaces it.
    pub fn header(&self, key: &Digest) -> Recorded {
        let Some(bytes) = self.store.get(&[(record(key), MAX_RECORD)]).pop().flatten() else {
            return Recorded::Nothing;
        };
        let mut rest = bytes.as_slice();
        match read_signed(&mut rest, bytes.len() as u64, &self.key) {
            Ok((header, _)) if rest.is_empty() && key::digest(&header.key_manifest) == *key => {
                Recorded::Header(header)
            }
            Ok(_) | Err(Unusable::Damaged(_)) => Recorded::Nothing,
            Err(Unusable::Foreign(why)) => Recorded::Foreign(why),
        }
    }

    /// The bytes of all values of a result; `None` for one that is not there, an error for one that
    /// differs from its digest.
    pub fn values(&self, header: &Header) -> Vec<Option<Result<Vec<u8>, String>>> {
        let names = header.values.iter().map(|v| (content(&Digest(v.digest)), v.length));
        let found = self.store.get(&names.collect::<Vec<_>>());
        let checked = found.into_iter().zip(&header.values).map(|(bytes, value)| {
            let bytes = bytes?;
            let digest = digest_on_one_thread(&value.type_name, &bytes);
            Some(if digest == Digest(value.digest) {
                Ok(bytes)
            } else {
                Err("the store returned other bytes than its digest stands for".to_owned())
            })
        });
        checked.collect()
    }

    /// Puts a result that took `seconds` into the store; of one that is quicker to compute than to
    /// get, the header alone, so that all that depends on it can be a hit.
    pub fn put(&self, key: &Digest, header: &Header, values: &[Value], seconds: f64) {
        let mut header = header.clone();
        header.has_values &= is_worth_it(seconds, header.stored());
        let kept = if header.has_values { values } else { &[] };
        let blobs = kept.iter().map(|value| {
            let mut bytes = Vec::with_capacity(value.length as usize);
            value.encode(|piece| bytes.extend_from_slice(piece));
            (content(&value.digest), bytes)
        });
        let bytes = signed(&header, &self.key);
        if bytes.len() as u64 <= MAX_RECORD {
            self.store.put(blobs.collect(), (record(key), bytes));
        }
    }

    pub fn take_warnings(&self) -> Vec<String> {
        self.store.take_warnings()
    }
}

fn record(key: &Digest) -> String {
    name("ac", key)
}

fn content(digest: &Digest) -> String {
    name("cas", digest)
}

fn name(folder: &str, digest: &Digest) -> String {
    let hex = digest.to_string();
    format!("{folder}/{}/{hex}", &hex[..2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_quicker_to_compute_than_to_get_has_no_place() {
        assert!(is_worth_it(2.0, 10_000_000), "0.45 s to get");
        assert!(!is_worth_it(0.3, 10_000_000));
        assert!(!is_worth_it(0.01, 10), "a request takes longer");
    }
}
