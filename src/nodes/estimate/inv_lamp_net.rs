//! `InvLampNet`: the lamp that the photo does not show, by a network.

crate::nodes::learned::light_stage! {
    /// Estimates the lamp out of view by a network: a box of constant radiance, near zero if there is no
    /// such lamp.
    InvLampNet, InvLampNetIn, InvLampNetOut: lamp of "invlampnet.onnx", learned::LAMP_OUTPUTS
}
