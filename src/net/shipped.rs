//! The networks that ship with the program, in `models/`: a file of one of these names is that network, or an error.

use sha2::{Digest, Sha256};

/// File name and card of each; the card names the digest.
pub const CARDS: [(&str, &str); 8] = [
    ("mnet.onnx", include_str!("../../models/mnet.md")),
    ("vislampnet.onnx", include_str!("../../models/vislampnet.md")),
    ("viswinnet.onnx", include_str!("../../models/viswinnet.md")),
    ("invlampnet.onnx", include_str!("../../models/invlampnet.md")),
    ("invwinnet.onnx", include_str!("../../models/invwinnet.md")),
    ("shadownet.onnx", include_str!("../../models/shadownet.md")),
    ("indirectnet.onnx", include_str!("../../models/indirectnet.md")),
    ("lightnet.onnx", include_str!("../../models/lightnet.md")),
];

/// Whether `bytes` are the network that ships as `file_name`; a file of another name may be anything.
///
/// # Errors
/// What is wrong, and how to mend it.
pub fn check_digest(file_name: &str, bytes: &[u8]) -> Result<(), String> {
    let Some(wanted) = CARDS.iter().find(|(name, _)| *name == file_name).and_then(|(_, card)| digest_of(card)) else {
        return Ok(());
    };
    let got: String = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    if got == wanted {
        return Ok(());
    }
    Err(format!(
        "it is damaged, or of another version of relight: wanted SHA-256 {wanted}, got {got}; take models/{file_name} of this version, \
         or give a network of your own another name"
    ))
}

/// The SHA-256 in the table of a card.
fn digest_of(card: &str) -> Option<&str> {
    card.lines().find_map(|line| line.strip_prefix("| SHA-256 | `")?.split('`').next())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_card_names_a_digest() {
        for (name, card) in CARDS {
            assert_eq!(digest_of(card).map(str::len), Some(64), "{name}");
        }
    }

    #[test]
    fn a_file_of_a_shipped_name_must_be_that_network() {
        assert!(check_digest("own.onnx", b"anything").is_ok());
        let message = check_digest("mnet.onnx", b"anything").expect_err("it is not that network");
        assert!(message.contains("wanted SHA-256") && message.contains("models/mnet.onnx"), "{message}");
    }
}
