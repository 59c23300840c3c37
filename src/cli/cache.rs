//! The user's cache: its folder, the key that signs its entries, and `relight cache`.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use etcetera::BaseStrategy;
use relight::graph::{
    self, BlobStore, CacheFolder, CacheKey, Diagnostic, DiskCache, EngineOptions,
};

use super::args::{Cache, CacheAction, CacheAt, CacheUse};
use super::exit::{CliError, Exit};
use super::messages::message;
use super::store::Client;
use super::write;

/// The length of the shortest secret, in bytes: 128 bits.
const LEAST_SECRET: usize = 16;
const MOST_SECRET: u64 = 4096;

/// Runs `relight cache`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn cache(args: &Cache) -> Result<Exit, CliError> {
    #[cfg(feature = "store")]
    if let CacheAction::Stat { store: Some(url), .. } = &args.action {
        return stat_of_store(url);
    }
    let (CacheAction::Stat { at, .. }
    | CacheAction::Gc { at, .. }
    | CacheAction::Verify(at)
    | CacheAction::Clear(at)) = &args.action;
    let folder = folder(at)?;
    let path = folder.path.clone();
    let cache = DiskCache::new(folder);
    let limit = EngineOptions::default().disk_bytes;
    let done = match &args.action {
        CacheAction::Stat { .. } => cache.stat(),
        CacheAction::Gc { bytes, .. } => cache.gc(bytes.unwrap_or(limit)),
        CacheAction::Verify(_) => cache.verify(),
        CacheAction::Clear(_) => cache.clear(),
    };
    let done =
        done.map_err(|e| Diagnostic::file(&path, format!("the cache cannot be used: {e}")))?;
    let mut text = format!(
        "{} entries, {:.1} MB in {}",
        done.entries,
        done.bytes as f64 * 1e-6,
        path.display()
    );
    if let CacheAction::Stat { .. } = &args.action {
        text.push_str(&format!("; runs keep to {} GiB", limit >> 30));
    }
    for (count, what) in [
        (done.removed, "removed"),
        (done.damaged, "damaged"),
        (done.foreign, "not used, as they are signed with another key or belong to another user:"),
    ] {
        if count > 0 {
            text.push_str(&format!("; {what} {count}"));
        }
    }
    write::print(&(text + "\n"))?;
    Ok(if done.damaged > 0 { Exit::Failed } else { Exit::Done })
}

/// The cache of a run, if any. Without a key, a run has no cache on disk, and prints a message.
///
/// # Errors
/// A named key file cannot be used.
pub fn chosen(args: &CacheUse) -> Result<Option<CacheFolder>, Diagnostic> {
    folder_of(args, store(args)?)
}

/// The cache of a run, before a store that is open.
///
/// # Errors
/// A named key file cannot be used.
pub fn folder_of(
    args: &CacheUse,
    store: Option<Arc<Client>>,
) -> Result<Option<CacheFolder>, Diagnostic> {
    if args.no_cache {
        return Ok(None);
    }
    let folder = match folder(&args.at) {
        Err(fault) if args.at.cache_key.is_none() => {
            message!("warning: no cache is used: {fault}");
            return Ok(None);
        }
        folder => folder?,
    };
    let store = store.map(|client| client as Arc<dyn BlobStore>);
    Ok(Some(CacheFolder { store, ..folder }))
}

/// The store that the arguments name.
///
/// # Errors
/// Its address cannot be used.
pub fn store(args: &CacheUse) -> Result<Option<Arc<Client>>, Diagnostic> {
    #[cfg(feature = "store")]
    if let Some(url) = &args.cache_store {
        return Client::open(url).map(Some);
    }
    let _ = args;
    Ok(None)
}

/// Counts the records and the values of a store.
#[cfg(feature = "store")]
fn stat_of_store(url: &str) -> Result<Exit, CliError> {
    let client = Client::open(url)?;
    let [records, values] = ["ac", "cas"].map(|folder| client.count(folder));
    let (records, values) = (records?, values?);
    let days = |age: std::time::Duration| age.as_secs_f64() / 86_400.0;
    let oldest = records.2.max(values.2).map_or(0.0, days);
    write::print(&format!(
        "{} records, {:.1} MB, and {} values, {:.1} MB, in {url}; the oldest is {oldest:.1} days old\n",
        records.0,
        records.1 as f64 * 1e-6,
        values.0,
        values.1 as f64 * 1e-6,
    ))?;
    Ok(Exit::Done)
}

/// The folder and key that the arguments name, or the user's own.
fn folder(at: &CacheAt) -> Result<CacheFolder, Diagnostic> {
    let user = || {
        etcetera::base_strategy::choose_native_strategy().map_err(|e| {
            Diagnostic::file(
                Path::new(""),
                format!("the user's own folders cannot be determined: {e}"),
            )
        })
    };
    let path = match &at.cache {
        Some(path) => path.clone(),
        None => user()
            .map_err(|fault| fault.help("name a folder with --cache DIR"))?
            .cache_dir()
            .join("relight"),
    };
    let secret = match &at.cache_key {
        Some(file) => named_secret(file)?,
        None => own_secret(&user()?.config_dir().join("relight")).map_err(|fault| {
            fault.help("--cache-key FILE names another key, --no-cache works without a cache")
        })?,
    };
    Ok(CacheFolder {
        path,
        key: CacheKey::new(&secret),
        shared: at.cache_key.is_some(),
        store: None,
    })
}

/// The secret in a named file.
fn named_secret(file: &Path) -> Result<Vec<u8>, Diagnostic> {
    let bytes = graph::read(file, MOST_SECRET)
        .map_err(|e| Diagnostic::file(file, format!("cannot be read: {e}")))?;
    let secret = bytes.trim_ascii();
    if secret.len() < LEAST_SECRET {
        let message =
            format!("wanted a secret of at least {LEAST_SECRET} bytes, got {}", secret.len());
        return Err(Diagnostic::file(file, message)
            .help("`head -c 32 /dev/urandom | base64 > FILE` makes one"));
    }
    Ok(secret.to_vec())
}

/// The user's own secret, made when it is first needed.
fn own_secret(folder: &Path) -> Result<Vec<u8>, Diagnostic> {
    let file = folder.join("cache.key");
    let cannot = |e: std::io::Error| {
        Diagnostic::file(&file, format!("the key of the cache cannot be made: {e}"))
    };
    if file.symlink_metadata().is_err_and(|e| e.kind() == std::io::ErrorKind::NotFound) {
        let mut secret = [0; 32];
        getrandom::fill(&mut secret).map_err(|e| cannot(std::io::Error::other(e)))?;
        std::fs::create_dir_all(folder).map_err(cannot)?;
        // Readable by its owner alone; written completely or not at all.
        let mut temporary = tempfile::NamedTempFile::new_in(folder).map_err(cannot)?;
        let digits: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        writeln!(temporary, "{digits}").map_err(cannot)?;
        match temporary.persist_noclobber(&file) {
            Err(e) if e.error.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(cannot(e.error));
            }
            _ => {}
        }
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = file.metadata().map_err(cannot)?.permissions().mode();
        if mode & 0o077 != 0 {
            let message =
                format!("wanted a key that only its owner may read, got mode {:o}", mode & 0o777);
            return Err(Diagnostic::file(&file, message));
        }
    }
    named_secret(&file)
}

/// The name of a project: the cache keeps the last keys of each graph and scene apart.
pub fn project(graph: &Path, scene: Option<&Path>) -> String {
    let place =
        |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned()).display().to_string();
    let parts: [Option<&Path>; 2] = [Some(graph), scene];
    parts.into_iter().flatten().map(place).collect::<Vec<_>>().join("\n")
}
