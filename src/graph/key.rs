//! Key texts.
