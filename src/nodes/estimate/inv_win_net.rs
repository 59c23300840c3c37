//! `InvWinNet`: the window that the photo does not show, by a network.

crate::nodes::neural::light_stage! {
    /// Estimates the window that is not seen: a rectangle before sun, sky and ground, of next to no radiance where there is no such window.
    InvWinNet, InvWinNetIn, InvWinNetOut: window of "invwinnet.onnx", neural::WINDOW_OUTPUTS
}
