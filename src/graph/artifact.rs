//! Artifacts are the values on wires: typed where stages are written, erased where the engine runs
//! them.

use std::any::Any;
use std::sync::Arc;

use postcard::ser_flavors::Flavor;
use serde::{Serialize, de::DeserializeOwned};

use super::Digest;

/// A type that may travel on a wire.
///
/// The serde form is the canonical form: its postcard bytes are digested, compared and stored.
///
/// ```
/// use relight::graph::Artifact;
///
/// /// Illuminance of a white surface of value 1, lux.
/// #[derive(serde::Serialize, serde::Deserialize)]
/// struct Exposure(f32);
///
/// impl Artifact for Exposure {
///     const TYPE: &'static str = "Exposure";
///     fn bytes(&self) -> usize {
///         size_of::<Exposure>()
///     }
///     fn check(&self) -> Result<(), String> {
///         if self.0 > 0.0 { Ok(()) } else { Err(format!("wanted more than 0 lux, got {}", self.0)) }
///     }
/// }
///
/// let stored = 1.0f32.to_le_bytes().to_vec();
/// assert_eq!(Exposure::decode(stored)?.check(), Ok(()));
/// # Ok::<(), String>(())
/// ```
pub trait Artifact: Serialize + DeserializeOwned + Send + Sync + 'static {
    /// The name shown in port listings and fault messages; two types never share one.
    const TYPE: &'static str;
    /// Memory of the value in bytes, as the memory cache counts it.
    fn bytes(&self) -> usize;
    /// A value from its canonical bytes, which a large one may keep so that it is not held twice.
    ///
    /// # Errors
    /// The bytes are not those of such a value.
    fn decode(bytes: Vec<u8>) -> Result<Self, String> {
        match postcard::take_from_bytes(&bytes) {
            Ok((value, [])) => Ok(value),
            Ok((_, rest)) => {
                Err(format!("wanted the end of the value, got {} more bytes", rest.len()))
            }
            Err(e) => Err(e.to_string()),
        }
    }
    /// Whether a value that was read from disk keeps the rules of its type that its form does not
    /// enforce, such as indices in range: every user of the type relies on them without a check.
    /// The engine recomputes a value that breaks them.
    ///
    /// # Errors
    /// The message states the wanted and the actual content.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}

/// The value of an output of type `bool` that is true; a false one has none.
#[derive(Serialize, serde::Deserialize)]
pub(super) struct Flag;

impl Artifact for Flag {
    const TYPE: &'static str = "Flag";
    fn bytes(&self) -> usize {
        0
    }
}

/// Hands the canonical bytes of an artifact to the second argument.
type Encode = fn(&(dyn Any + Send + Sync), &mut dyn FnMut(&[u8]));

/// One artifact with its type forgotten and its content digest known.
#[derive(Clone)]
pub struct Value {
    pub(super) type_name: &'static str,
    pub(super) digest: Digest,
    pub(super) bytes: usize,
    /// Length of the canonical bytes.
    pub(super) length: u64,
    pub(super) data: Arc<dyn Any + Send + Sync>,
    encode: Encode,
}

impl Value {
    /// Erases `artifact`. The digest is taken over its type name and canonical bytes.
    pub fn new<T: Artifact>(artifact: Arc<T>) -> Value {
        let (mut hasher, mut length) = (hasher(T::TYPE), 0);
        encode(&*artifact, |piece| {
            digest_piece(&mut hasher, piece);
            length += piece.len() as u64;
        });
        Value::with_digest(artifact, Digest(*hasher.finalize().as_bytes()), length)
    }

    /// An artifact just decoded from `length` canonical bytes of this digest.
    pub(super) fn stored<T: Artifact>(artifact: T, digest: Digest, length: u64) -> Value {
        Value::with_digest(Arc::new(artifact), digest, length)
    }

    fn with_digest<T: Artifact>(artifact: Arc<T>, digest: Digest, length: u64) -> Value {
        let encode = |data: &(dyn Any + Send + Sync), take: &mut dyn FnMut(&[u8])| {
            encode(
                data.downcast_ref::<T>().expect("a value's encoder is made beside its data"),
                take,
            );
        };
        Value {
            type_name: T::TYPE,
            digest,
            bytes: artifact.bytes(),
            length,
            data: artifact,
            encode,
        }
    }

    /// Hands the canonical bytes to `take`, piece by piece.
    pub(super) fn encode(&self, mut take: impl FnMut(&[u8])) {
        (self.encode)(&*self.data, &mut take);
    }

    /// The typed artifact again, or `None` when it is of another type.
    pub fn get<T: Artifact>(&self) -> Option<Arc<T>> {
        self.data.clone().downcast().ok()
    }

    /// Returns the digest of the type's name and the canonical bytes.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// Returns the name of the value's type, as ports declare it.
    pub fn type_name(&self) -> &'static str {
        self.type_name
    }
}

/// The canonical bytes of an artifact, piece by piece: large planes are neither copied nor held
/// twice.
fn encode<T: Artifact>(artifact: &T, take: impl FnMut(&[u8])) {
    let pieces = Pieces { small: Vec::with_capacity(2 * SMALL), take };
    postcard::serialize_with_flavor(artifact, pieces)
        .expect("artifacts hold plain data, which postcard always encodes");
}

/// Pieces below this size are put together first.
const SMALL: usize = 16 << 10;

struct Pieces<F> {
    small: Vec<u8>,
    take: F,
}

impl<F: FnMut(&[u8])> Pieces<F> {
    fn flush(&mut self) {
        if !self.small.is_empty() {
            (self.take)(&self.small);
            self.small.clear();
        }
    }
}

impl<F: FnMut(&[u8])> Flavor for Pieces<F> {
    type Output = ();

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.try_extend(&[byte])
    }

    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        if bytes.len() >= SMALL {
            self.flush();
            (self.take)(bytes);
        } else {
            self.small.extend_from_slice(bytes);
            if self.small.len() >= SMALL {
                self.flush();
            }
        }
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<()> {
        self.flush();
        Ok(())
    }
}

/// Computes the digest of a value of type `type_name` from its canonical bytes.
pub(super) fn digest_of(type_name: &str, encoded: &[u8]) -> Digest {
    let mut hasher = hasher(type_name);
    digest_piece(&mut hasher, encoded);
    Digest(*hasher.finalize().as_bytes())
}

/// [`digest_of`] for a thread that holds a lock: it takes up no other work meanwhile.
pub(super) fn digest_on_one_thread(type_name: &str, encoded: &[u8]) -> Digest {
    Digest(*hasher(type_name).update(encoded).finalize().as_bytes())
}

/// Bytes from which on several threads digest a piece.
const LARGE: usize = 1 << 20;

fn digest_piece(hasher: &mut blake3::Hasher, piece: &[u8]) {
    if piece.len() < LARGE {
        hasher.update(piece);
    } else {
        hasher.update_rayon(piece);
    }
}

/// A digest is taken over the type's name and the canonical bytes.
fn hasher(type_name: &str) -> blake3::Hasher {
    let mut hasher = blake3::Hasher::new();
    hasher.update(type_name.as_bytes());
    hasher.update(&[0]);
    hasher
}
