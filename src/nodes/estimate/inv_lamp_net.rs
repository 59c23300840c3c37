//! `InvLampNet`: the lamp that the photo does not show, by a network.

crate::nodes::neural::light_stage! {
    /// Estimates the lamp that is not seen: a box that shines with one radiance, next to none where there is no such lamp.
    InvLampNet, InvLampNetIn, InvLampNetOut: lamp of "invlampnet.onnx", neural::LAMP_OUTPUTS
}
