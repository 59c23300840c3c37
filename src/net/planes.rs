//! Planes of pixels to tensors [1, channels, height, width] and back.

use glam::Vec3;

use super::Tensor;
use crate::image::Plane;

/// Planes that become channels of one input, in their order.
pub enum InputLayer<'a> {
    /// Three channels.
    Color(&'a Plane<Vec3>),
    /// One channel.
    Gray(&'a Plane<f32>),
}

/// The channels of `layers`, which are all of one size.
pub fn planes_of(layers: &[InputLayer]) -> Tensor {
    let mut data = Vec::new();
    let (mut size, mut channels) = ((0, 0), 0);
    for layer in layers {
        match layer {
            InputLayer::Color(plane) => {
                size = plane.size();
                channels += 3;
                (0..3).for_each(|c| data.extend(plane.pixels().iter().map(|p| p[c])));
            }
            InputLayer::Gray(plane) => {
                size = plane.size();
                channels += 1;
                data.extend_from_slice(plane.pixels());
            }
        }
    }
    Tensor::new(&[1, channels, size.1, size.0], data)
}

impl Tensor {
    /// Channels `first`.. of a tensor [1, channels, height, width] as a plane of three.
    pub fn color(&self, first: usize) -> Plane<Vec3> {
        let (width, height) = self.plane_size();
        let (n, at) = (width * height, first * width * height);
        let pixel = |i: usize| Vec3::from_array([0, 1, 2].map(|c| self.data()[at + c * n + i]));
        Plane::new(width, height, (0..n).map(pixel).collect())
    }

    /// Channel `at` of a tensor [1, channels, height, width].
    pub fn gray(&self, at: usize) -> Plane<f32> {
        let (width, height) = self.plane_size();
        let n = width * height;
        Plane::new(width, height, self.data()[at * n..][..n].to_vec())
    }

    fn plane_size(&self) -> (usize, usize) {
        let [.., height, width] = self.shape() else { return (0, 0) };
        (*width, *height)
    }

    /// The numbers as colors, three each.
    pub fn vectors(&self) -> Vec<Vec3> {
        self.data().chunks_exact(3).map(Vec3::from_slice).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_come_back() {
        let color = Plane::from_fn(3, 2, |x, y| Vec3::new(x as f32, y as f32, (x * y) as f32));
        let gray = Plane::from_fn(3, 2, |x, y| (10 * x + y) as f32);
        let tensor = planes_of(&[InputLayer::Gray(&gray), InputLayer::Color(&color)]);
        assert_eq!(tensor.shape(), [1, 4, 2, 3]);
        assert_eq!(tensor.gray(0), gray);
        assert_eq!(tensor.color(1), color);
        assert_eq!(tensor.gray(2), color.map(|c| c.y));
    }
}
