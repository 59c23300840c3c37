//! The engine: a lazy, cached dataflow graph. It knows nothing of light, images or networks.

mod artifact;
mod context;
mod node;

pub use artifact::{Artifact, Value};
pub use context::{Cancel, Context, NodeError};
pub use node::{
    Arity, File, Gather, InPort, Inputs, Node, OutPort, Outputs, ParamSpec, Params, PortSpec, PortValue, Scatter,
};

/// A BLAKE3 digest.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl std::fmt::Display for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::fmt::Debug for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}

/// Any serialisable value as one line of RON: how parameters stand in keys and in the reference.
pub fn to_ron<T: serde::Serialize>(value: &T) -> String {
    ron::to_string(value).expect("parameters are plain data, which RON always writes")
}

/// RON as people write it here: variants need no second pair of parentheses, optional values no `Some`.
pub fn from_ron<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, ron::error::SpannedError> {
    use ron::extensions::Extensions;
    ron::Options::default()
        .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME)
        .from_str(text)
}
