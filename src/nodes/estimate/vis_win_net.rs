//! `VisWinNet`: a window that the photo shows, by a network.

crate::nodes::neural::light_stage! {
    /// Estimates a window that is seen: a rectangle before sun, sky and ground.
    VisWinNet, VisWinNetIn, VisWinNetOut: window of "viswinnet.onnx", neural::WINDOW_OUTPUTS, mask
}
