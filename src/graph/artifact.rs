//! What travels on wires: typed where stages are written, erased where the engine runs them.

use std::any::Any;
use std::sync::Arc;

use serde::{Serialize, de::DeserializeOwned};

use super::Digest;

/// A type that may travel on a wire.
///
/// The serde form is the canonical form: its postcard bytes are what is digested, compared and stored.
pub trait Artifact: Serialize + DeserializeOwned + Send + Sync + 'static {
    /// The name shown in port listings and fault messages; two types never share one.
    const TYPE: &'static str;
    /// Memory held, in bytes: what the memory cache counts.
    fn bytes(&self) -> usize;
}

/// One artifact with its type forgotten and its content digest known.
#[derive(Clone)]
pub struct Value {
    pub(super) type_name: &'static str,
    pub(super) digest: Digest,
    pub(super) bytes: usize,
    pub(super) data: Arc<dyn Any + Send + Sync>,
    pub(super) encode: fn(&(dyn Any + Send + Sync)) -> Vec<u8>,
}

impl Value {
    /// Erases `artifact`. The digest is taken over its type name and canonical bytes.
    pub fn new<T: Artifact>(artifact: Arc<T>) -> Value {
        let encoded = encode(&*artifact);
        Value::with_digest(artifact, digest_of(T::TYPE, &encoded))
    }

    /// An artifact just decoded from canonical bytes of this digest.
    pub(super) fn stored<T: Artifact>(artifact: T, digest: Digest) -> Value {
        Value::with_digest(Arc::new(artifact), digest)
    }

    fn with_digest<T: Artifact>(artifact: Arc<T>, digest: Digest) -> Value {
        let encode = |data: &(dyn Any + Send + Sync)| {
            encode(data.downcast_ref::<T>().expect("a value's encoder is made beside its data"))
        };
        Value { type_name: T::TYPE, digest, bytes: artifact.bytes(), data: artifact, encode }
    }

    /// The canonical bytes: what is stored.
    pub(super) fn encoded(&self) -> Vec<u8> {
        (self.encode)(&*self.data)
    }

    /// The typed artifact again, or `None` when it is of another type.
    pub fn get<T: Artifact>(&self) -> Option<Arc<T>> {
        self.data.clone().downcast().ok()
    }

    pub fn digest(&self) -> Digest {
        self.digest
    }

    pub fn type_name(&self) -> &'static str {
        self.type_name
    }
}

/// The canonical bytes of an artifact.
pub(super) fn encode<T: Artifact>(artifact: &T) -> Vec<u8> {
    postcard::to_stdvec(artifact).expect("artifacts hold plain data, which postcard always encodes")
}

pub(super) fn digest_of(type_name: &str, encoded: &[u8]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(type_name.as_bytes());
    hasher.update(&[0]);
    hasher.update(encoded);
    Digest(*hasher.finalize().as_bytes())
}
