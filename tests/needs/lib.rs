//! The attribute `#[needs("../shared/truth")]` of tests that need files outside the repository.

use std::path::Path;

use proc_macro::TokenStream;

/// The attribute makes a test ignored, with the path as the reason, if nothing is at the path.
///
/// The path is relative to the package, and is looked for when the test is compiled. The attribute
/// stands above `#[test]`.
///
/// # Panics
/// The compiler was not started by Cargo, or the attribute stands below `#[test]`, where it comes
/// too late to ignore the test.
#[proc_macro_attribute]
pub fn needs(path: TokenStream, test: TokenStream) -> TokenStream {
    let path = path.to_string();
    let path = path.trim_matches('"');
    let attributes = test.to_string().replace(char::is_whitespace, "");
    assert!(attributes.contains("#[test]"), "#[needs(..)] stands above #[test]");
    let package = std::env::var("CARGO_MANIFEST_DIR").expect("cargo names the package");
    if Path::new(&package).join(path).exists() {
        return test;
    }
    let mut ignored: TokenStream =
        format!("#[ignore = \"needs {path}\"]").parse().expect("an attribute is Rust");
    ignored.extend(test);
    ignored
}
