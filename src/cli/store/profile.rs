//! Profiles of the AWS command: `~/.aws/credentials` and `~/.aws/config`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use relight::graph;

const MOST: u64 = 1 << 20;

/// The settings of the profile that the environment names, or of `default`, from both files.
/// Profiles that need a log-in or another program (`sso_session`, `role_arn`,
/// `credential_process`) have no keys in these files.
pub fn settings() -> BTreeMap<String, String> {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let profile = variable("AWS_PROFILE").or_else(|| variable("AWS_DEFAULT_PROFILE"));
    let profile = profile.unwrap_or_else(|| "default".to_owned());
    let file = |name: &str, default: &str| {
        let path = variable(name).map(PathBuf::from);
        let path = path.or_else(|| Some(etcetera::home_dir().ok()?.join(".aws").join(default)))?;
        let bytes = graph::read(&path, MOST).ok()?;
        Some(String::from_utf8_lossy(&bytes).into_owned())
    };
    let mut settings = BTreeMap::new();
    for (text, headers) in [
        (file("AWS_CONFIG_FILE", "config"), [format!("profile {profile}"), profile.clone()]),
        (file("AWS_SHARED_CREDENTIALS_FILE", "credentials"), [profile.clone(), profile.clone()]),
    ] {
        settings.extend(section(&text.unwrap_or_default(), &headers));
    }
    settings
}

/// The entries of the sections of an INI file that have one of these names.
fn section(text: &str, names: &[String]) -> BTreeMap<String, String> {
    let mut inside = false;
    let mut entries = BTreeMap::new();
    for line in text.lines() {
        let trimmed = line.trim();
        if trimmed.starts_with(['#', ';']) {
            continue;
        }
        if let Some(header) = trimmed.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            inside = names.iter().any(|name| name == header.trim());
        } else if let Some((name, value)) = trimmed.split_once('=').filter(|_| inside)
            // Entries of a nested block are indented.
            && !line.starts_with([' ', '\t'])
        {
            entries.insert(name.trim().to_ascii_lowercase(), value.trim().to_owned());
        }
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_has_its_own_entries_alone() {
        let text = "[default]\nregion = eu-west-1\n# aws_access_key_id = no\n[profile farm]\n\
                    aws_access_key_id=AKIA\ns3 =\n  region = nested\nregion=us-east-2\n[other]\nregion = x\n";
        let found = section(text, &["profile farm".to_owned()]);
        assert_eq!(found.get("aws_access_key_id").map(String::as_str), Some("AKIA"));
        assert_eq!(found.get("region").map(String::as_str), Some("us-east-2"));
        assert_eq!(section(text, &["default".to_owned()]).len(), 1);
    }
}
