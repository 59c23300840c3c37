//! `CombineAlbedo`: one albedo from two estimates.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Node, NodeError, above};
use crate::image::{Albedo, Plane, luminance};
use crate::nodes::artifacts::same_size;
use crate::{params, ports};

params! {
    /// Combines two estimates of albedo whose errors have different causes: Retinex sees all of the
    /// photo but knows no materials; a network knows materials, but of rooms like those that it
    /// learned from.
    ///
    /// The chromaticity is the network's. The luminance is Y = level Y_retinex^(1 - w) Y_network^w.
    pub struct CombineAlbedo {
        /// Weight w of the network in the log luminance.
        network_weight: f32 = 0.6, in 0.0..=1.0,
        /// Factor of the luminance. Both estimates of large surfaces are too dark: their weighted
        /// geometric mean is 0.94 of the true albedo, on average over 36 rooms.
        level: f32 = 1.08, in above(0.0),
    }
}

ports! {
    pub input CombineAlbedoIn {
        /// Albedo by Retinex, working size.
        retinex: Arc<Albedo>,
        /// Albedo by a network, of the same size.
        network: Arc<Albedo>,
    }
}

ports! {
    pub output CombineAlbedoOut {
        /// The combined albedo, in 0.02..=0.95.
        albedo: Arc<Albedo>,
    }
}

impl Node for CombineAlbedo {
    const KIND: &'static str = "CombineAlbedo";
    const VERSION: u32 = 1;
    type In = CombineAlbedoIn;
    type Out = CombineAlbedoOut;

    fn run(&self, inputs: CombineAlbedoIn, _: &Context) -> Result<CombineAlbedoOut, NodeError> {
        let (retinex, network) = (&inputs.retinex.0, &inputs.network.0);
        let (width, height) = retinex.size();
        same_size("network", network.size(), "retinex", (width, height))?;
        let [least, most] = [super::TUNING.min_albedo, super::TUNING.max_albedo].map(Vec3::splat);
        let combined = |(&retinex, &network): (&Vec3, &Vec3)| {
            let ratio = luminance(retinex.max(least)) / luminance(network.max(least));
            let gain = self.level * ratio.powf(1.0 - self.network_weight);
            (gain * network).clamp(least, most)
        };
        let pixels = retinex.pixels().iter().zip(network.pixels()).map(combined).collect();
        let albedo = Arc::new(Albedo(Plane::new(width, height, pixels)));
        Ok(CombineAlbedoOut { albedo })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn combined(node: &CombineAlbedo, retinex: Vec3, network: Vec3) -> Vec3 {
        let [retinex, network] =
            [retinex, network].map(|a| Arc::new(Albedo(Plane::filled(2, 1, a))));
        let inputs = CombineAlbedoIn { retinex, network };
        let out = node.run(inputs, &Context::default()).expect("the sizes agree");
        out.albedo.0.get(1, 0)
    }

    #[test]
    fn the_luminance_is_the_weighted_geometric_mean_and_the_hue_the_networks() {
        let node = CombineAlbedo { network_weight: 0.25, level: 1.1 };
        let (retinex, network) = (Vec3::new(0.5, 0.4, 0.3), Vec3::new(0.2, 0.3, 0.4));
        let got = combined(&node, retinex, network);
        let wanted = 1.1 * luminance(retinex).powf(0.75) * luminance(network).powf(0.25);
        assert!((luminance(got) - wanted).abs() < 1e-6, "{} for {wanted}", luminance(got));
        let hue = got / luminance(got) - network / luminance(network);
        assert!(hue.abs().max_element() < 1e-6, "{hue}");
    }

    #[test]
    fn extreme_albedos_stay_in_range_and_finite() {
        for weight in [0.0, 0.6, 1.0] {
            let node = CombineAlbedo { network_weight: weight, level: 1.08 };
            for retinex in [0.0, 0.02, 0.95] {
                for network in [Vec3::ZERO, Vec3::new(0.95, 0.0, 0.0), Vec3::splat(0.95)] {
                    let got = combined(&node, Vec3::splat(retinex), network);
                    let inside = got.cmpge(Vec3::splat(0.02)) & got.cmple(Vec3::splat(0.95));
                    assert!(inside.all(), "{got} of {retinex}, {network}");
                }
            }
        }
    }

    #[test]
    fn planes_of_two_sizes_are_an_error() {
        let plane = |width| Arc::new(Albedo(Plane::filled(width, 1, Vec3::ONE)));
        let inputs = CombineAlbedoIn { retinex: plane(2), network: plane(3) };
        let error = CombineAlbedo::default().run(inputs, &Context::default());
        let error = error.err().expect("the sizes differ");
        let text = error.to_string();
        assert!(text.contains("network: wanted 2 x 1 pixels as retinex, got 3 x 1"), "{text}");
    }
}
