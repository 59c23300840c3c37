//! `InvWinNet`: the window that the photo does not show, by a network.

crate::nodes::learned::light_stage! {
    /// Estimates the window out of view by a network: a rectangle with lobes for sun, sky and ground, of
    /// radiance near zero if there is no such window.
    InvWinNet, InvWinNetIn, InvWinNetOut: window of "invwinnet.onnx", learned::WINDOW_OUTPUTS
}
