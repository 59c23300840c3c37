//! `VisLampNet`: a lamp that the photo shows, by a network.

crate::nodes::learned::light_stage! {
    /// Estimates a visible lamp by a network: a box of constant radiance.
    VisLampNet, VisLampNetIn, VisLampNetOut: lamp of "vislampnet.onnx", learned::LAMP_OUTPUTS, mask
}
