//! Multi-layer OpenEXR files out: one part, channels named `layer.R`, which every viewer groups
//! into layers.

use std::io::Cursor;
use std::ops::Range;
use std::sync::Arc;

use ::exr::math::Vec2;
use ::exr::meta::attribute::{Chromaticities, Text};
use ::exr::prelude::Layer as Part;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, LayerAttributes, WritableImage,
};
use glam::Vec3;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::exr_read::REC709;
use super::fast_zlib;
use crate::image::layer::halves_hold;
use crate::image::{Layer, Plane, Resized, resize};

/// Compression of the pixels of an EXR file; all are lossless.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Compression {
    /// No compression.
    None,
    /// Run-length encoding.
    Rle,
    /// Deflate of single rows.
    Zips,
    /// Deflate of 16 rows at a time.
    Zip,
    /// Wavelet transform with Huffman coding.
    Piz,
}

/// The channels of an EXR file in the making; all have the file's size.
///
/// ```
/// use glam::Vec3;
/// use relight::image::{Compression, ExrLayers, NamedBytes, Plane, read_layers};
///
/// let lamp = Plane::filled(2, 1, Vec3::new(0.5, 0.25, 0.0));
/// let mut layers = ExrLayers::new(2, 1);
/// layers.rgb("light_lamp_0", &lamp);
/// let bytes = layers.write(Compression::Zip)?;
/// let file = read_layers(NamedBytes::new("picture.exr", &bytes)).map_err(|e| e.to_string())?;
/// assert_eq!(file.rgb("light_lamp_0"), Some(lamp));
/// # Ok::<(), String>(())
/// ```
pub struct ExrLayers {
    width: usize,
    height: usize,
    channels: Vec<(String, ChannelSamples)>,
    comments: Vec<String>,
    kept_as_float: Vec<(String, f32)>,
}

/// The samples of one channel.
enum ChannelSamples {
    Floats(Vec<f32>),
    /// One half float everywhere.
    Even(f16),
    /// Red, green or blue of a layer.
    Of(Arc<Layer>, usize),
    /// Half floats of a plane, resized to the file's size.
    Resized(Resized<f32>),
}

const RGB: [&str; 3] = ["R", "G", "B"];
const XYZ: [&str; 3] = ["X", "Y", "Z"];

impl ExrLayers {
    /// A file of `width` x `height` pixels without channels.
    pub fn new(width: usize, height: usize) -> ExrLayers {
        ExrLayers {
            width,
            height,
            channels: Vec::new(),
            comments: Vec::new(),
            kept_as_float: Vec::new(),
        }
    }

    /// A half-float color layer: `layer.R`, `layer.G`, `layer.B`, or plain `R`, `G`, `B` when
    /// `layer` is empty. Like every layer of halves it becomes one of floats when halves cannot
    /// hold it, see [`ExrLayers::kept_as_float`]. A plane of another size is resized as it is
    /// written.
    pub fn rgb(&mut self, layer: &str, plane: &Plane<Vec3>) {
        let size = (self.width, self.height);
        if plane.size() == size {
            return self.halves(layer, RGB, plane);
        }
        if !halves_hold(largest(plane, |v| v.abs().max_element())) {
            return self.halves(layer, RGB, &resize(plane, size.0, size.1));
        }
        for (axis, name) in RGB.into_iter().enumerate() {
            self.resized(&channel_name(layer, name), &plane.map(|color| color[axis]));
        }
    }

    /// [`ExrLayers::rgb`] of a layer that is kept as it is, and let go of as soon as it is written.
    pub fn layer(&mut self, name: &str, layer: Arc<Layer>) {
        if let Layer::Float(plane) = &*layer {
            self.kept_as_float.push((name.into(), largest(plane, |v| v.abs().max_element())));
        }
        self.channels(name, RGB, layer);
    }

    /// The channel `A`, 1 everywhere.
    pub fn opaque(&mut self) {
        self.push("A", (self.width, self.height), ChannelSamples::Even(f16::ONE));
    }

    /// A half-float vector layer: `layer.X`, `layer.Y`, `layer.Z`.
    pub fn xyz(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.halves(layer, XYZ, plane);
    }

    /// [`ExrLayers::rgb`] in single precision.
    pub fn float_rgb(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.floats(layer, RGB, plane);
    }

    /// [`ExrLayers::xyz`] in single precision.
    pub fn float_xyz(&mut self, layer: &str, plane: &Plane<Vec3>) {
        self.floats(layer, XYZ, plane);
    }

    fn halves(&mut self, layer: &str, names: [&str; 3], plane: &Plane<Vec3>) {
        if let Some(halves) = Layer::halves(plane) {
            return self.channels(layer, names, Arc::new(halves));
        }
        let name = if layer.is_empty() { "RGB" } else { layer };
        self.kept_as_float.push((name.into(), largest(plane, |v| v.abs().max_element())));
        self.floats(layer, names, plane);
    }

    fn floats(&mut self, layer: &str, names: [&str; 3], plane: &Plane<Vec3>) {
        self.channels(layer, names, Arc::new(Layer::Float(plane.clone())));
    }

    fn channels(&mut self, layer: &str, names: [&str; 3], colors: Arc<Layer>) {
        for (axis, name) in names.into_iter().enumerate() {
            let samples = ChannelSamples::Of(colors.clone(), axis);
            self.push(&channel_name(layer, name), colors.size(), samples);
        }
    }

    /// One half-float channel of a plane, which is resized to the file's size as it is written.
    pub fn half(&mut self, name: &str, plane: &Plane<f32>) {
        let largest = largest(plane, f32::abs);
        if !halves_hold(largest) {
            self.kept_as_float.push((name.into(), largest));
            return self.float(name, &resize(plane, self.width, self.height));
        }
        self.resized(name, plane);
    }

    fn resized(&mut self, name: &str, plane: &Plane<f32>) {
        let resized = Resized::new(plane, self.width, self.height);
        self.push(name, resized.size(), ChannelSamples::Resized(resized));
    }

    /// The layers that are floats although halves were requested, each with its largest magnitude:
    /// above 65504 a half would be infinite, and a half loses digits below 6.1e-5, and everything
    /// below 6e-8.
    pub fn kept_as_float(&self) -> &[(String, f32)] {
        &self.kept_as_float
    }

    /// One single-precision channel.
    pub fn float(&mut self, name: &str, plane: &Plane<f32>) {
        self.push(name, plane.size(), ChannelSamples::Floats(plane.pixels().to_vec()));
    }

    fn push(&mut self, name: &str, size: (usize, usize), channel: ChannelSamples) {
        assert_eq!(size, (self.width, self.height), "every channel has the size of its file");
        self.channels.push((name.into(), channel));
    }

    /// A line of the file's `comments` attribute. (Attributes of our own would be written in the
    /// order of a hash map, and equal inputs would give other bytes.)
    pub fn comment(&mut self, line: &str) {
        self.comments.push(line.into());
    }

    /// The file. There must be at least one channel, and no two of one name.
    ///
    /// # Errors
    /// There are no channels, two channels have one name, or the encoder fails.
    pub fn write(mut self, compression: Compression) -> Result<Vec<u8>, String> {
        let failed = |e: ::exr::error::Error| format!("the EXR file cannot be written: {e}");
        let channels = std::mem::take(&mut self.channels);
        match compression {
            Compression::None => return self.uncompressed(channels).map_err(failed),
            Compression::Zips | Compression::Zip => {
                return self.deflated(channels, compression).map_err(failed);
            }
            Compression::Rle | Compression::Piz => {}
        }
        let bytes: usize = channels
            .iter()
            .map(|(_, channel)| channel.sample_bytes() * self.width * self.height)
            .sum();
        let image = self.image(
            channels
                .into_iter()
                .map(|(name, channel)| (name, channel.samples(self.width * self.height))),
            compression,
        );
        // Room for everything at once: growing would copy megabytes, again and again.
        let mut file = Cursor::new(Vec::with_capacity(bytes + bytes / 16));
        image.write().to_buffered(&mut file).map_err(failed)?;
        Ok(file.into_inner())
    }

    fn image(
        &self,
        channels: impl Iterator<Item = (String, FlatSamples)>,
        compression: Compression,
    ) -> Image<Part<AnyChannels<FlatSamples>>> {
        let compression = match compression {
            Compression::None => ::exr::prelude::Compression::Uncompressed,
            Compression::Rle => ::exr::prelude::Compression::RLE,
            Compression::Zips => ::exr::prelude::Compression::ZIP1,
            Compression::Zip => ::exr::prelude::Compression::ZIP16,
            Compression::Piz => ::exr::prelude::Compression::PIZ,
        };
        let encoding = Encoding { compression, ..Encoding::UNCOMPRESSED };
        let layer_attributes = LayerAttributes {
            software_name: Some(text(concat!("relight ", env!("CARGO_PKG_VERSION")))),
            comments: (!self.comments.is_empty()).then(|| text(&self.comments.join("\n"))),
            ..LayerAttributes::default()
        };
        let channels = AnyChannels::sort(
            channels.map(|(name, samples)| AnyChannel::new(text(&name), samples)).collect(),
        );
        let mut image = Image::from_layer(Part::new(
            (self.width, self.height),
            layer_attributes,
            encoding,
            channels,
        ));
        let [red, green, blue, white] = REC709.map(|(x, y)| Vec2(x, y));
        image.attributes.chromaticities = Some(Chromaticities { red, green, blue, white });
        image
    }

    /// The header of the file, and its table of offsets, which is empty.
    fn head(
        &self,
        channels: &[(String, ChannelSamples)],
        compression: Compression,
    ) -> ::exr::error::Result<Vec<u8>> {
        let described = channels.iter().map(|(name, channel)| (name.clone(), channel.described()));
        let headers = self.image(described, compression).write().infer_meta_data();
        let mut head = Cursor::new(Vec::new());
        // The blocks are ours.
        match ::exr::block::write(&mut head, headers, true, |_, _| {
            Err(::exr::error::Error::Aborted)
        }) {
            Err(::exr::error::Error::Aborted) => {}
            other => other?,
        }
        Ok(head.into_inner())
    }

    /// A file of deflated blocks, which are made a few at a time.
    fn deflated(
        &self,
        mut channels: Vec<(String, ChannelSamples)>,
        compression: Compression,
    ) -> ::exr::error::Result<Vec<u8>> {
        let lines = if compression == Compression::Zip { ZIP_LINES } else { 1 };
        let mut file = self.head(&channels, compression)?;
        channels.sort_by_cached_key(|(name, _)| text(name));
        let blocks = self.height.div_ceil(lines);
        let table = file.len() - 8 * blocks;
        let deflate = |block: usize| {
            let rows = block * lines..self.height.min((block + 1) * lines);
            deflate_block(&channels, self.width, rows)
        };
        let (mut first, mut deflated) = (0, Vec::new());
        while first < blocks {
            let from = first + deflated.len();
            let append = || append_blocks(&mut file, table, (first, lines), &deflated);
            let next = from..blocks.min(from + BLOCKS_AT_ONCE);
            let ((), next) =
                rayon::join(append, || next.into_par_iter().map(deflate).collect::<Vec<_>>());
            (first, deflated) = (from, next);
        }
        Ok(file)
    }

    /// A file whose blocks are single rows, each the row of one channel after the other: made
    /// channel by channel, so that no channel is in memory beside the part of the file that holds
    /// it.
    fn uncompressed(
        &self,
        mut channels: Vec<(String, ChannelSamples)>,
    ) -> ::exr::error::Result<Vec<u8>> {
        let head = self.head(&channels, Compression::None)?;
        let row: usize =
            channels.iter().map(|(_, channel)| channel.sample_bytes() * self.width).sum();
        let block = ROW_HEAD + row;
        let mut file = vec![0; head.len() + block * self.height];
        let (front, rows) = file.split_at_mut(head.len());
        front.copy_from_slice(&head);
        for (y, offset) in front[head.len() - 8 * self.height..].chunks_exact_mut(8).enumerate() {
            offset.copy_from_slice(&((head.len() + y * block) as u64).to_le_bytes());
        }
        for (y, start) in rows.chunks_exact_mut(block).enumerate() {
            start[..4].copy_from_slice(&(y as i32).to_le_bytes());
            start[4..ROW_HEAD].copy_from_slice(&(row as i32).to_le_bytes());
        }
        channels.sort_by_cached_key(|(name, _)| text(name));
        let mut at = ROW_HEAD;
        for (_, channel) in channels {
            let bytes = channel.sample_bytes() * self.width;
            // The file is zeros: a black layer takes no memory in it.
            if !channel.is_black() {
                let rows = rows.par_chunks_exact_mut(block.max(1)).enumerate();
                rows.for_each(|(y, start)| channel.row(y * self.width, &mut start[at..at + bytes]));
            }
            at += bytes;
        }
        Ok(file)
    }
}

/// A row's number and its length in bytes.
const ROW_HEAD: usize = 8;
/// Rows of a block of `Zip`, by the format.
const ZIP_LINES: usize = 16;
/// Deflated blocks that are in memory beside the file.
const BLOCKS_AT_ONCE: usize = 16;

/// Appends the blocks from number `first` on, of so many `lines` each, and writes their offsets
/// into the table at `table`.
fn append_blocks(
    file: &mut Vec<u8>,
    table: usize,
    (first, lines): (usize, usize),
    deflated: &[Vec<u8>],
) {
    for (number, block) in (first..).zip(deflated) {
        let offset = (file.len() as u64).to_le_bytes();
        file[table + 8 * number..][..8].copy_from_slice(&offset);
        file.extend_from_slice(&((number * lines) as i32).to_le_bytes());
        file.extend_from_slice(&(block.len() as i32).to_le_bytes());
        file.extend_from_slice(block);
    }
}

/// A deflated block of rows: their bytes, those of even places first, each as the difference from
/// the byte before it plus 128; or the bytes as they are where deflating gains nothing.
fn deflate_block(
    channels: &[(String, ChannelSamples)],
    width: usize,
    rows: Range<usize>,
) -> Vec<u8> {
    let row: usize = channels.iter().map(|(_, channel)| channel.sample_bytes() * width).sum();
    let half = row * rows.len() / 2;
    let mut bytes = vec![0; 2 * half];
    let (even, odd) = bytes.split_at_mut(half);
    let mut at = 0;
    let mut before = [128; 2];
    let mut samples = Vec::new();
    for y in rows.clone() {
        for (_, channel) in channels {
            samples.resize(channel.sample_bytes() * width, 0);
            channel.row(y * width, &mut samples);
            let pairs = samples.as_chunks::<2>().0;
            let next = at + pairs.len();
            for (k, part) in [&mut even[at..next], &mut odd[at..next]].into_iter().enumerate() {
                let Some((first, rest)) = part.split_first_mut() else { continue };
                *first = difference(pairs[0][k], before[k]);
                let neighbors = pairs[1..].iter().zip(pairs);
                let differences = neighbors.map(|(own, before)| difference(own[k], before[k]));
                rest.iter_mut().zip(differences).for_each(|(byte, value)| *byte = value);
                before[k] = pairs[pairs.len() - 1][k];
            }
            at = next;
        }
    }
    // The first odd byte follows the last even one; the first byte of all has none before it.
    odd[0] = difference(odd[0], before[0]);
    let deflated = fast_zlib::compress(&bytes);
    if deflated.len() < bytes.len() {
        return deflated;
    }
    let mut plain = vec![0; 2 * half];
    let mut at = 0;
    for y in rows {
        for (_, channel) in channels {
            let length = channel.sample_bytes() * width;
            channel.row(y * width, &mut plain[at..at + length]);
            at += length;
        }
    }
    plain
}

/// A byte as the difference from the byte before it.
fn difference(value: u8, before: u8) -> u8 {
    value.wrapping_sub(before).wrapping_add(128)
}

impl ChannelSamples {
    /// Whether all samples are known to be 0.
    fn is_black(&self) -> bool {
        match self {
            ChannelSamples::Of(layer, _) => layer.is_black(),
            ChannelSamples::Resized(plane) => plane.is_zero(),
            ChannelSamples::Floats(_) | ChannelSamples::Even(_) => false,
        }
    }

    fn sample_bytes(&self) -> usize {
        match self {
            ChannelSamples::Even(_) | ChannelSamples::Resized(_) => 2,
            ChannelSamples::Floats(_) => 4,
            ChannelSamples::Of(layer, _) => match **layer {
                Layer::Half(_) => 2,
                Layer::Float(_) => 4,
            },
        }
    }

    /// No samples, of the same type.
    fn described(&self) -> FlatSamples {
        if self.sample_bytes() == 2 { FlatSamples::F16(vec![]) } else { FlatSamples::F32(vec![]) }
    }

    /// All samples of a picture of so many pixels.
    fn samples(self, pixels: usize) -> FlatSamples {
        match self {
            ChannelSamples::Floats(samples) => FlatSamples::F32(samples),
            ChannelSamples::Even(half) => FlatSamples::F16(vec![half; pixels]),
            ChannelSamples::Resized(plane) => {
                FlatSamples::F16((0..plane.size().1).flat_map(|y| halves(&plane.row(y))).collect())
            }
            ChannelSamples::Of(layer, axis) => match &*layer {
                Layer::Half(plane) => FlatSamples::F16(
                    plane.pixels().iter().map(|pixel| f16::from_bits(pixel[axis])).collect(),
                ),
                Layer::Float(plane) => {
                    FlatSamples::F32(plane.pixels().iter().map(|pixel| pixel[axis]).collect())
                }
            },
        }
    }

    /// Writes the samples from pixel `from` on, little endian.
    fn row(&self, from: usize, bytes: &mut [u8]) {
        fn put<T, const N: usize>(bytes: &mut [u8], samples: &[T], stored: impl Fn(&T) -> [u8; N]) {
            let stored = samples.iter().map(stored);
            bytes.as_chunks_mut().0.iter_mut().zip(stored).for_each(|(bytes, new)| *bytes = new);
        }
        match self {
            ChannelSamples::Even(half) => bytes.as_chunks_mut().0.fill(half.to_le_bytes()),
            ChannelSamples::Resized(plane) => {
                let row = plane.row(from / plane.size().0);
                put(bytes, &halves(&row), |v| v.to_le_bytes())
            }
            ChannelSamples::Floats(samples) => put(bytes, &samples[from..], |v| v.to_le_bytes()),
            ChannelSamples::Of(layer, axis) => match &**layer {
                Layer::Half(plane) => {
                    put(bytes, &plane.pixels()[from..], |pixel| pixel[*axis].to_le_bytes())
                }
                Layer::Float(plane) => {
                    put(bytes, &plane.pixels()[from..], |pixel| pixel[*axis].to_le_bytes())
                }
            },
        }
    }
}

fn largest<T: Copy>(plane: &Plane<T>, magnitude: impl Fn(T) -> f32) -> f32 {
    plane.pixels().iter().map(|&v| magnitude(v)).fold(0.0, f32::max)
}

fn channel_name(layer: &str, name: &str) -> String {
    if layer.is_empty() { name.into() } else { format!("{layer}.{name}") }
}

fn halves(numbers: &[f32]) -> Vec<f16> {
    let mut halves = vec![f16::ZERO; numbers.len()];
    halves.convert_from_f32_slice(numbers);
    halves
}

/// Characters outside Latin-1 cannot stand in an EXR text and become `?`.
fn text(text: &str) -> Text {
    let clean: String = text.chars().map(|c| if (c as u32) < 256 { c } else { '?' }).collect();
    Text::new_or_none(clean).expect("every character is Latin-1")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{NamedBytes, read_channels, read_layers};

    fn plane() -> Plane<Vec3> {
        Plane::from_fn(37, 23, |x, y| Vec3::new(x as f32 / 3.0, -(y as f32), 0.1))
    }

    fn layers() -> ExrLayers {
        let plane = plane();
        let mut layers = ExrLayers::new(37, 23);
        layers.rgb("", &plane);
        layers.opaque();
        layers.layer("light_b", Arc::new(Layer::new(plane.clone())));
        layers.layer("light_a", Arc::new(Layer::new(plane.map(|v| 1e6 * v))));
        layers.xyz("normal", &plane);
        layers.float("depth.Z", &plane.map(|v| v.x));
        layers.rgb("albedo", &small());
        layers.comment("a line");
        layers
    }

    fn small() -> Plane<Vec3> {
        Plane::from_fn(9, 6, |x, y| Vec3::new(x as f32 / 7.0, 0.1, 1.0 + y as f32))
    }

    #[test]
    fn every_compression_keeps_every_bit() {
        let plain = layers().write(Compression::None).expect("the channels are sound");
        let read = |bytes: &[u8]| {
            let file = read_layers(NamedBytes::new("a.exr", bytes)).expect("it is sound");
            let names = ["", "light_b", "light_a"].map(|name| file.rgb(name).expect("it is there"));
            (names, file.number("depth.Z").expect("it is there"), file.number("A"))
        };
        for compression in [Compression::Rle, Compression::Zips, Compression::Zip, Compression::Piz]
        {
            let file = layers().write(compression).expect("the channels are sound");
            assert!(read(&file) == read(&plain), "{compression:?}");
        }
        // Noise gains nothing, and is stored as it is.
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) & 0x7f7f_ffff;
        let numbers =
            Plane::from_fn(64, 40, |x, y| f32::from_bits(noise(64 * y + x) | 0x3000_0000));
        for compression in [Compression::Zips, Compression::Zip] {
            let mut layers = ExrLayers::new(64, 40);
            layers.float("depth.Z", &numbers);
            let file = layers.write(compression).expect("the channel is sound");
            let file = read_layers(NamedBytes::new("a.exr", &file)).expect("it is sound");
            assert_eq!(file.number("depth.Z"), Some(numbers.clone()), "{compression:?}");
        }
    }

    #[test]
    fn only_the_channels_that_are_wanted_are_read() {
        let file = layers().write(Compression::Zip).expect("the channels are sound");
        let source = NamedBytes::new("a.exr", &file);
        let mut some =
            read_channels(source, |name| name.starts_with("light_")).expect("it is sound");
        let names = ["a", "b"].map(|light| ["B", "G", "R"].map(|c| format!("light_{light}.{c}")));
        assert!(some.channels().eq(names.as_flattened()));
        assert_eq!(some.comments().collect::<Vec<_>>(), ["a line"]);
        let mut all = read_layers(source).expect("it is sound");
        for layer in ["light_a", "light_b"] {
            let taken = some.take_layer(layer);
            assert!(taken.is_some() && taken == all.take_layer(layer), "{layer}");
        }
    }

    #[test]
    fn planes_are_resized_as_they_are_written() {
        // Halves hold neither the large nor the tiny ones.
        for scale in [1.0, 1e5, 1e-6, 0.0] {
            let small = small().map(|color| scale * color * Vec3::new(1.0, 1.0, 1e-7));
            let file = |plane: &Plane<Vec3>| {
                let mut layers = ExrLayers::new(37, 23);
                layers.rgb("albedo", plane);
                layers.half("rough.Y", &plane.map(|color| color.x));
                (layers.kept_as_float().len(), layers.write(Compression::Zip))
            };
            let (lazy, eager) = (file(&small), file(&resize(&small, 37, 23)));
            assert!(lazy == eager && lazy.1.is_ok(), "{scale}");
        }
    }

    /// The rows that are written here are the bytes that the crate writes.
    #[test]
    fn rows_are_those_of_the_crate() {
        let mut of_crate = layers();
        let channels = std::mem::take(&mut of_crate.channels).into_iter();
        let samples = channels.map(|(name, channel)| (name, channel.samples(37 * 23)));
        let mut file = Cursor::new(Vec::new());
        of_crate
            .image(samples, Compression::None)
            .write()
            .to_buffered(&mut file)
            .expect("the channels are sound");
        let ours = layers();
        assert_eq!(
            ours.kept_as_float().iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
            ["light_a"]
        );
        assert!(
            ours.write(Compression::None).expect("the channels are sound") == file.into_inner()
        );
    }
}
