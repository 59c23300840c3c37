//! `VisLampNet`: a lamp that the photo shows, by a network.

crate::nodes::neural::light_stage! {
    /// Estimates a lamp that is seen: a box that shines with one radiance.
    VisLampNet, VisLampNetIn, VisLampNetOut: lamp of "vislampnet.onnx", neural::LAMP_OUTPUTS, mask
}
