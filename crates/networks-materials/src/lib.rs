//! The network of relight that estimates the materials of a photo, as bytes.
//!
//! The folder `models` of this crate has the card of each: task, data, accuracy, SHA-256.

#![no_std]
#![forbid(unsafe_code)]

/// Name and content of each file.
pub const FILES: &[(&str, &[u8])] = &[("models/mnet.onnx", include_bytes!("../models/mnet.onnx"))];

// A checkout without symbolic links has their texts in place of the networks.
const _: () = {
    let mut i = 0;
    while i < FILES.len() {
        assert!(FILES[i].1.len() > 1024, "check out with `git config core.symlinks true`");
        i += 1;
    }
};
