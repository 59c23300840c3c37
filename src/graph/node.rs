//! Traits and macros of a stage: parameters, ports, and `run`.
//!
//! ```
//! use std::sync::Arc;
//! use relight::graph::{Artifact, Context, Node, NodeError};
//! use relight::{params, ports};
//!
//! #[derive(serde::Serialize, serde::Deserialize)]
//! struct Number(f64);
//! impl Artifact for Number {
//!     const TYPE: &'static str = "Number";
//!     fn bytes(&self) -> usize { 8 }
//! }
//!
//! params! {
//!     /// Multiplies a number.
//!     pub struct Times {
//!         /// Factor of the product.
//!         by: f64 = 2.0, in -1e6..=1e6,
//!     }
//! }
//! ports! { pub input TimesIn { /** The number to multiply. */ number: Arc<Number> } }
//! ports! { pub output TimesOut { /** The product. */ product: Arc<Number> } }
//!
//! impl Node for Times {
//!     const KIND: &'static str = "Times";
//!     const VERSION: u32 = 1;
//!     type In = TimesIn;
//!     type Out = TimesOut;
//!     fn run(&self, inputs: TimesIn, _: &Context) -> Result<TimesOut, NodeError> {
//!         Ok(TimesOut { product: Arc::new(Number(inputs.number.0 * self.by)) })
//!     }
//! }
//! ```

use std::sync::Arc;

use serde::{Serialize, de::DeserializeOwned};

use super::Digest;
use super::artifact::{Artifact, Flag, Value};
use super::context::{Context, NodeError};
use super::form::Form;
use super::reading::File;

/// A stage. `Self` is its parameters, made by [`params!`](crate::params).
pub trait Node: Params + Clone + Serialize + DeserializeOwned + Send + Sync + 'static {
    /// The name that graph files use.
    const KIND: &'static str;
    /// Raised whenever the same inputs give other outputs than before; part of every key.
    const VERSION: u32;
    /// Bytes up to which the cache stores a result on disk. Of a larger one it stores the header
    /// alone, and makes the values again where something needs them: a stage that takes less time
    /// than its result takes to write and read sets a bound. It changes no result.
    const STORED_UP_TO: u64 = u64::MAX;
    /// The input ports.
    type In: Inputs;
    /// The output ports.
    type Out: Outputs;

    /// Checks the parameters: their declared ranges, then [`Node::check_consistency`], which a
    /// stage overrides instead of this.
    ///
    /// # Errors
    /// The parameter, the wanted range, the value: `min_gain: wanted 0..1, got 1.5`.
    fn check(&self) -> Result<(), String> {
        self.check_ranges()?;
        self.check_consistency()
    }

    /// Checks conditions that no range expresses: relations between parameters, and fields of
    /// nested types.
    ///
    /// # Errors
    /// A message that begins with the name of the parameter, by which its place in the file is
    /// found.
    fn check_consistency(&self) -> Result<(), String> {
        Ok(())
    }

    /// The files that `run` will read. Their digests, never their paths, are in the key. Called
    /// again once they have their folders: the files that a file names ([`File::read_unchecked`])
    /// can then be declared too.
    fn files(&mut self) -> Vec<&mut File> {
        Vec::new()
    }

    /// Computes the outputs. The function is pure: its result depends only on the parameters, the
    /// files named by [`Node::files`] and the inputs.
    ///
    /// # Errors
    /// [`NodeError`]: a file, the parameters or the inputs cannot be used, or the run was
    /// cancelled.
    fn run(&self, inputs: Self::In, ctx: &Context) -> Result<Self::Out, NodeError>;
}

/// A parameter's description, for the reference and for messages.
#[derive(Clone, Debug)]
pub struct ParamSpec {
    /// Name of the parameter.
    pub name: &'static str,
    /// Form of its value in a file.
    pub form: Form,
    /// The default as RON.
    pub default: String,
    /// The declared range, such as `0..=1`.
    pub range: Option<String>,
    /// Documentation of the parameter.
    pub doc: &'static str,
}

/// Implemented by [`params!`](crate::params).
pub trait Params: Default {
    /// Documentation of the stage.
    const DOC: &'static str;
    /// Lists the parameters, in the order of declaration.
    fn params() -> Vec<ParamSpec>;
    /// Checks every parameter against its declared range, in the order of declaration.
    ///
    /// # Errors
    /// The first parameter outside its range, with the range and the value.
    fn check_ranges(&self) -> Result<(), String>;
    /// Sets one parameter from its RON text; `None` for an unknown parameter.
    fn set(&mut self, name: &str, ron: &str) -> Option<Result<(), ron::error::SpannedError>>;
    /// Every parameter with its value as RON, in the order of declaration.
    fn values(&self) -> Vec<(&'static str, String)>;
}

/// Declares the parameters of a stage, once: fields, types, defaults, ranges, documentation.
///
/// A field is `/// Documentation.` and `name: type = default,`. A numeric one, or a group of
/// numbers ([`Ranged`](crate::graph::Ranged)), may add its range: `name: f32 = 0.5, in 0.0..=1.0,`.
/// Any [`RangeBounds`](std::ops::RangeBounds) will do, and [`above`](crate::graph::above) is the
/// range without its lower bound. The engine refuses numbers outside, NaN and infinity.
#[macro_export]
macro_rules! params {
    (@range $ty:ty) => { None };
    (@range $ty:ty, $range:expr) => { Some($crate::graph::range_text::<$ty>(&$range)) };
    ($(#[doc = $doc:literal])* $vis:vis struct $name:ident {
        $( $(#[doc = $field_doc:literal])+ $field:ident : $ty:ty = $default:expr $(, in $range:expr)? ),* $(,)?
    }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        $vis struct $name { $( $(#[doc = $field_doc])+ pub $field: $ty ),* }

        impl Default for $name {
            fn default() -> Self { Self { $( $field: $default ),* } }
        }

        impl $crate::graph::Params for $name {
            const DOC: &'static str = concat!($($doc, "\n",)* "");
            fn params() -> Vec<$crate::graph::ParamSpec> {
                #[allow(unused_variables, reason = "a stage may have no parameters")]
                let defaults = Self::default();
                vec![$( $crate::graph::ParamSpec {
                    name: stringify!($field),
                    form: $crate::graph::Form::of::<$ty>(),
                    default: $crate::graph::to_ron(&defaults.$field),
                    range: $crate::params!(@range $ty $(, $range)?),
                    doc: concat!($($field_doc, "\n",)* ""),
                } ),*]
            }
            fn check_ranges(&self) -> Result<(), String> {
                $( $( $crate::graph::check_range(stringify!($field), &self.$field, $range)?; )? )*
                Ok(())
            }
            #[allow(unused_variables, reason = "a stage may have no parameters")]
            fn set(&mut self, name: &str, ron: &str) -> Option<Result<(), ron::error::SpannedError>> {
                $( if name == stringify!($field) {
                    return Some($crate::graph::from_ron(ron).map(|value| self.$field = value));
                } )*
                None
            }
            fn values(&self) -> Vec<(&'static str, String)> {
                vec![$( (stringify!($field), $crate::graph::to_ron(&self.$field)) ),*]
            }
        }
    };
}

/// The number of values at a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arity {
    /// `Arc<T>`: exactly one value.
    One,
    /// `Option<Arc<T>>` on an input: a wire may be missing, or the member may have no value there.
    /// `bool` on an output.
    Optional,
    /// [`Gather`] on an input: all members in member order. [`Scatter`] on an output: one value per
    /// member.
    Many,
}

/// A port's description.
#[derive(Clone, Debug)]
pub struct PortSpec {
    /// Name of the port.
    pub name: &'static str,
    /// Type of its artifacts.
    pub type_name: &'static str,
    /// Number of its values.
    pub arity: Arity,
    /// Documentation of the port.
    pub doc: &'static str,
}

/// The values at one port, with the member names where the port is a [`Gather`] or [`Scatter`].
#[derive(Clone)]
pub enum PortValue {
    /// Exactly one value.
    One(Value),
    /// No value: an optional port without a wire, or a condition that does not hold.
    Missing,
    /// Values by member, in member order.
    Many(Vec<(String, Value)>),
}

/// All members' values, in member order.
pub struct Gather<T>(pub Vec<(String, Arc<T>)>);

impl<T> Gather<T> {
    /// Returns the value of one member.
    pub fn get(&self, member: &str) -> Option<&Arc<T>> {
        self.0.iter().find(|(name, _)| name == member).map(|(_, value)| value)
    }

    /// Iterates over members and values, in member order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Arc<T>)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }
}

/// One value per member: a consumer declared `each` over a set takes its own member's value, whose
/// digest is its own, so that a change of one member leaves the others' consumers untouched.
pub struct Scatter<T>(pub Vec<(String, Arc<T>)>);

/// The input ports of a stage; made by [`ports!`](crate::ports).
pub trait Inputs: Sized {
    /// Lists the ports, in the order of declaration.
    fn ports() -> Vec<PortSpec>;
    /// `values` are in the order of [`Inputs::ports`] and already checked against it.
    fn take(values: Vec<PortValue>) -> Self;
}

/// The output ports of a stage; made by [`ports!`](crate::ports).
pub trait Outputs: Sized {
    /// Lists the ports, in the order of declaration.
    fn ports() -> Vec<PortSpec>;
    /// In the order of [`Outputs::ports`].
    fn give(self) -> Vec<PortValue>;
    /// Decodes one stored value of the port at `index` of [`Outputs::ports`], whose `digest` was
    /// checked.
    ///
    /// # Errors
    /// No port has this index, or the bytes are not a valid value of its type.
    fn decode(index: usize, bytes: Vec<u8>, digest: Digest) -> Result<Value, String>;
}

/// A field type that can be an input port.
pub trait InPort: Sized {
    /// Name of the artifact type.
    const TYPE: &'static str;
    /// Number of values that the port takes.
    const ARITY: Arity;
    /// Converts a value that was checked against [`InPort::TYPE`] and [`InPort::ARITY`].
    ///
    /// # Panics
    /// The value has another type or arity.
    fn take(value: PortValue) -> Self;
}

/// A field type that can be an output port.
pub trait OutPort: Sized {
    /// Name of the artifact type.
    const TYPE: &'static str;
    /// Number of values that the port gives.
    const ARITY: Arity;
    /// Decodes one stored value of this port's type, whose `digest` was checked.
    ///
    /// # Errors
    /// The bytes are not a valid value of the type.
    fn decode(bytes: Vec<u8>, digest: Digest) -> Result<Value, String>;
    /// Converts the field to the values of the port.
    fn give(self) -> PortValue;
}

const CHECKED: &str = "the engine checked this port's type and arity when the graph was loaded";

impl<T: Artifact> InPort for Arc<T> {
    const TYPE: &'static str = T::TYPE;
    const ARITY: Arity = Arity::One;
    fn take(value: PortValue) -> Self {
        match value {
            PortValue::One(value) => value.get().expect(CHECKED),
            _ => unreachable!("{CHECKED}"),
        }
    }
}

impl<T: Artifact> InPort for Option<Arc<T>> {
    const TYPE: &'static str = T::TYPE;
    const ARITY: Arity = Arity::Optional;
    fn take(value: PortValue) -> Self {
        match value {
            PortValue::Missing => None,
            one => Some(<Arc<T> as InPort>::take(one)),
        }
    }
}

impl<T: Artifact> InPort for Gather<T> {
    const TYPE: &'static str = T::TYPE;
    const ARITY: Arity = Arity::Many;
    fn take(value: PortValue) -> Self {
        match value {
            PortValue::Many(values) => Gather(
                values.into_iter().map(|(name, v)| (name, v.get().expect(CHECKED))).collect(),
            ),
            _ => unreachable!("{CHECKED}"),
        }
    }
}

fn decode<T: Artifact>(bytes: Vec<u8>, digest: Digest) -> Result<Value, String> {
    let length = bytes.len() as u64;
    let artifact = T::decode(bytes).and_then(|artifact| artifact.check().map(|()| artifact));
    Ok(Value::stored(
        artifact.map_err(|message| format!("{}: {message}", T::TYPE))?,
        digest,
        length,
    ))
}

impl<T: Artifact> OutPort for Arc<T> {
    const TYPE: &'static str = T::TYPE;
    const ARITY: Arity = Arity::One;
    fn decode(bytes: Vec<u8>, digest: Digest) -> Result<Value, String> {
        decode::<T>(bytes, digest)
    }
    fn give(self) -> PortValue {
        PortValue::One(Value::new(self))
    }
}

/// A condition for nodes with `when`: a true one is a value, a false one is missing.
impl OutPort for bool {
    const TYPE: &'static str = Flag::TYPE;
    const ARITY: Arity = Arity::Optional;
    fn decode(bytes: Vec<u8>, digest: Digest) -> Result<Value, String> {
        decode::<Flag>(bytes, digest)
    }
    fn give(self) -> PortValue {
        if self { PortValue::One(Value::new(Arc::new(Flag))) } else { PortValue::Missing }
    }
}

impl<T: Artifact> OutPort for Scatter<T> {
    const TYPE: &'static str = T::TYPE;
    const ARITY: Arity = Arity::Many;
    fn decode(bytes: Vec<u8>, digest: Digest) -> Result<Value, String> {
        decode::<T>(bytes, digest)
    }
    fn give(self) -> PortValue {
        PortValue::Many(self.0.into_iter().map(|(name, v)| (name, Value::new(v))).collect())
    }
}

/// Declares the input or output ports of a stage, once, as the fields of a struct.
///
/// Input fields are `Arc<T>`, `Option<Arc<T>>` or [`Gather<T>`](crate::graph::Gather); output
/// fields are `Arc<T>`, [`Scatter<T>`](crate::graph::Scatter) or, for a condition, `bool`; every
/// `T` is an [`Artifact`](crate::graph::Artifact).
#[macro_export]
macro_rules! ports {
    ($vis:vis input $name:ident { $( $(#[doc = $doc:literal])* $field:ident : $ty:ty ),* $(,)? }) => {
        /// Values at the input ports of a stage, one field per port.
        $vis struct $name { $( $(#[doc = $doc])* pub $field: $ty ),* }
        impl $crate::graph::Inputs for $name {
            fn ports() -> Vec<$crate::graph::PortSpec> {
                vec![$( $crate::graph::PortSpec {
                    name: stringify!($field),
                    type_name: <$ty as $crate::graph::InPort>::TYPE,
                    arity: <$ty as $crate::graph::InPort>::ARITY,
                    doc: concat!($($doc, "\n",)* ""),
                } ),*]
            }
            fn take(values: Vec<$crate::graph::PortValue>) -> Self {
                #[allow(unused_mut, unused_variables, reason = "a stage may have no ports")]
                let mut values = values.into_iter();
                Self { $( $field: <$ty as $crate::graph::InPort>::take(
                    values.next().expect("one value per declared port")) ),* }
            }
        }
    };
    ($vis:vis output $name:ident { $( $(#[doc = $doc:literal])* $field:ident : $ty:ty ),* $(,)? }) => {
        /// Values at the output ports of a stage, one field per port.
        $vis struct $name { $( $(#[doc = $doc])* pub $field: $ty ),* }
        impl $crate::graph::Outputs for $name {
            fn ports() -> Vec<$crate::graph::PortSpec> {
                vec![$( $crate::graph::PortSpec {
                    name: stringify!($field),
                    type_name: <$ty as $crate::graph::OutPort>::TYPE,
                    arity: <$ty as $crate::graph::OutPort>::ARITY,
                    doc: concat!($($doc, "\n",)* ""),
                } ),*]
            }
            fn give(self) -> Vec<$crate::graph::PortValue> {
                vec![$( $crate::graph::OutPort::give(self.$field) ),*]
            }
            fn decode(
                index: usize,
                bytes: Vec<u8>,
                digest: $crate::graph::Digest,
            ) -> Result<$crate::graph::Value, String> {
                type Decode = fn(Vec<u8>, $crate::graph::Digest) -> Result<$crate::graph::Value, String>;
                let ports: &[Decode] = &[$( <$ty as $crate::graph::OutPort>::decode ),*];
                ports.get(index).ok_or_else(|| format!("the output port {index} does not exist"))?(bytes, digest)
            }
        }
    };
}
