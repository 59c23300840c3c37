//! The address of a store, and the credentials for it: the environment, profiles, and the services
//! of the clouds for their own machines.

use std::path::Path as FilePath;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use relight::graph::Diagnostic;
use url::Url;

use super::profile;
use super::secrets::Secrets;

/// Time for a request, without the time for its bytes.
pub const PATIENCE: Duration = Duration::from_secs(10);
const CONNECT: Duration = Duration::from_secs(3);
/// Attempts after the first.
const RETRIES: usize = 2;
const HELP: &str = "for example s3://bucket/prefix, gs://bucket/prefix, az://container/prefix or \
                    file:///folder; credentials come from the environment (docs/farm.md)";

/// Entries of a profile, and the settings of the client that they are.
const PROFILE: [(&str, AmazonS3ConfigKey); 5] = [
    ("aws_access_key_id", AmazonS3ConfigKey::AccessKeyId),
    ("aws_secret_access_key", AmazonS3ConfigKey::SecretAccessKey),
    ("aws_session_token", AmazonS3ConfigKey::Token),
    ("region", AmazonS3ConfigKey::Region),
    ("endpoint_url", AmazonS3ConfigKey::Endpoint),
];

type Opened = (Box<dyn ObjectStore>, Path, Secrets);

/// Checks an address and the settings for it.
///
/// # Errors
/// Those of [`open`].
pub fn check(text: &str) -> Result<(), Diagnostic> {
    open(text).map(drop)
}

/// The store at an address, and the prefix of its blobs.
///
/// # Errors
/// The address or a setting cannot be used.
pub fn open(text: &str) -> Result<Opened, Diagnostic> {
    // An address with a password must not be repeated.
    let refused = |message: String| Diagnostic::file("--cache-store".as_ref(), message).help(HELP);
    let url =
        Url::parse(text).map_err(|e| refused(format!("wanted the address of a store: {e}")))?;
    if !url.username().is_empty() || url.password().is_some() || url.query().is_some() {
        let message = "wanted an address without a name, a password and a query: got one with them";
        return Err(refused(message.to_owned()));
    }
    let prefix = Path::from_url_path(url.path());
    let prefix = prefix.map_err(|e| refused(format!("`{text}`: the prefix is not valid: {e}")))?;
    let profile = profile::settings();
    let of_profile = profile.iter().filter(|(name, _)| name.starts_with("aws_"));
    let secrets = Secrets::new(of_profile.map(|(_, value)| value.clone()));
    let cannot = |e: object_store::Error| {
        refused(format!("`{text}` cannot be opened: {}", secrets.redact(&e.to_string())))
    };
    let bucket = format!("{}://{}", url.scheme(), url.host_str().unwrap_or_default());
    let store: Box<dyn ObjectStore> = match url.scheme() {
        "s3" => Box::new(s3(&bucket, &profile).build().map_err(cannot)?),
        "gs" => {
            let builder = GoogleCloudStorageBuilder::from_env().with_url(bucket);
            let builder = builder.with_client_options(client(false)).with_retry(retry());
            Box::new(builder.build().map_err(cannot)?)
        }
        "az" => {
            let emulator = std::env::var_os("AZURE_STORAGE_USE_EMULATOR").is_some();
            let builder = MicrosoftAzureBuilder::from_env().with_url(bucket);
            let builder = builder.with_client_options(client(emulator)).with_retry(retry());
            Box::new(builder.build().map_err(cannot)?)
        }
        "file" => {
            let folder = url.to_file_path();
            let folder =
                folder.map_err(|()| refused(format!("`{text}`: wanted file:///folder")))?;
            return Ok((Box::new(local(&folder)?), Path::default(), secrets));
        }
        other => {
            let message =
                format!("wanted an address that begins with s3, gs, az or file, got `{other}`");
            return Err(refused(message));
        }
    };
    Ok((store, prefix, secrets))
}

/// Settings of the environment win over those of the profile.
fn s3(bucket: &str, profile: &std::collections::BTreeMap<String, String>) -> AmazonS3Builder {
    let mut builder = AmazonS3Builder::from_env().with_url(bucket);
    let has_keys = builder.get_config_value(&AmazonS3ConfigKey::AccessKeyId).is_some();
    for (name, key) in PROFILE {
        let is_credential = name.starts_with("aws_");
        if let Some(value) = profile.get(name)
            && builder.get_config_value(&key).is_none()
            && !(is_credential && has_keys)
        {
            builder = builder.with_config(key, value);
        }
    }
    // Whoever names an endpoint without encryption wants that; requests are signed, and carry no
    // secret.
    let endpoint = builder.get_config_value(&AmazonS3ConfigKey::Endpoint);
    let plain = endpoint.is_some_and(|endpoint| endpoint.starts_with("http://"));
    builder.with_client_options(client(plain)).with_retry(retry())
}

fn local(folder: &FilePath) -> Result<LocalFileSystem, Diagnostic> {
    let cannot = |why: String| Diagnostic::file(folder, format!("the store cannot be used: {why}"));
    std::fs::create_dir_all(folder).map_err(|e| cannot(e.to_string()))?;
    LocalFileSystem::new_with_prefix(folder).map_err(|e| cannot(e.to_string()))
}

fn client(plain: bool) -> ClientOptions {
    // reqwest takes the provider of the process; another part of the program may have set it.
    let _ = rustls::crypto::ring::default_provider().install_default();
    ClientOptions::new().with_connect_timeout(CONNECT).with_allow_http(plain)
}

fn retry() -> RetryConfig {
    let backoff = BackoffConfig {
        init_backoff: Duration::from_millis(100),
        max_backoff: Duration::from_secs(2),
        base: 2.0,
    };
    RetryConfig { backoff, max_retries: RETRIES, retry_timeout: PATIENCE }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_that_cannot_be_used_are_refused_without_repeating_a_password() {
        for (text, wanted) in [
            ("bucket/prefix", "wanted the address of a store"),
            ("ftp://bucket", "got `ftp`"),
            ("s3://name:geheim@bucket/prefix", "without a name, a password"),
            ("s3://bucket/prefix?sig=geheim", "without a name, a password"),
        ] {
            let fault = open(text).err().expect(text).to_string();
            assert!(fault.contains(wanted) && !fault.contains("geheim"), "{text}: {fault}");
        }
    }
}
