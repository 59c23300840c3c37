//! The backend in pure Rust, in a build without the feature `rten`: no network can be loaded.

use super::{NetError, Port, Tensor};

/// A network that cannot exist.
pub enum RtenNetwork {}

impl RtenNetwork {
    /// Loads nothing.
    ///
    /// # Errors
    /// `NoBackend`, always.
    pub fn new(_: Vec<u8>, _: usize) -> Result<(RtenNetwork, Vec<Port>, Vec<Port>), NetError> {
        Err(NetError::NoBackend(
            "this program was built without rten (feature `rten`): name the library of ONNX Runtime with --onnxruntime PATH"
                .into(),
        ))
    }

    /// Computes nothing: the type has no values.
    pub fn run(&self, _: Vec<(&str, Tensor)>, _: &[&str]) -> Result<Vec<Tensor>, NetError> {
        match *self {}
    }
}

/// No operator is computed.
pub fn caution(_: &[u8]) -> Option<&'static str> {
    None
}
