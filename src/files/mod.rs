//! Scene and edit files, read into settings and set members for a graph, and diagnostics drawn with
//! their places.

pub mod batch;
mod diagnostics;
pub mod edit;
mod keyframes;
mod load;
pub mod scene;

pub use diagnostics::draw;
pub use keyframes::EditFile;
pub use load::{load, load_frame};

use crate::graph::{Diagnostic, Diagnostics, Key, Raw, Source, is_name};

/// The residual's name in pictures and reports; no light may have it.
const REST: &str = "rest";
/// The invisible lights, estimated in every scene.
const INVISIBLE: [&str; 2] = ["inv_lamp", "inv_window"];

/// The fields of the one value `name(..)` of a file. Its `version` must be there and 1, and is left
/// out.
fn fields(
    source: &std::sync::Arc<Source>,
    name: &str,
    known: &[&str],
    faults: &mut Diagnostics,
) -> Vec<(Key, Raw)> {
    let Some(document) = Raw::document(source, faults) else { return Vec::new() };
    let before = faults.found();
    let mut fields = document.as_struct(Some(name), known, faults);
    match fields.iter().position(|(key, _)| key.name == "version") {
        Some(index) => {
            let (_, value) = fields.remove(index);
            if value.text() != "1" {
                faults.push(|| value.fault(format!("wanted version 1, got {}", value.short())));
            }
        }
        None if faults.found() == before => {
            let at = document.variant_origin();
            faults.push(|| {
                Diagnostic::at(&at, format!("this {name} has no version"))
                    .help("write `version: 1,` first")
            });
        }
        None => {}
    }
    fields
}

/// Whether a new light may have this name; else it is a fault.
fn check_light_name(key: &Key, faults: &mut Diagnostics) -> bool {
    let name = &key.name;
    let is_free = name != REST && is_name(name);
    if !is_free {
        faults.push(|| {
            let message = match name == REST {
                true => format!(
                    "the name `{REST}` is reserved: it is the light that no light source explains"
                ),
                false => {
                    format!("wanted a light name that matches [A-Za-z][A-Za-z0-9_]*, got {name:?}")
                }
            };
            Diagnostic::at(&key.origin, message)
        });
    }
    is_free
}
