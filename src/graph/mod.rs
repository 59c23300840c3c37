//! The engine: a lazy, cached dataflow graph, independent of light, images and networks.

mod artifact;
mod cache;
mod context;
mod diagnostics;
mod disk;
mod draw;
mod engine;
mod escape;
mod file;
mod form;
mod inputs;
mod key;
mod lexer;
mod node;
mod range;
mod raw;
mod reading;
mod registry;
mod report;
mod resolve;
mod resolved_graph;
mod run;
mod source;
mod store;
pub mod svg;

pub use artifact::{Artifact, Value};
pub use cache::{BlobStore, EarlierResults};
pub use context::{Cancel, Context, NodeError, Services};
pub use diagnostics::Diagnostics;
pub use disk::{CacheFolder, CacheKey, CacheReport, DiskCache};
pub use engine::{Engine, EngineOptions};
pub use escape::{escape, escape_json, escape_line, escape_markup};
pub use file::{GraphFile, Member, NodeInfo, Overlay, SetInfo, Setting, Target};
pub use form::Form;
pub use node::{
    Arity, Gather, InPort, Inputs, Node, OutPort, Outputs, ParamSpec, Params, PortSpec, PortValue,
    Scatter,
};
pub use range::{Number, Ranged, above, check_range, range_text};
pub use raw::{Key, Raw};
pub use reading::{File, MAX_FILE_BYTES, open, plain_error, read};
pub use registry::{KindSpec, Registry};
pub use report::{
    Difference, Ending, Explanation, NodeReport, Observer, PlanLine, Planned, RunReport, Status,
    VerifyReport,
};
pub use resolve::Resolved;
pub use resolved_graph::{ResolvedGraph, Wanted};
pub use source::{Anchor, Diagnostic, Origin, Reach, Source, is_name, nearest};

/// A BLAKE3 digest.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl std::fmt::Display for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const HEX: &[u8; 16] = b"0123456789abcdef";
        let mut text = [0; 64];
        for (pair, byte) in text.chunks_exact_mut(2).zip(self.0) {
            pair.copy_from_slice(&[HEX[usize::from(byte >> 4)], HEX[usize::from(byte & 15)]]);
        }
        f.write_str(std::str::from_utf8(&text).expect("hexadecimal digits are ASCII"))
    }
}

impl std::fmt::Debug for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}

impl serde::Serialize for Digest {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Any serializable value as one line of RON: the form of parameters in keys and in the reference.
///
/// # Panics
/// The value has no RON form, such as a type whose own serialization fails.
pub fn to_ron<T: serde::Serialize>(value: &T) -> String {
    ron::to_string(value).expect("parameters are plain data, which RON always writes")
}

/// RON as people write it here: variants need no second pair of parentheses, optional values no
/// `Some`.
///
/// # Errors
/// The text is not RON, or not of this type; the error has its place.
pub fn from_ron<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, ron::error::SpannedError> {
    use ron::extensions::Extensions;
    ron::Options::default()
        .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME)
        .from_str(text)
}
