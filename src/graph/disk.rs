//! The disk cache: one file per result, checked on read, written beside and renamed.

use std::path::Path;

/// The results on disk.
pub struct DiskCache {}

/// What is on disk, and what was done to it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CacheReport {
    pub entries: u64,
    pub bytes: u64,
    /// Entries deleted by this call.
    pub removed: u64,
    /// Entries whose checksum is wrong; `verify` deletes them.
    pub damaged: u64,
}

impl DiskCache {
    pub fn new(folder: &Path) -> DiskCache {
        let _ = folder;
        todo!()
    }

    /// Counts entries and bytes.
    pub fn stat(&self) -> std::io::Result<CacheReport> {
        todo!()
    }

    /// Deletes the longest unused entries until at most `bytes` are left.
    pub fn gc(&self, bytes: u64) -> std::io::Result<CacheReport> {
        let _ = bytes;
        todo!()
    }

    /// Reads everything, checks every checksum, deletes what is damaged.
    pub fn verify(&self) -> std::io::Result<CacheReport> {
        todo!()
    }

    /// Deletes everything that the cache made, and nothing else.
    pub fn clear(&self) -> std::io::Result<CacheReport> {
        todo!()
    }
}
