//! The networks that ship with the program, in `models/`: a file of one of these names is that
//! network, or an error.

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

/// Tests whether `bytes` are one of the networks that ship. A file under one of their names must be
/// that network.
///
/// # Errors
/// The message names the fault and its remedy.
pub fn ships(file_name: &str, bytes: &[u8]) -> Result<bool, String> {
    let got: String = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    let wanted =
        CARDS.iter().find(|(name, _)| *name == file_name).and_then(|(_, card)| digest_of(card));
    let Some(wanted) = wanted.filter(|wanted| *wanted != got) else {
        return Ok(CARDS.iter().any(|(_, card)| digest_of(card) == Some(&got)));
    };
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
        assert_eq!(ships("own.onnx", b"anything"), Ok(false));
        let message = ships("mnet.onnx", b"anything").expect_err("it is not that network");
        assert!(
            message.contains("wanted SHA-256") && message.contains("models/mnet.onnx"),
            "{message}"
        );
    }
}
