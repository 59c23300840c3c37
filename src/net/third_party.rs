//! Third-party networks: the form in which they take a photo, and the choice among their outputs.
//!
//! A photo input is [1, 3, height, width], red first. Where the file leaves the size open, the
//! photo is brought to a shorter side of `side` pixels and each side rounded to a multiple of the
//! network's patches. What is published:
//!
//! | networks | side, multiple | normalization | source |
//! | --- | --- | --- | --- |
//! | Depth Anything V1 and V2 | 518, 14 | ImageNet | `image2tensor` in DepthAnything/Depth-Anything-V2, depth_anything_v2/dpt.py |
//! | DPT (MiDaS 3) | 384, 32 | Half | `dpt_transform` in isl-org/MiDaS, hubconf.py |
//! | MiDaS 2.1; its small one | 384, 32; 256, 32 | ImageNet | `default_transform`, `small_transform`, the same file |
//!
//! They resize by cubic interpolation; here pixels are averaged where the photo shrinks.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{InputLayer, NetError, Network, Port, Tensor, planes_of, shown};
use crate::image::{Picture, Plane, Transfer, resize};

/// Normalization of the encoded colors 0..=1 for a network: (color - mean) / deviation, per
/// channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Normalization {
    /// Mean (0.485, 0.456, 0.406), deviation (0.229, 0.224, 0.225): those of the pictures of
    /// ImageNet.
    #[default]
    ImageNet,
    /// Mean and deviation 0.5: colors become -1..=1.
    Half,
    /// Colors stay 0..=1.
    None,
    /// Any other.
    Custom {
        /// Mean of each channel.
        mean: [f32; 3],
        /// Deviation of each channel; not 0.
        deviation: [f32; 3],
    },
}

impl Normalization {
    /// Checks that colors can be divided by the deviation.
    ///
    /// # Errors
    /// The deviation, if a channel of it is not positive.
    pub fn check(self) -> Result<(), String> {
        let [_, deviation] = self.mean_and_deviation();
        if deviation.cmple(Vec3::ZERO).any() {
            return Err(format!("normalization: wanted a positive deviation, got {deviation}"));
        }
        Ok(())
    }

    fn mean_and_deviation(self) -> [Vec3; 2] {
        match self {
            Normalization::ImageNet => {
                [Vec3::new(0.485, 0.456, 0.406), Vec3::new(0.229, 0.224, 0.225)]
            }
            Normalization::Half => [Vec3::splat(0.5); 2],
            Normalization::None => [Vec3::ZERO, Vec3::ONE],
            Normalization::Custom { mean, deviation } => [mean.into(), deviation.into()],
        }
    }
}

/// The largest picture that a network is shown.
const MAX_PIXELS: usize = 16 << 20;

/// The form in which a network takes a photo.
pub struct PhotoInput<'a> {
    /// The input's name; `None` for the only one.
    pub name: Option<&'a str>,
    /// The photo's shorter side, pixels, where the file leaves it open.
    pub side: u32,
    /// The number that each side is a multiple of, where the file leaves it open.
    pub multiple: u32,
    /// The transfer function of the pictures that it was trained on.
    pub transfer: Transfer,
    /// The normalization of its input.
    pub normalization: Normalization,
}

impl PhotoInput<'_> {
    /// The name of the network's photo input, and the photo as it takes it.
    ///
    /// # Errors
    /// `Mismatch`: the input is missing, does not take a photo, or is not the only one.
    pub fn tensor<'n>(
        &self,
        network: &'n Network,
        photo: &Picture,
    ) -> Result<(&'n str, Tensor), NetError> {
        let port = self.port(network)?;
        let (width, height) = self.size(port, photo.0.size())?;
        Ok((&port.name, self.normalized(&resize(&self.encoded(photo), width, height))))
    }

    /// [`PhotoInput::tensor`] for networks that need the aspect ratio of the photo: it lies in the
    /// middle of the frame, amid the mean color of ImageNet; and its place.
    ///
    /// # Errors
    /// Those of [`PhotoInput::tensor`].
    pub fn padded<'n>(
        &self,
        network: &'n Network,
        photo: &Picture,
    ) -> Result<(&'n str, Tensor, PadRect), NetError> {
        let port = self.port(network)?;
        let (width, height) = self.size(port, photo.0.size())?;
        let rect = PadRect::new([width, height], photo.0.size());
        let ([left, top], [columns, rows]) = (rect.corner, rect.size);
        let seen = resize(&self.encoded(photo), columns, rows);
        let [mean, _] = Normalization::ImageNet.mean_and_deviation();
        let framed =
            Plane::from_fn(width, height, |x, y| match (x.checked_sub(left), y.checked_sub(top)) {
                (Some(x), Some(y)) if x < columns && y < rows => seen.get(x, y),
                _ => mean,
            });
        Ok((&port.name, self.normalized(&framed), rect))
    }

    /// The photo as it is stored, 0..=1.
    fn encoded(&self, photo: &Picture) -> Plane<Vec3> {
        photo.0.map(|color| {
            Vec3::from_array(color.to_array().map(|c| self.transfer.encode(c)))
                .clamp(Vec3::ZERO, Vec3::ONE)
        })
    }

    fn normalized(&self, seen: &Plane<Vec3>) -> Tensor {
        let [mean, deviation] = self.normalization.mean_and_deviation();
        planes_of(&[InputLayer::Color(&seen.map(|color| (color - mean) / deviation))])
    }

    fn port<'n>(&self, network: &'n Network) -> Result<&'n Port, NetError> {
        let inputs = network.inputs();
        if let Some(name) = self.name
            && inputs.iter().all(|port| port.name != name)
        {
            return Err(NetError::Mismatch(format!(
                "wanted an input `{name}`, named by the parameter `input`, got {}",
                names(inputs)
            )));
        }
        match inputs {
            [port] => Ok(port),
            _ => Err(NetError::Mismatch(format!(
                "wanted a network with one input, the photo, got {} of them: {}; export it without the others",
                inputs.len(),
                names(inputs)
            ))),
        }
    }

    /// Columns and rows that the input takes of a photo of this size.
    fn size(&self, port: &Port, photo: (usize, usize)) -> Result<(usize, usize), NetError> {
        let open = [None; 4];
        let shape = port.shape.as_deref().unwrap_or(&open);
        let ([None | Some(1), None | Some(3), height, width], false) =
            (shape, shape.contains(&Some(0)))
        else {
            return Err(NetError::Mismatch(format!(
                "input `{}`: wanted [1, 3, height, width], a photo with red first, got {}",
                port.name,
                shown(port)
            )));
        };
        let scale = self.side as f32 / photo.0.min(photo.1) as f32;
        let multiple = self.multiple as f32;
        let side = |n: usize| ((n as f32 * scale / multiple).round().max(1.0) * multiple) as usize;
        let (width, height) = (width.unwrap_or(side(photo.0)), height.unwrap_or(side(photo.1)));
        if width.saturating_mul(height) > MAX_PIXELS {
            return Err(NetError::Mismatch(format!(
                "input `{}`: wanted at most {} megapixels, got {width} x {height}; where the file leaves its size open, `side` makes it smaller",
                port.name,
                MAX_PIXELS >> 20
            )));
        }
        Ok((width, height))
    }
}

/// The place of a photo in the middle of a larger frame, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PadRect {
    /// Columns and rows of the frame.
    pub frame: [usize; 2],
    /// Left and upper end of the photo.
    pub corner: [usize; 2],
    /// Columns and rows of the photo.
    pub size: [usize; 2],
}

impl PadRect {
    /// The largest place for a photo of this size, which keeps its aspect ratio.
    pub fn new(frame: [usize; 2], photo: (usize, usize)) -> PadRect {
        let scale = (frame[0] as f32 / photo.0 as f32).min(frame[1] as f32 / photo.1 as f32);
        let fitted = |n: usize, most: usize| ((n as f32 * scale).round() as usize).clamp(1, most);
        let size = [fitted(photo.0, frame[0]), fitted(photo.1, frame[1])];
        PadRect { frame, size, corner: [(frame[0] - size[0]) / 2, (frame[1] - size[1]) / 2] }
    }

    /// Index in the frame, column and row of each pixel of the photo.
    pub fn cells(self) -> impl Iterator<Item = (usize, usize, usize)> {
        let ([left, top], [columns, rows]) = (self.corner, self.size);
        (0..columns * rows).map(move |i| {
            let (x, y) = (i % columns, i / columns);
            ((top + y) * self.frame[0] + left + x, x, y)
        })
    }
}

/// The output of this name, or the only one.
///
/// # Errors
/// `Mismatch`, which lists the existing outputs.
pub fn output<'a>(network: &'a Network, name: Option<&'a str>) -> Result<&'a str, NetError> {
    let outputs = network.outputs();
    match (name, outputs) {
        (Some(name), _) if outputs.iter().any(|port| port.name == name) => Ok(name),
        (Some(name), _) => {
            Err(NetError::Mismatch(format!("wanted an output `{name}`, got {}", names(outputs))))
        }
        (None, [port]) => Ok(&port.name),
        (None, _) => Err(NetError::Mismatch(format!(
            "wanted one output, got {} of them: {}; name one with the parameter `output`",
            outputs.len(),
            names(outputs)
        ))),
    }
}

/// Checks that the output `name` is a picture with at least so many channels: [.., channels,
/// height, width], of one channel [.., height, width] too, all dimensions before these 1.
///
/// # Errors
/// `Mismatch`.
pub fn check_channels(name: &str, tensor: &Tensor, wanted: usize) -> Result<(), NetError> {
    let shape = tensor.shape();
    let (channels, rest) = match shape {
        [.., channels, height, width] => (*channels, height * width),
        [height, width] => (1, height * width),
        _ => (0, 0),
    };
    if channels >= wanted && rest > 0 && tensor.data().len() == channels * rest {
        return Ok(());
    }
    let wanted = if wanted == 1 {
        "[height, width] or [1, 1, height, width]".into()
    } else {
        format!("[1, {wanted} or more, height, width]")
    };
    Err(NetError::Mismatch(format!("output `{name}`: wanted {wanted}, got {shape:?}")))
}

/// Channels of one quantity, mapped from the network's range to 0..=1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channels {
    /// The output's name.
    pub output: String,
    /// Its first channel that belongs here, from 0.
    #[serde(default)]
    pub first: usize,
    /// The numbers that mean 0 and 1.
    #[serde(default = "unit")]
    pub range: (f32, f32),
}

fn unit() -> (f32, f32) {
    (0.0, 1.0)
}

impl Channels {
    /// Whether the range is one.
    ///
    /// # Errors
    /// The message states the wanted and the actual shape.
    pub fn check(&self) -> Result<(), String> {
        let (low, high) = self.range;
        if low < high {
            Ok(())
        } else {
            Err(format!("range: wanted the lower number first, got ({low}, {high})"))
        }
    }

    /// A number of the network as a share of its range.
    pub fn share(&self, value: f32) -> f32 {
        let (low, high) = self.range;
        (value - low) / (high - low)
    }

    /// Three channels of the output.
    ///
    /// # Errors
    /// `Mismatch`: there are not so many.
    pub fn colors(&self, tensor: &Tensor) -> Result<Plane<Vec3>, NetError> {
        check_channels(&self.output, tensor, self.first + 3)?;
        Ok(tensor.color(self.first).map(|v| Vec3::from_array(v.to_array().map(|v| self.share(v)))))
    }

    /// One channel of the output.
    ///
    /// # Errors
    /// `Mismatch`: there are not so many.
    pub fn numbers(&self, tensor: &Tensor) -> Result<Plane<f32>, NetError> {
        check_channels(&self.output, tensor, self.first + 1)?;
        Ok(tensor.gray(self.first).map(|v| self.share(v)))
    }
}

fn names(ports: &[Port]) -> String {
    ports.iter().map(|port| format!("`{}`", port.name)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(side: u32, multiple: u32) -> PhotoInput<'static> {
        PhotoInput {
            name: None,
            side,
            multiple,
            transfer: Transfer::Srgb,
            normalization: Normalization::ImageNet,
        }
    }

    fn port(shape: Option<&[Option<usize>]>) -> Port {
        Port { name: "x".into(), shape: shape.map(<[_]>::to_vec) }
    }

    #[test]
    fn an_open_size_is_that_of_the_published_code() {
        // 640 x 480: Depth Anything takes 686 x 518 (686 = 49 patches, 690.7 before rounding), DPT
        // 512 x 384.
        let open = port(Some(&[None, Some(3), None, None]));
        assert_eq!(input(518, 14).size(&open, (640, 480)), Ok((686, 518)));
        assert_eq!(input(384, 32).size(&port(None), (640, 480)), Ok((512, 384)));
        assert_eq!(input(384, 32).size(&open, (480, 640)), Ok((384, 512)));
        assert_eq!(input(8, 32).size(&open, (10, 10_000)), Ok((32, 8000)));
        let message = input(518, 14).size(&open, (10, 10_000)).expect_err("it is huge").to_string();
        assert!(message.contains("wanted at most 16 megapixels, got 518 x 518000"), "{message}");
    }

    #[test]
    fn a_fixed_size_stays() {
        let fixed = port(Some(&[Some(1), Some(3), Some(256), Some(320)]));
        assert_eq!(input(518, 14).size(&fixed, (640, 480)), Ok((320, 256)));
        for shape in [
            &[Some(1), Some(1), None, None][..],
            &[Some(1), None, None],
            &[Some(2), Some(3), None, None],
            &[Some(1), Some(3), Some(0), None],
        ] {
            let message = input(518, 14)
                .size(&port(Some(shape)), (640, 480))
                .expect_err("it takes no photo")
                .to_string();
            assert!(
                message.starts_with(
                    "input `x`: wanted [1, 3, height, width], a photo with red first, got ["
                ),
                "{message}"
            );
        }
    }

    #[test]
    fn channels_are_found_in_any_layout() {
        let numbers = |n: usize| (0..n).map(|i| i as f32).collect::<Vec<_>>();
        for shape in [&[2, 3][..], &[1, 2, 3], &[1, 1, 2, 3], &[1, 1, 1, 2, 3]] {
            assert_eq!(
                check_channels("y", &Tensor::new(shape, numbers(6)), 1),
                Ok(()),
                "{shape:?}"
            );
        }
        for (shape, wanted) in [(&[6][..], 1), (&[2, 2, 3], 3), (&[2, 3, 2, 3], 3), (&[1, 0, 3], 1)]
        {
            let tensor = Tensor::new(shape, numbers(shape.iter().product()));
            assert!(check_channels("y", &tensor, wanted).is_err(), "{shape:?}");
        }
        let seven = Tensor::new(&[1, 7, 1, 2], numbers(14));
        let of = |first| Channels { output: "y".into(), first, range: (0.0, 2.0) };
        assert_eq!(of(6).numbers(&seven).expect("it is there").pixels(), [6.0, 6.5]);
        assert_eq!(
            of(1).colors(&seven).expect("they are there").pixels(),
            [Vec3::new(1.0, 2.0, 3.0), Vec3::new(1.5, 2.5, 3.5)]
        );
        assert_eq!(
            of(5).colors(&seven),
            Err(NetError::Mismatch(
                "output `y`: wanted [1, 8 or more, height, width], got [1, 7, 1, 2]".into()
            ))
        );
    }
}
