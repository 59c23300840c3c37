//! Text of foreign file formats, made from plain values.

mod usd;

pub use usd::{UsdLight, UsdRoom};
