//! The networks of relight that render layers of light, as bytes.
//!
//! The folder `models` of this crate has the card of each: task, data, accuracy, SHA-256.

#![no_std]
#![forbid(unsafe_code)]

/// Name and content of each file.
pub const FILES: &[(&str, &[u8])] = &[
    ("models/shadownet.onnx", include_bytes!("../models/shadownet.onnx")),
    ("models/indirectnet.onnx", include_bytes!("../models/indirectnet.onnx")),
    ("models/lightnet.onnx", include_bytes!("../models/lightnet.onnx")),
];

// A checkout without symbolic links has their texts in place of the networks.
const _: () = {
    let mut i = 0;
    while i < FILES.len() {
        assert!(FILES[i].1.len() > 1024, "check out with `git config core.symlinks true`");
        i += 1;
    }
};
