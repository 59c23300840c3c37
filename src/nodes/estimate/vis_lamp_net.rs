//! `VisLampNet`: a lamp that the photo shows, by a network.

crate::nodes::learned::light_stage! {
    /// Estimates a lamp that is seen: a box that shines with one radiance.
    VisLampNet, VisLampNetIn, VisLampNetOut: lamp of "vislampnet.onnx", learned::LAMP_OUTPUTS, mask
}
