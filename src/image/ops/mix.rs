//! Sums of pictures.

use glam::Vec3;
use rayon::prelude::*;

use crate::image::{Layer, Plane};

/// sum_k w_k L_k, channel by channel: light adds, so a picture under other radiances is the sum of
/// its layers, each times the factor of its radiance. Terms are added in their order, for any
/// number of threads.
///
/// # Panics
/// `layers` is empty, or layers differ in size.
pub fn weighted_sum(layers: &[(&Layer, Vec3)]) -> Plane<Vec3> {
    let (width, height) = layers.first().expect("a sum has terms").0.size();
    assert!(
        layers.iter().all(|(layer, _)| layer.size() == (width, height)),
        "layers of one picture have one size"
    );
    let mut sums: Vec<Vec3> = bytemuck::zeroed_vec(width * height);
    sums.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, sums)| {
        // Memory that is read before it is written costs the system two faults.
        sums.fill(Vec3::ZERO);
        for (layer, weight) in layers {
            layer.add(*weight, y * width, sums);
        }
    });
    Plane::new(width, height, sums)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_layer_counts_with_its_weight_per_channel() {
        let layer = |colors: [Vec3; 2]| Layer::new(Plane::new(2, 1, colors.to_vec()));
        let a = layer([Vec3::new(1.0, 2.0, 4.0), Vec3::ZERO]);
        let b = layer([Vec3::splat(8.0), Vec3::new(0.0, 0.0, 1.0)]);
        let sum = weighted_sum(&[(&a, Vec3::new(0.5, 1.0, 0.0)), (&b, Vec3::splat(0.25))]);
        assert_eq!(sum.pixels(), [Vec3::new(2.5, 4.0, 2.0), Vec3::new(0.0, 0.0, 0.25)]);
    }
}
