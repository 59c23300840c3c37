//! The disk cache: one file per result, written beside and renamed, every byte checked when it is
//! read.
//!
//! ```text
//! FOLDER/CACHEDIR.TAG         marks the folder as a cache of this program: nothing is done in a folder without it
//! FOLDER/entries/ab/cdef...   a result, by its key
//! FOLDER/tmp/                 results being written; each is locked by its writer
//! FOLDER/latest/0123...       the last key of each node name of one project, for `explain`
//! ```
//! A result: magic (8 bytes), length of the header (8, little endian), BLAKE3 of the header (32),
//! keyed BLAKE3 of the header (32), the header, then the values one after the other. The header
//! holds lengths and digests of the values, so that it can be read and trusted by itself; the
//! values of a stage that is quicker than the disk are left out (`Node::STORED_UP_TO`). Access
//! times are the files' modification times, set when a result is used.
//!
//! A folder may contain files of other users. The keyed digest makes an entry of another key a
//! miss; only regular files with names of the forms above are read or deleted, and no symbolic link
//! within the folder is followed.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use super::artifact::digest_of;
use super::cache::{BlobStore, Header};
use super::{Digest, PortSpec, Value, key, reading};

const MAGIC: &[u8; 8] = b"NODE\0\0\0\x02";
const PREAMBLE: u64 = 80;
/// A header holds a key manifest and a line per value; none comes near this many bytes.
const MAX_HEADER: u64 = 64 << 20;
/// A temporary file that nobody holds a lock on is stale after this long: a writer locks it right
/// after making it.
const STALE: Duration = Duration::from_secs(10);

const TAG: &str = "CACHEDIR.TAG";
/// The signature of the Cache Directory Tagging Specification (<https://bford.info/cachedir/>),
/// which backup programs recognize.
const SIGNATURE: &str = "Signature: 8a477f597d28d172789f06886806bc55\n";
const OWNER: &str = "# A cache of relight, format ";
/// Bytes of a tag that are looked at.
const MAX_TAG: u64 = 4096;
/// Projects whose last keys are kept.
const MAX_PROJECTS: usize = 256;
const MAX_LATEST: u64 = 16 << 20;

/// The secret that a cache's entries are signed with.
#[derive(Clone)]
pub struct CacheKey([u8; 32]);

impl CacheKey {
    /// The key for a secret of any length (BLAKE3's `derive_key`).
    pub fn new(secret: &[u8]) -> CacheKey {
        CacheKey(blake3::derive_key("relight 2026-11 signature of cache entries", secret))
    }

    /// The signature of the header of an entry.
    pub fn sign(&self, header: &[u8]) -> blake3::Hash {
        blake3::keyed_hash(&self.0, header)
    }
}

impl std::fmt::Debug for CacheKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CacheKey(..)")
    }
}

/// A cache folder and how it is used.
#[derive(Clone, Debug)]
pub struct CacheFolder {
    /// The folder; it is created when the first result is stored.
    pub path: PathBuf,
    /// Entries that another key signed count as missing.
    pub key: CacheKey,
    /// Whether other users of the machine may read the entries, as the umask allows; else only
    /// their owner.
    pub shared: bool,
    /// A store behind the folder that several machines share, with entries of the same key.
    pub store: Option<Arc<dyn BlobStore>>,
}

impl CacheFolder {
    /// A folder for one user.
    pub fn new(path: impl Into<PathBuf>, key: CacheKey) -> CacheFolder {
        CacheFolder { path: path.into(), key, shared: false, store: None }
    }
}

/// The results on disk. Several processes may share one folder.
pub struct DiskCache {
    folder: PathBuf,
    key: CacheKey,
    shared: bool,
    /// The folder was seen to carry the mark.
    marked: AtomicBool,
    /// The folders of entries, by first byte of the key, that were seen to be folders and no links.
    shelves: [AtomicBool; 256],
    /// Bytes on disk, once they were counted.
    total: Mutex<Option<u64>>,
}

/// The content of the cache on disk, and the work done on it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CacheReport {
    /// Entries that are there after this call.
    pub entries: u64,
    /// Length of these entries on disk, bytes.
    pub bytes: u64,
    /// Entries deleted by this call.
    pub removed: u64,
    /// Entries whose checksum is wrong; `verify` deletes them.
    pub damaged: u64,
    /// Entries that `verify` found signed with another key, or belonging to another user: they are
    /// not used, and stay.
    pub foreign: u64,
}

/// The content stored under a key.
pub(super) enum Found {
    Nothing,
    Header(Header),
    /// An entry exists, but is damaged: the reason.
    Damaged(String),
    /// An entry of another user, which counts as missing: the reason.
    Foreign(String),
}

/// The state of the folder.
enum Mark {
    /// Not there yet, or empty.
    Absent,
    Ours,
    /// A cache by another version of the program.
    OtherFormat,
    /// A folder of something else.
    Missing,
}

/// Why an entry cannot be used.
pub(super) enum Unusable {
    Damaged(String),
    Foreign(String),
}

impl<T: Into<String>> From<T> for Unusable {
    fn from(damage: T) -> Unusable {
        Unusable::Damaged(damage.into())
    }
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
    /// The cache in a folder, which need not be there yet.
    pub fn new(CacheFolder { path, key, shared, .. }: CacheFolder) -> DiskCache {
        DiskCache {
            folder: path,
            key,
            shared,
            marked: AtomicBool::new(false),
            shelves: [const { AtomicBool::new(false) }; 256],
            total: Mutex::new(None),
        }
    }

    /// Returns the path of the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn mark(&self) -> io::Result<Mark> {
        let read = reading::open_no_follow(&self.folder.join(TAG), MAX_TAG);
        let text = match read.and_then(|(file, _)| reading::read_all(file, MAX_TAG)) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                let is_empty = list(&self.folder)?.is_empty() && !self.folder.is_file();
                return Ok(if is_empty { Mark::Absent } else { Mark::Missing });
            }
            Err(e) if is_foreign(&e) || e.kind() == io::ErrorKind::FileTooLarge => String::new(),
            Err(e) => return Err(e),
        };
        let format = text.strip_prefix(SIGNATURE).and_then(|rest| rest.strip_prefix(OWNER));
        Ok(match format.and_then(|format| format.lines().next()) {
            Some(format) if format == key::FORMAT.to_string() => Mark::Ours,
            Some(_) => Mark::OtherFormat,
            None => Mark::Missing,
        })
    }

    /// Whether results may be looked for in the folder.
    fn is_marked(&self) -> bool {
        self.marked.load(Ordering::Relaxed) || {
            let marked = matches!(self.mark(), Ok(Mark::Ours));
            self.marked.store(marked, Ordering::Relaxed);
            marked
        }
    }

    /// Whether files may be deleted in the folder; nothing is there to delete where it is not
    /// there.
    fn check_mark(&self) -> io::Result<()> {
        match self.mark()? {
            Mark::Absent | Mark::Ours => Ok(()),
            Mark::OtherFormat => Err(io::Error::other(
                "it is the cache of another version of relight; `relight cache clear` empties it",
            )),
            Mark::Missing => Err(io::Error::other(format!(
                "it is not a cache of relight: it has files in it and no {TAG} of relight; name another folder"
            ))),
        }
    }

    /// Makes the folder and its mark where they are not there.
    ///
    /// # Errors
    /// The folder holds something else; those of the system.
    pub fn make(&self) -> io::Result<()> {
        if self.is_marked() {
            return Ok(());
        }
        if let Mark::Absent = self.mark()? {
            let parent = self
                .folder
                .parent()
                .filter(|p| !p.as_os_str().is_empty())
                .unwrap_or(Path::new("."));
            fs::create_dir_all(parent)?;
            let tag = format!(
                "{SIGNATURE}{OWNER}{}\n# Results that can be made again: this folder may be deleted at any time.\n",
                key::FORMAT
            );
            // At once with its mark, so that no other process finds the folder without it. Where
            // that cannot be, as for a folder that something is mounted on, the mark is put into
            // the folder.
            let made =
                self.builder(0o777).prefix(".relight-cache-").tempdir_in(parent).and_then(|made| {
                    fs::write(made.path().join(TAG), &tag)?;
                    fs::rename(made.path(), &self.folder)
                });
            if made.is_err() && matches!(self.mark()?, Mark::Absent) {
                fs::create_dir_all(&self.folder)?;
                fs::write(self.folder.join(TAG), &tag)?;
            }
        }
        self.check_mark()?;
        self.marked.store(true, Ordering::Relaxed);
        Ok(())
    }

    /// For a temporary file or folder that others may read with this mode where the cache is
    /// shared.
    #[cfg_attr(not(unix), expect(unused_variables, reason = "modes are those of Unix"))]
    fn builder(&self, mode: u32) -> tempfile::Builder<'static, 'static> {
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        if self.shared {
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode)); // less what the umask takes away
        }
        builder
    }

    /// The folder of this name within the cache, made where it is not there.
    fn folder_of(&self, name: &str) -> io::Result<PathBuf> {
        let path = self.folder.join(name);
        if !is_folder(&path) {
            match fs::create_dir(&path) {
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists && is_folder(&path) => {}
                made => made?,
            }
        }
        Ok(path)
    }

    /// Counts entries and bytes.
    ///
    /// # Errors
    /// The folder is not a cache; those of the system.
    pub fn stat(&self) -> io::Result<CacheReport> {
        self.check_mark()?;
        Ok(sum(&self.entries()?, CacheReport::default()))
    }

    /// Deletes the longest unused entries until at most `bytes` are left.
    ///
    /// # Errors
    /// The errors of [`DiskCache::stat`].
    ///
    /// # Panics
    /// Another thread panicked while it updated the total size.
    pub fn gc(&self, bytes: u64) -> io::Result<CacheReport> {
        self.check_mark()?;
        self.sweep();
        self.forget_projects(MAX_PROJECTS)?;
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

    /// Reads everything, checks every checksum and signature, deletes damaged entries.
    ///
    /// # Errors
    /// The errors of [`DiskCache::stat`].
    pub fn verify(&self) -> io::Result<CacheReport> {
        self.check_mark()?;
        let mut report = CacheReport::default();
        let mut kept = Vec::new();
        for entry in self.entries()? {
            match self.check(&entry.path) {
                Ok(()) => kept.push(entry),
                Err(Unusable::Foreign(_)) => {
                    report.foreign += 1;
                    kept.push(entry);
                }
                Err(Unusable::Damaged(_)) => {
                    report.damaged += 1;
                    report.removed += u64::from(remove(&entry.path)?);
                }
            }
        }
        Ok(sum(&kept, report))
    }

    /// Deletes everything that the cache made, and nothing else.
    ///
    /// # Errors
    /// The errors of [`DiskCache::stat`], but for a cache of another version.
    ///
    /// # Panics
    /// Another thread panicked while it updated the total size.
    pub fn clear(&self) -> io::Result<CacheReport> {
        if !matches!(self.mark()?, Mark::OtherFormat) {
            self.check_mark()?;
        }
        let mut report = CacheReport::default();
        for entry in self.entries()? {
            report.removed += u64::from(remove(&entry.path)?);
        }
        for shelf in self.shelves()? {
            let _ = fs::remove_dir(shelf);
        }
        self.sweep();
        self.forget_projects(0)?;
        if matches!(self.mark()?, Mark::OtherFormat) {
            remove(&self.folder.join(TAG))?;
        }
        *self.total.lock().expect("nothing panics while it counts") = Some(0);
        Ok(report)
    }

    /// The folders of entries: no links, and of the cache's own names.
    fn shelves(&self) -> io::Result<Vec<PathBuf>> {
        let mut shelves = list_folder(&self.folder.join("entries"))?;
        shelves.retain(|path| is_hex(path, 2) && is_folder(path));
        Ok(shelves)
    }

    fn entries(&self) -> io::Result<Vec<Stored>> {
        let mut entries = Vec::new();
        for shelf in self.shelves()? {
            for path in list_folder(&shelf)?.into_iter().filter(|path| is_hex(path, 62)) {
                // Another process may delete it meanwhile.
                if let Ok(data) = path.symlink_metadata()
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

    /// Whether the folder of a key's entry is there, and is not a link.
    fn has_shelf(&self, key: &Digest) -> bool {
        let seen = &self.shelves[usize::from(key.0[0])];
        seen.load(Ordering::Relaxed) || {
            let entries = self.folder.join("entries");
            let is_there = is_folder(&entries) && is_folder(&entries.join(&key.to_string()[..2]));
            seen.store(is_there, Ordering::Relaxed);
            is_there
        }
    }

    /// The entry of a key; `None` where there is none that the cache could have made.
    fn open_entry(&self, key: &Digest) -> Result<Option<(File, fs::Metadata)>, Unusable> {
        if self.has_shelf(key) { open(&self.path(key)) } else { Ok(None) }
    }

    /// The header under a key; counts as use.
    pub(super) fn header(&self, key: &Digest) -> Found {
        if !self.is_marked() {
            return Found::Nothing;
        }
        match self
            .open_entry(key)
            .map(|entry| entry.map(|(mut file, data)| (self.read_header(&mut file, &data), file)))
        {
            Ok(None) => Found::Nothing,
            Ok(Some((Ok(header), file))) if key::digest(&header.key_manifest) == *key => {
                // Not possible in a read-only folder; then the order of deletion is that of
                // creation.
                #[expect(
                    clippy::disallowed_methods,
                    reason = "the longest unused entry goes first"
                )]
                let _ = file.set_modified(SystemTime::now());
                Found::Header(header)
            }
            Ok(Some((Ok(_), _))) => Found::Damaged("it is stored under another key".to_owned()),
            Ok(Some((Err(Unusable::Damaged(damage)), _))) | Err(Unusable::Damaged(damage)) => {
                Found::Damaged(damage)
            }
            Ok(Some((Err(Unusable::Foreign(why)), _))) | Err(Unusable::Foreign(why)) => {
                Found::Foreign(why)
            }
        }
    }

    /// The checked bytes of one value of a result whose header gave `digest`.
    ///
    /// # Errors
    /// The value is missing, damaged, or signed by another key.
    pub(super) fn value(
        &self,
        key: &Digest,
        index: usize,
        port: &PortSpec,
        digest: Digest,
    ) -> Result<Vec<u8>, Loss> {
        let lost = |unusable| match unusable {
            Unusable::Damaged(damage) => Loss::Damaged(damage),
            Unusable::Foreign(_) => Loss::Gone,
        };
        let (mut file, data) = self.open_entry(key).map_err(lost)?.ok_or(Loss::Gone)?;
        let header = self.read_header(&mut file, &data).map_err(lost)?;
        if !header.has_values {
            return Err(Loss::Gone);
        }
        let bytes =
            read_value(&mut file, &header, index).map_err(|e| Loss::Damaged(e.to_string()))?;
        let whole = digest_of(port.type_name, &bytes) == digest;
        if whole {
            Ok(bytes)
        } else {
            Err(Loss::Damaged(format!("`{}` differs from its digest", port.name)))
        }
    }

    /// Writes a result: to a temporary file, synced, then renamed. Older results make room.
    ///
    /// # Errors
    /// The folder cannot be created or written.
    pub(super) fn store(
        &self,
        key: &Digest,
        header: &Header,
        values: &[Value],
        limit: u64,
    ) -> io::Result<()> {
        let values = if header.has_values { values } else { &[] };
        self.write(key, header, limit, |file| {
            for value in values {
                let mut written = Ok(());
                value.encode(|piece| {
                    if written.is_ok() {
                        written = file.write_all(piece);
                    }
                });
                written?;
            }
            Ok(())
        })
    }

    /// [`DiskCache::store`] of values that are canonical bytes already.
    ///
    /// # Errors
    /// Those of [`DiskCache::store`].
    pub(super) fn store_bytes(
        &self,
        key: &Digest,
        header: &Header,
        values: &[Vec<u8>],
        limit: u64,
    ) -> io::Result<()> {
        self.write(key, header, limit, |file| values.iter().try_for_each(|v| file.write_all(v)))
    }

    fn write(
        &self,
        key: &Digest,
        header: &Header,
        limit: u64,
        write_values: impl FnOnce(&mut File) -> io::Result<()>,
    ) -> io::Result<()> {
        let stored = header.stored();
        let head = signed(header, &self.key);
        let bytes = head.len() as u64 + stored;
        if bytes > limit || head.len() as u64 > PREAMBLE + MAX_HEADER {
            return Ok(());
        }
        self.make()?;
        let path = self.path(key);
        if !self.has_shelf(key) {
            self.folder_of("entries")?;
            self.folder_of(&format!("entries/{}", &key.to_string()[..2]))?;
        }
        let mut file = self.builder(0o666).prefix(NEW).tempfile_in(self.folder_of("tmp")?)?;
        // On a file system without locks, age alone identifies stale files.
        let _ = file.as_file().try_lock();
        file.write_all(&head)?;
        write_values(file.as_file_mut())?;
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
        // A tenth is cleared in advance, so that a full cache does not count its files at every
        // result.
        if total > limit { self.gc(limit - limit / 10).map(drop) } else { Ok(()) }
    }

    /// Deletes a damaged result.
    pub(super) fn drop_entry(&self, key: &Digest) {
        if self.is_marked() && self.has_shelf(key) {
            let _ = remove(&self.path(key));
        }
    }

    /// Deletes temporary files whose writers died.
    fn sweep(&self) {
        let ours = |path: &PathBuf| [NEW, LATEST].iter().any(|prefix| is_temporary(path, prefix));
        for path in
            list_folder(&self.folder.join("tmp")).unwrap_or_default().into_iter().filter(ours)
        {
            let Ok((file, data)) = reading::open_no_follow(&path, u64::MAX) else { continue };
            let old = data.modified().is_ok_and(|m| m.elapsed().is_ok_and(|age| age > STALE));
            if old && !matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock)) {
                let _ = remove(&path);
            }
        }
    }

    /// Deletes the last keys of all projects but the `most` that were used last.
    fn forget_projects(&self, most: usize) -> io::Result<()> {
        let mut projects = Vec::new();
        for path in
            list_folder(&self.folder.join("latest"))?.into_iter().filter(|path| is_hex(path, 64))
        {
            if let Ok(data) = path.symlink_metadata()
                && data.is_file()
            {
                projects.push((data.modified()?, path));
            }
        }
        projects.sort();
        let surplus = projects.len().saturating_sub(most);
        for (_, path) in &projects[..surplus] {
            remove(path)?;
        }
        Ok(())
    }

    /// The last key of each node name of a project.
    pub(super) fn latest(&self, project: &str) -> BTreeMap<String, Digest> {
        let folder = self.folder.join("latest");
        let path = folder.join(key::digest(project).to_string());
        let read = || reading::read_all(open(&path).ok()??.0, MAX_LATEST).ok();
        let bytes =
            (self.is_marked() && is_folder(&folder)).then(read).flatten().unwrap_or_default();
        let line = |line: &str| {
            let (name, hex) = line.rsplit_once(' ')?;
            Some((name.to_owned(), Digest(*blake3::Hash::from_hex(hex).ok()?.as_bytes())))
        };
        String::from_utf8_lossy(&bytes).lines().filter_map(line).collect()
    }

    /// Lays `keys` over the last keys. If two processes do so at once, the keys of one may be lost:
    /// `explain` then compares with the result before.
    ///
    /// # Errors
    /// The file of last keys cannot be written.
    pub(super) fn set_latest(
        &self,
        project: &str,
        keys: &BTreeMap<String, Digest>,
    ) -> io::Result<()> {
        let mut all = self.latest(project);
        let before = all.len();
        let changed = keys
            .iter()
            .filter(|(name, key)| all.insert((*name).clone(), **key) != Some(**key))
            .count();
        if changed == 0 && all.len() == before {
            return Ok(());
        }
        self.make()?;
        let mut file = self.builder(0o666).prefix(LATEST).tempfile_in(self.folder_of("tmp")?)?;
        let text: String = all.iter().map(|(name, key)| format!("{name} {key}\n")).collect();
        file.write_all(text.as_bytes())?;
        let path = self.folder_of("latest")?.join(key::digest(project).to_string());
        file.persist(path).map_err(|e| e.error)?;
        Ok(())
    }

    /// The header, and the file at the first byte behind it.
    fn read_header(&self, file: &mut File, data: &fs::Metadata) -> Result<Header, Unusable> {
        let size = data.len();
        let (header, length) = read_signed(file, size, &self.key).map_err(|why| match why {
            Unusable::Foreign(why) => {
                let owner = owner(data)
                    .map(|user| format!(" and belongs to another user of this machine ({user})"));
                Unusable::Foreign(why + &owner.unwrap_or_default())
            }
            damaged @ Unusable::Damaged(_) => damaged,
        })?;
        if length + header.stored() != size {
            return Err("its length differs from the one in its header".into());
        }
        Ok(header)
    }

    /// Whether a result is complete, signed and stored under its own key.
    fn check(&self, path: &Path) -> Result<(), Unusable> {
        let (mut file, data) = open(path)?.ok_or("it is not there")?;
        let header = self.read_header(&mut file, &data)?;
        let key = key::digest(&header.key_manifest).to_string();
        if !path.ends_with(Path::new(&key[..2]).join(&key[2..])) {
            return Err("it is stored under another key".into());
        }
        for value in header.values.iter().filter(|_| header.has_values) {
            let bytes = read_bytes(&mut file, value.length).map_err(|e| e.to_string())?;
            if digest_of(&value.type_name, &bytes) != Digest(value.digest) {
                return Err("a value differs from its digest".into());
            }
        }
        Ok(())
    }
}

/// A header as entries begin with it: magic, length, checksum, signature, header.
pub(super) fn signed(header: &Header, key: &CacheKey) -> Vec<u8> {
    let header = postcard::to_stdvec(header)
        .expect("headers hold plain data, which postcard always encodes");
    let mut bytes = Vec::with_capacity(PREAMBLE as usize + header.len());
    bytes.extend(MAGIC);
    bytes.extend((header.len() as u64).to_le_bytes());
    bytes.extend(blake3::hash(&header).as_bytes());
    bytes.extend(key.sign(&header).as_bytes());
    bytes.extend(header);
    bytes
}

/// The header at the beginning of an entry of `size` bytes, and the bytes that it takes with all
/// that stands before it.
pub(super) fn read_signed(
    entry: &mut impl Read,
    size: u64,
    key: &CacheKey,
) -> Result<(Header, u64), Unusable> {
    let mut preamble = [0; PREAMBLE as usize];
    entry.read_exact(&mut preamble).map_err(|_| CUT)?;
    let (magic, rest) = preamble.split_at(8);
    let (length, digests) = rest.split_at(8);
    let (checksum, signature) = digests.split_at(32);
    if magic != MAGIC {
        return Err("it does not begin with the signature of a result".into());
    }
    let length = u64::from_le_bytes(length.try_into().expect("eight bytes"));
    if length > MAX_HEADER || length > size.saturating_sub(PREAMBLE) {
        return Err(CUT.into());
    }
    let mut bytes = vec![0; length as usize];
    entry.read_exact(&mut bytes).map_err(|_| CUT)?;
    if blake3::hash(&bytes).as_bytes() != checksum {
        return Err("its header is damaged".into());
    }
    // Compared in constant time, as `blake3::Hash` does.
    if key.sign(&bytes) != *<&[u8; 32]>::try_from(signature).expect("thirty-two bytes") {
        return Err(Unusable::Foreign("it is signed with another key".to_owned()));
    }
    let header =
        postcard::from_bytes(&bytes).map_err(|e| format!("its header cannot be decoded: {e}"))?;
    Ok((header, PREAMBLE + length))
}

/// Temporary files of results, and of last keys.
const NEW: &str = "new-";
const LATEST: &str = "latest-";
const CUT: &str = "it is cut short";

/// Opens a file of the cache; `None` where there is none that the cache could have made.
fn open(path: &Path) -> Result<Option<(File, fs::Metadata)>, Unusable> {
    match reading::open_no_follow(path, u64::MAX) {
        Ok(opened) => Ok(Some(opened)),
        Err(e) if e.kind() == io::ErrorKind::NotFound || is_foreign(&e) => Ok(None),
        Err(e) => match path.symlink_metadata().ok().and_then(|data| owner(&data)) {
            Some(user) => Err(Unusable::Foreign(format!(
                "it belongs to another user of this machine ({user}): {e}"
            ))),
            None => Err(format!("cannot be read: {e}").into()),
        },
    }
}

/// Whether the path of a file holds something else: a link, a pipe, a file in the place of a
/// folder.
fn is_foreign(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::NotADirectory)
}

/// The user that a file belongs to, by number, where that is another one than runs the program.
#[cfg(unix)]
fn owner(data: &fs::Metadata) -> Option<u32> {
    let owner = std::os::unix::fs::MetadataExt::uid(data);
    (owner != nix::unistd::geteuid().as_raw()).then_some(owner)
}

#[cfg(not(unix))]
fn owner(_: &fs::Metadata) -> Option<u32> {
    None
}

/// One value of a file whose position is the end of its header.
fn read_value(file: &mut File, header: &Header, index: usize) -> io::Result<Vec<u8>> {
    let before: u64 = header.values[..index].iter().map(|value| value.length).sum();
    file.seek(SeekFrom::Current(before as i64))?;
    read_bytes(file, header.values[index].length)
}

/// The next bytes of a file whose length was checked.
fn read_bytes(file: &mut File, length: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn is_folder(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|data| data.is_dir())
}

/// Whether a file's name is so many hexadecimal digits, as a digest is written.
fn is_hex(path: &Path, length: usize) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    name.len() == length && name.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// Whether a file is named as `tempfile` names one with this prefix.
fn is_temporary(path: &Path, prefix: &str) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let random = name.strip_prefix(prefix).unwrap_or_default();
    random.len() == 6 && random.bytes().all(|b| b.is_ascii_alphanumeric())
}

/// [`list`] of a folder that must not be a symbolic link.
fn list_folder(folder: &Path) -> io::Result<Vec<PathBuf>> {
    if is_folder(folder) { list(folder) } else { Ok(Vec::new()) }
}

fn sum(entries: &[Stored], report: CacheReport) -> CacheReport {
    CacheReport {
        entries: entries.len() as u64,
        bytes: entries.iter().map(|e| e.bytes).sum(),
        ..report
    }
}

/// The entries of a folder, in a fixed order; none when the folder does not exist.
fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(vec![]);
        }
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
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Ok(false)
        }
        Err(e) => Err(e),
    }
}
