//! Text of foreign file formats, made from plain values.

mod usd;
mod usd_frames;

pub use usd::{UsdLight, UsdRoom};
pub use usd_frames::UsdFrames;
