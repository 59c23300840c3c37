//! The disk cache: one file per result, written beside and renamed, every byte checked when it is read.
//!
//! ```text
//! FOLDER/entries/ab/cdef...   a result, by its key
//! FOLDER/tmp/                 results being written; each is locked by its writer
//! FOLDER/latest               the last key of each node name, for `explain`
//! ```
//! A result: magic (8 bytes), length of the header (8, little endian), BLAKE3 of the header (32), the header, then the
//! values one after the other, each as its length (8) and its bytes. The header holds the digests of the values, so that
//! it can be read and trusted by itself. Access times are the files' modification times, set when a result is used.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

use super::artifact::digest_of;
use super::cache::Header;
use super::{Digest, PortSpec, Value, key};

const MAGIC: &[u8; 8] = b"NODE\0\0\0\x01";
const PREAMBLE: u64 = 48;
/// A temporary file that nobody holds a lock on is stale after this long: a writer locks it right after making it.
const STALE: Duration = Duration::from_secs(10);

/// The results on disk. Several processes may share one folder.
pub struct DiskCache {
    folder: PathBuf,
    /// Bytes on disk, once they were counted.
    total: Mutex<Option<u64>>,
}

/// What is on disk, and what was done to it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CacheReport {
    /// Entries that are there after this call.
    pub entries: u64,
    pub bytes: u64,
    /// Entries deleted by this call.
    pub removed: u64,
    /// Entries whose checksum is wrong; `verify` deletes them.
    pub damaged: u64,
}

/// What lies under a key.
pub(super) enum Found {
    Nothing,
    Header(Header),
    /// There was something, but not what was written: what is wrong with it.
    Damaged(String),
}

/// Why a value of a known result cannot be had.
pub(super) enum Loss {
    /// Deleted, as the longest unused are.
    Gone,
    Damaged(String),
}

struct Stored {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl DiskCache {
    /// The cache in `folder`, which need not be there yet.
    pub fn new(folder: impl Into<PathBuf>) -> DiskCache {
        DiskCache { folder: folder.into(), total: Mutex::new(None) }
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Counts entries and bytes.
    pub fn stat(&self) -> io::Result<CacheReport> {
        Ok(sum(&self.entries()?, CacheReport::default()))
    }

    /// Deletes the longest unused entries until at most `bytes` are left.
    pub fn gc(&self, bytes: u64) -> io::Result<CacheReport> {
        self.sweep();
        let mut entries = self.entries()?;
        entries.sort_by(|a, b| (a.used, &a.path).cmp(&(b.used, &b.path)));
        let mut left: u64 = entries.iter().map(|e| e.bytes).sum();
        let mut report = CacheReport::default();
        let mut kept = Vec::new();
        for entry in entries {
            if left > bytes && remove(&entry.path)? {
                left -= entry.bytes;
                report.removed += 1;
            } else {
                kept.push(entry);
            }
        }
        *self.total.lock().expect("nothing panics while it counts") = Some(left);
        Ok(sum(&kept, report))
    }

    /// Reads everything, checks every checksum, deletes what is damaged.
    pub fn verify(&self) -> io::Result<CacheReport> {
        let mut report = CacheReport::default();
        let mut kept = Vec::new();
        for entry in self.entries()? {
            if is_sound(&entry.path) {
                kept.push(entry);
            } else {
                report.damaged += 1;
                report.removed += u64::from(remove(&entry.path)?);
            }
        }
        Ok(sum(&kept, report))
    }

    /// Deletes everything that the cache made, and nothing else.
    pub fn clear(&self) -> io::Result<CacheReport> {
        let mut report = CacheReport::default();
        for entry in self.entries()? {
            report.removed += u64::from(remove(&entry.path)?);
        }
        for folder in list(&self.folder.join("entries"))? {
            let _ = fs::remove_dir(folder);
        }
        self.sweep();
        remove(&self.folder.join("latest"))?;
        *self.total.lock().expect("nothing panics while it counts") = Some(0);
        Ok(report)
    }

    fn entries(&self) -> io::Result<Vec<Stored>> {
        let mut entries = Vec::new();
        for folder in list(&self.folder.join("entries"))? {
            for path in list(&folder)? {
                // Another process may delete it meanwhile.
                if let Ok(data) = path.metadata()
                    && data.is_file()
                {
                    entries.push(Stored { path, bytes: data.len(), used: data.modified()? });
                }
            }
        }
        Ok(entries)
    }

    fn path(&self, key: &Digest) -> PathBuf {
        let name = key.to_string();
        self.folder.join("entries").join(&name[..2]).join(&name[2..])
    }

    /// The header under a key; counts as use.
    pub(super) fn header(&self, key: &Digest) -> Found {
        let mut file = match File::open(self.path(key)) {
            Ok(file) => file,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Found::Nothing,
            Err(e) if e.kind() == io::ErrorKind::NotADirectory => return Found::Nothing,
            Err(e) => return Found::Damaged(format!("cannot be read: {e}")),
        };
        match read_header(&mut file) {
            Ok((header, _)) if key::digest(&header.key_text) == *key => {
                // Not possible in a read-only folder; then the order of deletion is that of creation.
                #[expect(clippy::disallowed_methods, reason = "the longest unused entry goes first")]
                let _ = file.set_modified(SystemTime::now());
                Found::Header(header)
            }
            Ok(_) => Found::Damaged("it stands under a key that is not its own".to_owned()),
            Err(message) => Found::Damaged(message),
        }
    }

    /// The checked bytes of one value of a result whose header said `digest`.
    pub(super) fn value(&self, key: &Digest, index: usize, port: &PortSpec, digest: Digest) -> Result<Vec<u8>, Loss> {
        let file = File::open(self.path(key)).map_err(|e| match e.kind() {
            io::ErrorKind::NotFound => Loss::Gone,
            _ => Loss::Damaged(format!("cannot be read: {e}")),
        })?;
        let bytes = read_value(file, index).map_err(Loss::Damaged)?;
        let whole = digest_of(port.type_name, &bytes) == digest;
        if whole { Ok(bytes) } else { Err(Loss::Damaged(format!("`{}` is not what was stored", port.name))) }
    }

    /// Writes a result: to a temporary file, synced, then renamed. Older results make room.
    pub(super) fn store(&self, key: &Digest, header: &Header, values: &[Value], limit: u64) -> io::Result<()> {
        let header = postcard::to_stdvec(header).expect("headers hold plain data, which postcard always encodes");
        let bytes = PREAMBLE + header.len() as u64 + values.iter().map(|v| 8 + v.length).sum::<u64>();
        if bytes > limit {
            return Ok(());
        }
        let path = self.path(key);
        let tmp = self.folder.join("tmp");
        if !tmp.is_dir() {
            fs::create_dir_all(&tmp)?;
        }
        fs::create_dir_all(path.parent().expect("an entry lies in a folder"))?;
        let mut file = tempfile::Builder::new().prefix("new-").tempfile_in(tmp)?;
        // Where the file system knows no locks, age alone tells stale files.
        let _ = file.as_file().try_lock();
        file.write_all(MAGIC)?;
        file.write_all(&(header.len() as u64).to_le_bytes())?;
        file.write_all(blake3::hash(&header).as_bytes())?;
        file.write_all(&header)?;
        for value in values {
            file.write_all(&value.length.to_le_bytes())?;
            let mut written = Ok(());
            value.encode(|piece| {
                if written.is_ok() {
                    written = file.write_all(piece);
                }
            });
            written?;
        }
        file.as_file().sync_data()?;
        file.persist(&path).map_err(|e| e.error)?;
        self.make_room(bytes, limit)
    }

    fn make_room(&self, added: u64, limit: u64) -> io::Result<()> {
        let total = {
            let mut total = self.total.lock().expect("nothing panics while it counts");
            let now = match *total {
                Some(known) => known + added,
                None => {
                    self.sweep();
                    self.stat()?.bytes
                }
            };
            *total = Some(now);
            now
        };
        // A tenth is cleared in advance, so that a full cache does not count its files at every result.
        if total > limit { self.gc(limit - limit / 10).map(drop) } else { Ok(()) }
    }

    /// Deletes a damaged result.
    pub(super) fn drop_entry(&self, key: &Digest) {
        let _ = remove(&self.path(key));
    }

    /// Deletes temporary files whose writers died.
    fn sweep(&self) {
        for path in list(&self.folder.join("tmp")).unwrap_or_default() {
            let Ok(file) = File::open(&path) else { continue };
            let modified = file.metadata().and_then(|data| data.modified());
            let old = modified.is_ok_and(|m| m.elapsed().is_ok_and(|age| age > STALE));
            if old && !matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock)) {
                let _ = remove(&path);
            }
        }
    }

    /// The last key of each node name.
    pub(super) fn latest(&self) -> BTreeMap<String, Digest> {
        let text = fs::read_to_string(self.folder.join("latest")).unwrap_or_default();
        let line = |line: &str| {
            let (name, hex) = line.rsplit_once(' ')?;
            Some((name.to_owned(), Digest(*blake3::Hash::from_hex(hex).ok()?.as_bytes())))
        };
        text.lines().filter_map(line).collect()
    }

    /// Lays `keys` over the last keys. Of two processes that do so at once, one may go unheard: `explain` then compares
    /// with the result before.
    pub(super) fn set_latest(&self, keys: &BTreeMap<String, Digest>) -> io::Result<()> {
        let mut all = self.latest();
        let before = all.len();
        let changed = keys.iter().filter(|(name, key)| all.insert((*name).clone(), **key) != Some(**key)).count();
        if changed == 0 && all.len() == before {
            return Ok(());
        }
        let tmp = self.folder.join("tmp");
        fs::create_dir_all(&tmp)?;
        let mut file = tempfile::Builder::new().prefix("latest-").tempfile_in(tmp)?;
        let text: String = all.iter().map(|(name, key)| format!("{name} {key}\n")).collect();
        file.write_all(text.as_bytes())?;
        file.persist(self.folder.join("latest")).map_err(|e| e.error)?;
        Ok(())
    }
}

/// The header, and how many bytes follow it. Never asks for more memory than the file has bytes.
fn read_header(file: &mut File) -> Result<(Header, u64), String> {
    let size = file.metadata().map_err(|e| e.to_string())?.len();
    let mut preamble = [0; PREAMBLE as usize];
    file.read_exact(&mut preamble).map_err(|_| "it is cut short".to_owned())?;
    let (magic, rest) = preamble.split_at(8);
    let (length, checksum) = rest.split_at(8);
    if magic != MAGIC {
        return Err("it does not begin as a result does".to_owned());
    }
    let length = u64::from_le_bytes(length.try_into().expect("eight bytes"));
    let left = size.checked_sub(PREAMBLE).and_then(|left| left.checked_sub(length)).ok_or("it is cut short")?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(|_| "it is cut short".to_owned())?;
    if blake3::hash(&bytes).as_bytes() != checksum {
        return Err("its header is damaged".to_owned());
    }
    let header = postcard::from_bytes(&bytes).map_err(|e| format!("its header cannot be decoded: {e}"))?;
    Ok((header, left))
}

fn read_value(mut file: File, index: usize) -> Result<Vec<u8>, String> {
    let (_, mut left) = read_header(&mut file)?;
    for _ in 0..index {
        let length = read_length(&mut file, &mut left)?;
        file.seek(SeekFrom::Current(length as i64)).map_err(|e| e.to_string())?;
        left -= length;
    }
    let length = read_length(&mut file, &mut left)?;
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(length).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Whether a result is whole and stands under its own key.
fn is_sound(path: &Path) -> bool {
    let sound = || -> Result<bool, String> {
        let mut file = File::open(path).map_err(|e| e.to_string())?;
        let (header, mut left) = read_header(&mut file)?;
        for value in &header.values {
            let length = read_length(&mut file, &mut left)?;
            let mut bytes = Vec::with_capacity(length as usize);
            (&mut file).take(length).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
            left -= length;
            if digest_of(&value.type_name, &bytes) != Digest(value.digest) {
                return Ok(false);
            }
        }
        let key = key::digest(&header.key_text).to_string();
        Ok(left == 0 && path.ends_with(Path::new(&key[..2]).join(&key[2..])))
    };
    sound().unwrap_or(false)
}

fn read_length(file: &mut File, left: &mut u64) -> Result<u64, String> {
    let mut length = [0; 8];
    file.read_exact(&mut length).map_err(|_| "it is cut short".to_owned())?;
    let length = u64::from_le_bytes(length);
    *left = left.checked_sub(8).ok_or("it is cut short")?;
    if length <= *left { Ok(length) } else { Err("it is cut short".to_owned()) }
}

fn sum(entries: &[Stored], report: CacheReport) -> CacheReport {
    CacheReport { entries: entries.len() as u64, bytes: entries.iter().map(|e| e.bytes).sum(), ..report }
}

/// What a folder holds, in a fixed order; nothing when it is not there.
fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(vec![]),
        Err(e) => return Err(e),
    };
    let mut paths = entries.map(|entry| entry.map(|e| e.path())).collect::<io::Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// Whether there was something to delete.
fn remove(path: &Path) -> io::Result<bool> {
    match fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => Ok(false),
        Err(e) => Err(e),
    }
}
