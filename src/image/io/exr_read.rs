//! OpenEXR files in.

use std::io::Cursor;

use ::exr::block::UncompressedBlock;
use ::exr::block::lines::LineRef;
use ::exr::block::reader::ChunksReader;
use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{ChannelDescription, Chromaticities, SampleType};
use ::exr::meta::header::Header;
use ::exr::prelude::FlatSamples;
use glam::Vec3;
use half::vec::HalfBitsVecExt;
use rayon::prelude::*;

use super::source::{NamedBytes, ReadError, not_one_of};
use crate::image::{Layer, Plane};

/// Rec.709 primaries and D65, (x, y) of red, green, blue, white.
pub(in crate::image) const REC709: [(f32, f32); 4] =
    [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290)];

/// One channel of one part.
struct PartChannel {
    /// Index of the part, and of the channel in it.
    place: (usize, usize),
    name: String,
    width: usize,
    height: usize,
    samples: FlatSamples,
}

/// An EXR file as it lies on disk: channels by name.
pub struct ExrFile {
    channels: Vec<PartChannel>,
    pub(in crate::image) warnings: Vec<String>,
    comments: String,
}

/// Reads all channels of a file with layers, as [`crate::image::ExrLayers`] writes them.
///
/// # Errors
/// The file is not OpenEXR, is damaged or too large.
pub fn read_layers(source: NamedBytes) -> Result<ExrFile, ReadError> {
    read_channels(source, |_| true)
}

/// The same of the channels whose names are `wanted`, `light_lamp_0.R`.
///
/// # Errors
/// Those of [`read_layers`].
pub fn read_channels(
    source: NamedBytes,
    wanted: impl Fn(&str) -> bool,
) -> Result<ExrFile, ReadError> {
    match source.bytes.starts_with(b"\x76\x2f\x31\x01") {
        true => read_wanted(source, wanted),
        false => Err(not_one_of(source, "OpenEXR")),
    }
}

/// Reads all full-resolution channels of a file.
///
/// # Errors
/// The content is not a valid EXR file, or exceeds the limits of `source`.
pub(in crate::image) fn read(source: NamedBytes) -> Result<ExrFile, ReadError> {
    read_wanted(source, |_| true)
}

fn read_wanted(source: NamedBytes, wanted: impl Fn(&str) -> bool) -> Result<ExrFile, ReadError> {
    let bad = |e: ::exr::error::Error| source.error("content", "a valid OpenEXR file", e);
    // The crate allocates the size that a data window claims, and a corrupt one claims gigabytes:
    // headers first.
    let meta = MetaData::read_from_buffered(Cursor::new(source.bytes), false).map_err(bad)?;
    let mut total = 0u64;
    let mut chunks = 0u64;
    for header in &meta.headers {
        if header.deep {
            return Err(source.error("content", "flat pixels", "deep data"));
        }
        let pixel: u64 =
            header.channels.list.iter().map(|c| c.sample_type.bytes_per_sample() as u64).sum();
        let (width, height) = (header.layer_size.width() as u64, header.layer_size.height() as u64);
        source.check_size(width, height, pixel)?;
        total = total.saturating_add(width * height * pixel);
        chunks = chunks.saturating_add(header.chunk_count as u64);
    }
    // Every chunk has at least its 8 bytes in the offset table.
    if chunks > source.bytes.len() as u64 / 8 {
        return Err(source.error(
            "content",
            format!("room for {chunks} chunks"),
            format!("{} bytes", source.bytes.len()),
        ));
    }
    if total > source.most {
        return Err(source.error(
            "size in the header",
            format!("at most {} bytes", source.most),
            total,
        ));
    }
    let warnings = warnings(&meta);
    let comments = meta.headers.iter().find_map(|header| header.own_attributes.comments.as_ref());
    let comments = comments.map(ToString::to_string).unwrap_or_default();
    let channels = channels(source.bytes, wanted).map_err(bad)?;
    Ok(ExrFile { channels, warnings, comments })
}

/// Bytes of blocks that are decompressed at a time; one block may have more.
const BYTES_AT_ONCE: usize = 32 << 20;

/// The channels of all parts whose names are `wanted`. The blocks are decompressed by the caller's
/// threads; those of the crate would end the program where a block makes one of them panic.
fn channels(bytes: &[u8], wanted: impl Fn(&str) -> bool) -> ::exr::error::Result<Vec<PartChannel>> {
    let file = ::exr::block::read(Cursor::new(bytes), false)?;
    let headers = file.headers().iter().enumerate();
    let listed = headers.flat_map(|(part, header)| {
        let channels = header.channels.list.iter().enumerate();
        channels.map(move |(index, channel)| ((part, index), channel, header))
    });
    // Subsampled channels (chroma) are of no use here.
    let mut channels: Vec<PartChannel> = listed
        .filter(|(_, channel, _)| channel.sampling == Vec2(1, 1))
        .filter(|(_, channel, _)| wanted(&channel.name.to_string()))
        .map(|(place, channel, header)| PartChannel::black(place, channel, header))
        .collect();
    let parts: Vec<usize> = channels.iter().map(|channel| channel.place.0).collect();
    let mut chunks = file.filter_chunks(false, |_, tile, block| {
        tile.is_largest_resolution_level() && parts.contains(&block.layer)
    })?;
    let meta = chunks.meta_data().clone();
    let largest = meta.headers.iter().map(Header::max_block_byte_size).max().unwrap_or_default();
    let at_once = (BYTES_AT_ONCE / largest.max(1)).max(1);
    loop {
        let some = chunks.by_ref().take(at_once).collect::<Result<Vec<_>, _>>()?;
        if some.is_empty() {
            return Ok(channels);
        }
        let decompress = |chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false);
        let blocks = some.into_par_iter().map(decompress);
        let blocks = blocks.collect::<::exr::error::Result<Vec<UncompressedBlock>>>()?;
        channels.par_iter_mut().try_for_each(|channel| {
            let (part, index) = channel.place;
            let list = &meta.headers[part].channels;
            let of_part = blocks.iter().filter(|block| block.index.layer == part);
            let mut lines =
                of_part.flat_map(|block| block.lines(list).skip(index).step_by(list.list.len()));
            lines.try_for_each(|line| channel.put(line))
        })?;
    }
}

fn warnings(meta: &MetaData) -> Vec<String> {
    let mut warnings = Vec::new();
    let Some(header) = meta.headers.first() else { return warnings };
    if header.shared_attributes.chromaticities.is_some_and(|c| !is_rec709(&c)) {
        warnings.push(
            "its chromaticities are not those of Rec.709: its numbers count as Rec.709".into(),
        );
    }
    if header.data_window() != header.shared_attributes.display_window {
        warnings.push(
            "its data window is not its display window: the data window is the picture".into(),
        );
    }
    warnings
}

fn is_rec709(c: &Chromaticities) -> bool {
    let near = |got: ::exr::math::Vec2<f32>, (x, y): (f32, f32)| {
        (got.0 - x).abs() < 2e-3 && (got.1 - y).abs() < 2e-3
    };
    [c.red, c.green, c.blue, c.white].into_iter().zip(REC709).all(|(got, wanted)| near(got, wanted))
}

impl ExrFile {
    fn find(&self, name: &str) -> Option<&PartChannel> {
        self.channels.iter().find(|c| c.name == name)
    }

    fn missing(&self, source: NamedBytes, wanted: &str) -> ReadError {
        let names: Vec<&str> = self.channels.iter().take(20).map(|c| c.name.as_str()).collect();
        source.error(
            "EXR channels",
            wanted,
            if names.is_empty() { "none".into() } else { names.join(" ") },
        )
    }

    /// R, G, B; or the gray of Y, of Z or of R alone.
    ///
    /// # Errors
    /// The file does not have these channels.
    pub(in crate::image) fn colors(&self, source: NamedBytes) -> Result<Plane<Vec3>, ReadError> {
        if let Some(colors) = self.triple(["R", "G", "B"]) {
            return Ok(colors);
        }
        let gray = ["Y", "Z", "R"].into_iter().find_map(|name| self.find(name));
        let gray = gray.ok_or_else(|| self.missing(source, "R, G and B, or Y, Z or R alone"))?;
        Ok(gray.plane().map(Vec3::splat))
    }

    /// X, Y, Z; or R, G, B.
    ///
    /// # Errors
    /// The file does not have these channels.
    pub(in crate::image) fn vectors(&self, source: NamedBytes) -> Result<Plane<Vec3>, ReadError> {
        let vectors =
            [["X", "Y", "Z"], ["R", "G", "B"]].into_iter().find_map(|names| self.triple(names));
        vectors.ok_or_else(|| self.missing(source, "X, Y and Z, or R, G and B"))
    }

    /// Names of all channels, `light_lamp_0.R`.
    pub fn channels(&self) -> impl Iterator<Item = &str> {
        self.channels.iter().map(|channel| channel.name.as_str())
    }

    /// The colors of a layer, or of the picture itself when `layer` is empty.
    pub fn rgb(&self, layer: &str) -> Option<Plane<Vec3>> {
        let name = |channel: &str| {
            if layer.is_empty() { channel.to_owned() } else { format!("{layer}.{channel}") }
        };
        self.triple(["R", "G", "B"].map(name).each_ref().map(String::as_str))
    }

    /// [`ExrFile::rgb`] of a layer as it is stored; the file has it no more.
    pub fn take_layer(&mut self, layer: &str) -> Option<Layer> {
        let names = ["R", "G", "B"].map(|channel| format!("{layer}.{channel}"));
        let stored = {
            let [a, b, c] = names.each_ref().map(|name| self.find(name));
            let (a, b, c) = (a?, b?, c?);
            let size = (a.width, a.height);
            match (&a.samples, &b.samples, &c.samples) {
                (FlatSamples::F16(r), FlatSamples::F16(g), FlatSamples::F16(b))
                    if r.len() == g.len() && g.len() == b.len() =>
                {
                    let colors = (r, g, b).into_par_iter();
                    let pixels = colors.map(|(r, g, b)| [r, g, b].map(|half| half.to_bits()));
                    let pixels = pixels.collect();
                    Layer::Half(Plane::new(size.0, size.1, pixels))
                }
                _ => Layer::Float(self.rgb(layer)?),
            }
        };
        self.channels.retain(|channel| !names.contains(&channel.name));
        Some(stored)
    }

    /// One channel.
    pub fn number(&self, channel: &str) -> Option<Plane<f32>> {
        self.find(channel).map(PartChannel::plane)
    }

    /// The lines of the `comments` attribute.
    pub fn comments(&self) -> impl Iterator<Item = &str> {
        self.comments.lines()
    }

    /// Three channels of one size.
    fn triple(&self, names: [&str; 3]) -> Option<Plane<Vec3>> {
        let [Some(a), Some(b), Some(c)] = names.map(|name| self.find(name)) else { return None };
        let same = |other: &PartChannel| (other.width, other.height) == (a.width, a.height);
        let (y, z) = (b.samples.values_as_f32(), c.samples.values_as_f32());
        let data = || {
            a.samples.values_as_f32().zip(y).zip(z).map(|((x, y), z)| Vec3::new(x, y, z)).collect()
        };
        (same(b) && same(c)).then(|| Plane::new(a.width, a.height, data()))
    }

    /// Z, else Y, else R.
    ///
    /// # Errors
    /// The file does not have these channels.
    pub(in crate::image) fn depth(&self, source: NamedBytes) -> Result<Plane<f32>, ReadError> {
        let depth = ["Z", "Y", "R"].into_iter().find_map(|name| self.find(name));
        Ok(depth.ok_or_else(|| self.missing(source, "Z, Y or R"))?.plane())
    }
}

impl PartChannel {
    /// The channel before its lines are read.
    fn black(place: (usize, usize), channel: &ChannelDescription, header: &Header) -> PartChannel {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        let count = width * height;
        let samples = match channel.sample_type {
            SampleType::F16 => FlatSamples::F16(vec![0u16; count].reinterpret_into()),
            SampleType::F32 => FlatSamples::F32(vec![0.0; count]),
            SampleType::U32 => FlatSamples::U32(vec![0; count]),
        };
        PartChannel { place, name: channel.name.to_string(), width, height, samples }
    }

    /// Takes one line of a block.
    fn put(&mut self, line: LineRef) -> ::exr::error::UnitResult {
        let Vec2(x, y) = line.location.position;
        let from = y * self.width + x;
        let pixels = from..from + line.location.sample_count;
        let outside = || ::exr::error::Error::Invalid("a block outside of its picture".into());
        match &mut self.samples {
            FlatSamples::F16(all) => {
                line.read_samples_into_slice(all.get_mut(pixels).ok_or_else(outside)?)
            }
            FlatSamples::F32(all) => {
                line.read_samples_into_slice(all.get_mut(pixels).ok_or_else(outside)?)
            }
            FlatSamples::U32(all) => {
                line.read_samples_into_slice(all.get_mut(pixels).ok_or_else(outside)?)
            }
        }
    }

    fn plane(&self) -> Plane<f32> {
        Plane::new(self.width, self.height, self.samples.values_as_f32().collect())
    }
}
