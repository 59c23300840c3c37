//! `VisWinNet`: a window that the photo shows, by a network.

crate::nodes::learned::light_stage! {
    /// Estimates a visible window by a network: a rectangle with lobes for sun, sky and ground.
    VisWinNet, VisWinNetIn, VisWinNetOut: window of "viswinnet.onnx", learned::WINDOW_OUTPUTS, mask
}
