//! Multi-layer OpenEXR files out: one part, channels named `layer.R`, which every viewer groups into layers.

use std::io::Cursor;

use ::exr::math::Vec2;
use ::exr::meta::attribute::{Chromaticities, Text};
use ::exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use glam::Vec3;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Plane;
use super::exr_read::REC709;

/// How the pixels of an EXR file are packed. None of them loses anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Compression {
    None,
    Rle,
    Zip,
    Piz,
}

/// The channels of an EXR file in the making; all have the file's size.
pub struct ExrLayers {
    width: usize,
    height: usize,
    channels: Vec<AnyChannel<FlatSamples>>,
    comments: Vec<String>,
    kept_as_float: Vec<(String, f32)>,
}

const RGB: [&str; 3] = ["R", "G", "B"];
const XYZ: [&str; 3] = ["X", "Y", "Z"];

impl ExrLayers {
    pub fn new(width: usize, height: usize) -> ExrLayers {
        ExrLayers { width, height, channels: Vec::new(), comments: Vec::new(), kept_as_float: Vec::new() }
    }

    /// A half-float colour layer: `layer.R`, `layer.G`, `layer.B`, or plain `R`, `G`, `B` when `layer` is empty. Like every layer
    /// of halves it becomes one of floats when halves cannot hold it, see [`ExrLayers::kept_as_float`].
    pub fn rgb(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.halves(layer, RGB, plane);
    }

    /// A half-float vector layer: `layer.X`, `layer.Y`, `layer.Z`.
    pub fn xyz(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.halves(layer, XYZ, plane);
    }

    /// [`ExrLayers::rgb`] in single precision.
    pub fn float_rgb(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.triple(layer, RGB, plane, true);
    }

    /// [`ExrLayers::xyz`] in single precision.
    pub fn float_xyz(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.triple(layer, XYZ, plane, true);
    }

    fn halves(&mut self, layer: &str, names: [&str; 3], plane: &Plane<Vec3>) {
        let told = if layer.is_empty() { "RGB" } else { layer };
        let float = self.needs_float(told, largest(plane, |v| v.abs().max_element()));
        self.triple(layer, names, plane, float);
    }

    fn triple(&mut self, layer: &str, names: [&str; 3], plane: &Plane<Vec3>, float: bool) {
        let samples = |axis: usize| samples(&plane.map(|v| v.to_array()[axis]), float);
        let channels: Vec<_> = (0..3).into_par_iter().map(samples).collect();
        for (name, samples) in names.into_iter().zip(channels) {
            let name = if layer.is_empty() { name.into() } else { format!("{layer}.{name}") };
            self.push(&name, plane.size(), samples);
        }
    }

    /// One half-float channel.
    pub fn half(&mut self, name: &str, plane: &Plane<f32>) {
        let float = self.needs_float(name, largest(plane, f32::abs));
        self.push(name, plane.size(), samples(plane, float));
    }

    fn needs_float(&mut self, layer: &str, largest: f32) -> bool {
        let float = largest > f16::MAX.to_f32() || (largest > 0.0 && largest < f16::MIN_POSITIVE.to_f32());
        if float {
            self.kept_as_float.push((layer.into(), largest));
        }
        float
    }

    /// The layers that are floats although halves were asked for, each with its largest magnitude: above 65504 a half would be
    /// infinite, and where all is below 6.1e-5 it would lose digits, and below 6e-8 everything.
    pub fn kept_as_float(&self) -> &[(String, f32)] {
        &self.kept_as_float
    }

    /// One single-precision channel.
    pub fn float(&mut self, name: &str, plane: &Plane<f32>) {
        self.push(name, plane.size(), FlatSamples::F32(plane.pixels().to_vec()));
    }

    fn push(&mut self, name: &str, size: (usize, usize), samples: FlatSamples) {
        assert_eq!(size, (self.width, self.height), "every channel has the size of its file");
        self.channels.push(AnyChannel::new(text(name), samples));
    }

    /// A line of the file's `comments` attribute. (Attributes of our own would be written in the order of a hash map, and
    /// equal inputs would give other bytes.)
    pub fn comment(&mut self, line: &str) {
        self.comments.push(line.into());
    }

    /// The file. There must be at least one channel, and no two of one name.
    pub fn write(self, compression: Compression) -> Result<Vec<u8>, String> {
        let compression = match compression {
            Compression::None => ::exr::prelude::Compression::Uncompressed,
            Compression::Rle => ::exr::prelude::Compression::RLE,
            Compression::Zip => ::exr::prelude::Compression::ZIP16,
            Compression::Piz => ::exr::prelude::Compression::PIZ,
        };
        let encoding = Encoding { compression, ..Encoding::UNCOMPRESSED };
        let layer_attributes = LayerAttributes {
            software_name: Some(text(concat!("relight ", env!("CARGO_PKG_VERSION")))),
            comments: (!self.comments.is_empty()).then(|| text(&self.comments.join("\n"))),
            ..LayerAttributes::default()
        };
        let bytes: usize = self.channels.iter().map(|c| sample_bytes(&c.sample_data)).sum();
        let channels = AnyChannels::sort(self.channels.into_iter().collect());
        let mut image = Image::from_layer(Layer::new((self.width, self.height), layer_attributes, encoding, channels));
        let [red, green, blue, white] = REC709.map(|(x, y)| Vec2(x, y));
        image.attributes.chromaticities = Some(Chromaticities { red, green, blue, white });
        // Room for everything at once: growing would copy megabytes, again and again.
        let mut file = Cursor::new(Vec::with_capacity(bytes + bytes / 16));
        image.write().to_buffered(&mut file).map_err(|e| format!("the EXR file cannot be written: {e}"))?;
        Ok(file.into_inner())
    }
}

fn sample_bytes(samples: &FlatSamples) -> usize {
    match samples {
        FlatSamples::F16(samples) => 2 * samples.len(),
        FlatSamples::F32(samples) => 4 * samples.len(),
        FlatSamples::U32(samples) => 4 * samples.len(),
    }
}

fn largest<T: Copy>(plane: &Plane<T>, magnitude: impl Fn(T) -> f32) -> f32 {
    plane.pixels().iter().map(|&v| magnitude(v)).fold(0.0, f32::max)
}

fn samples(plane: &Plane<f32>, float: bool) -> FlatSamples {
    if float {
        return FlatSamples::F32(plane.pixels().to_vec());
    }
    let mut samples = vec![f16::ZERO; plane.len()];
    samples.convert_from_f32_slice(plane.pixels());
    FlatSamples::F16(samples)
}

/// Characters outside Latin-1 cannot stand in an EXR text and become `?`.
fn text(text: &str) -> Text {
    let clean: String = text.chars().map(|c| if (c as u32) < 256 { c } else { '?' }).collect();
    Text::new_or_none(clean).expect("every character is Latin-1")
}
