//! Write: the relit picture as `picture.png`, and everything that it is made of as layers of
//! `picture.exr`.
//!
//! Layers of light i with lobes k, radiance w_k, unit direct shading D_k, lit share V_k, unit
//! indirect shading I_k: `direct_i` = sum_k w_k D_k V_k; `indirect_i` = sum_k w_k I_k; `shadow_i` =
//! sum_k Y(w_k) V_k / sum_k Y(w_k), Y the luminance, and the plain mean of V_k when the light is
//! off; `unknown_i` is the same mean of the shares whose visibility the photo does not determine.
//! `stderr_i` is the standard error of the luminance of `direct_i` + `indirect_i`: sqrt(sum_k
//! Y(w_k)^2 ((s(D_k) V_k)^2 + (D_k s(V_k))^2) + (sum_k Y(w_k) s(I_k))^2), s being the standard
//! errors of the layers. Lobes have random numbers of their own, and the lit share, being a ratio,
//! errs by itself; but all lobes share the rays of the indirect light, so that its errors go
//! together. `room_error_i` is the standard error of the luminance of `indirect_i` by guesses about
//! the unseen room; it is not part of `stderr_i`, and is left out where nothing is guessed.

mod page_planes;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Camera, RoomLayout};
use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{
    Albedo, Compression, Depth, ExrLayers, LUMINANCE, Layer, LightMask, Mask, Normal, Picture,
    Plane, PngSamples, Roughness, Specular, first_not_finite, resize, resize_depth,
};
use crate::nodes::artifacts::{
    Encoding, Files, LayerError, REST, UnitDirect, UnitIndirect, Visibility,
};
use crate::optics::Radiance;
use crate::{params, ports};

use super::{SavedRoom, saved_room};
pub use page_planes::{PagePlane, PagePlanes};

/// Diagnostic layers are left out of files that would hold more bytes than this before compression:
/// they are at the working size by nature, and at the size of a large photo they only cost space.
const MAX_EXR_BYTES: usize = 512 << 20;
/// Up to this size both files are made at once; of a larger photo one after the other, as both have
/// buffers as large as their files.
const MAX_PIXELS_AT_ONCE: usize = 16 << 20;

/// The files that [`Write`] makes, in their order.
pub const PICTURES: [&str; 2] = ["picture.png", "picture.exr"];

params! {
    /// Writes the picture as PNG, and all layers as EXR.
    pub struct Write {
        /// Compression of picture.exr: None, Rle, Zips, Zip or Piz. All are lossless.
        compression: Compression = Compression::Zip,
        /// Diagnostic layers are part of picture.exr, beside the picture and its light layers.
        diagnostics: bool = true,
    }
}

ports! {
    pub input WriteIn {
        /// The linear picture at the photo's size, not clamped.
        picture: Arc<Picture>,
        /// Encoding of the photo.
        encoding: Arc<Encoding>,
        /// The photo, for the layer `photo`, with which the picture is compared.
        photo: Option<Arc<Picture>>,
        /// The cuboid of the room, for a line of the comments of `picture.exr`.
        layout: Option<Arc<RoomLayout>>,
        /// The camera at the photo's size, for the same line.
        camera: Option<Arc<Camera>>,
        /// Fraction of each pixel whose surface a light or saturation hides, working size, for the
        /// layer `filled` and a note of the share of the edit's change that lies there.
        filled: Option<Arc<Mask>>,
        /// The layer of each light, the photo's size; they and `residual` sum to the picture.
        layer: Gather<Layer>,
        /// The residual, which no light explains.
        residual: Arc<Layer>,
        /// Unit direct shading of each light.
        direct: Gather<UnitDirect>,
        /// Visibility of each light.
        visibility: Gather<Visibility>,
        /// Unit indirect shading of each light.
        indirect: Gather<UnitIndirect>,
        /// Radiance of each light, one color per lobe.
        radiance: Gather<Radiance>,
        /// Light of each visible light that the lens scatters, a part of its layer, working size.
        glare: Gather<Picture>,
        /// Standard error of the shading of each light by guesses about the unseen room.
        room_error: Gather<LayerError>,
        /// The pixels of each light that is in view, photo size, for the layers `mask_<light>`.
        mask: Gather<LightMask>,
        /// Albedo.
        albedo: Arc<Albedo>,
        /// Normals.
        normal: Arc<Normal>,
        /// Roughness.
        roughness: Arc<Roughness>,
        /// Specular level; written if it is not constant.
        specular: Option<Arc<Specular>>,
        /// Depth.
        depth: Arc<Depth>,
    }
}
ports! {
    pub output WriteOut {
        /// `picture.png` and `picture.exr`.
        files: Arc<Files>,
    }
}

impl Node for Write {
    const KIND: &'static str = "Write";
    const VERSION: u32 = 11;
    const STORED_UP_TO: u64 = 128 << 20;
    type In = WriteIn;
    type Out = WriteOut;

    /// Lets go of each plane of the photo's size as soon as its file holds it.
    fn run(&self, mut inputs: WriteIn, ctx: &Context) -> Result<WriteOut, NodeError> {
        let size = inputs.picture.0.size();
        let photo = inputs.photo.iter().map(|photo| ("photo".to_owned(), &photo.0));
        for (name, plane) in [("picture".to_owned(), &inputs.picture.0)].into_iter().chain(photo) {
            super::same_size(&name, plane.size(), "picture", size)?;
            finite(&name, size, first_not_finite(plane), |i| plane.pixels()[i])?;
        }
        for (name, layer) in lights(&inputs) {
            super::same_size(&name, layer.size(), "picture", size)?;
            finite(&name, size, layer.first_not_finite(), |i| layer.get(i))?;
        }
        let diagnose = self.diagnostics && fits(&inputs, size, ctx);
        let mut layers = ExrLayers::new(size.0, size.1);
        if let (Some(photo), Some(filled)) = (&inputs.photo, &inputs.filled)
            && let Some(share) = filled_share(&inputs.picture, photo, filled)
        {
            ctx.note(format!(
                "{:.0} % of the visible change lies where a light or saturation hides the surface: it is filled in",
                100.0 * share
            ));
        }
        if let Some(photo) = inputs.photo.take() {
            layers.rgb("photo", &photo.0);
        }
        let encoding = inputs.encoding.clone();
        let png = PngSamples::new(&inputs.picture, encoding.transfer, encoding.sixteen_bit);
        layers.rgb("", &inputs.picture.0);
        inputs.picture = Arc::new(Picture(Plane::new(0, 0, Vec::new())));
        let exr = || self.exr(inputs, (layers, diagnose), size, ctx);
        let (png, exr) = if size.0 * size.1 > MAX_PIXELS_AT_ONCE {
            (png.into_file(&encoding.exif), exr())
        } else {
            rayon::join(|| png.into_file(&encoding.exif), exr)
        };
        Ok(WriteOut {
            files: Arc::new(Files(
                PICTURES.into_iter().map(str::to_owned).zip([png, exr?]).collect(),
            )),
        })
    }
}

/// Whether the file has room for diagnostics; warns where it has not.
fn fits(inputs: &WriteIn, (width, height): (usize, usize), ctx: &Context) -> bool {
    // A half float has two bytes: R G B A; three for each light, the residual and the photo;
    // albedo, normal, roughness, the filled fraction and a float depth; glare; for each light
    // two colors, a mask, a shadow, its unknown share and two errors.
    let count = 6 * inputs.glare.0.len() + 22 * inputs.radiance.0.len();
    let bytes = width * height * (8 + 6 * (2 + inputs.layer.0.len()) + 20 + count);
    if bytes > MAX_EXR_BYTES {
        ctx.warn(format!(
            "picture.exr contains no diagnostic layers: it would be {} MiB, the limit is {} MiB",
            bytes >> 20,
            MAX_EXR_BYTES >> 20
        ));
    }
    bytes <= MAX_EXR_BYTES
}

/// Layers by their names in the file.
fn lights(inputs: &WriteIn) -> impl Iterator<Item = (String, &Arc<Layer>)> {
    let lights = inputs.layer.iter().map(|(id, layer)| (format!("light_{id}"), layer));
    [(format!("light_{REST}"), &inputs.residual)].into_iter().chain(lights)
}

/// Share of the visible change, in luminance up to white, that lies where the photo does not show
/// the surface; `None` where the mean change is below half a step of 8 bits: the identity edit
/// raises saturated channels.
fn filled_share(picture: &Picture, photo: &Picture, filled: &Mask) -> Option<f64> {
    let ((width, height), (w, h)) = (photo.0.size(), filled.0.size());
    let shown = |color: Vec3| color.clamp(Vec3::ZERO, Vec3::ONE);
    let of_row = |y: usize| {
        (0..width).fold([0.0; 2], |[hidden, all], x| {
            let [after, before] = [picture, photo].map(|picture| shown(picture.0.get(x, y)));
            let change = (after - before).abs().dot(LUMINANCE);
            let share = filled.0.get(x * w / width, y * h / height);
            [hidden + f64::from(change * share), all + f64::from(change)]
        })
    };
    // Rows are summed in their order, whoever computes them.
    let rows: Vec<[f64; 2]> = (0..height).into_par_iter().map(of_row).collect();
    let [hidden, all] = rows.iter().fold([0.0; 2], |[a, b], row| [a + row[0], b + row[1]]);
    (all > 0.5 / 255.0 * (width * height) as f64).then(|| hidden / all)
}

/// The error of a plane with a pixel `at` which is not finite, if there is one.
fn finite(
    name: &str,
    (width, _): (usize, usize),
    at: Option<usize>,
    color: impl Fn(usize) -> Vec3,
) -> Result<(), NodeError> {
    at.map_or(Ok(()), |at| {
        let (x, y, got) = (at % width, at / width, color(at));
        Err(NodeError::Failed(format!(
            "{name}: wanted finite numbers, got {got} at pixel ({x}, {y})"
        )))
    })
}

impl Write {
    fn exr(
        &self,
        mut inputs: WriteIn,
        (mut layers, diagnose): (ExrLayers, bool),
        (width, height): (usize, usize),
        ctx: &Context,
    ) -> Result<Vec<u8>, NodeError> {
        layers.opaque();
        for (name, layer) in lights(&inputs) {
            layers.layer(&name, layer.clone());
        }
        inputs.layer = Gather(Vec::new());
        inputs.residual = Arc::new(Layer::new(Plane::new(0, 0, Vec::new())));
        if diagnose {
            diagnostics(&inputs, |name, plane| put(&mut layers, name, plane, (width, height)))?;
        }
        layers.comment(UNITS);
        super::encoding_lines(&inputs.encoding).iter().for_each(|line| layers.comment(line));
        if let (Some(layout), Some(camera)) = (&inputs.layout, &inputs.camera) {
            layers.comment(&super::room_line(layout, camera));
        }
        if let Some(camera) = &inputs.camera {
            let Camera { fx, fy, cx, cy, .. } = **camera;
            layers.comment(&format!("camera: fx {fx}, fy {fy}, cx {cx}, cy {cy} pixels"));
        }
        if let Some(lux) = inputs.encoding.lux {
            layers.comment(&format!("exposure: white shows 1 at {lux} lux"));
        }
        for (layer, largest) in layers.kept_as_float() {
            if *largest > 1.0 {
                ctx.warn(format!(
                    "picture.exr: {layer} reaches {largest:.3e}, a half float 65504: it is written as 32-bit float"
                ));
            } else {
                ctx.note(format!(
                    "picture.exr: {layer} is {largest:.3e} at most, too small for half floats: it is written as \
                    32-bit float"
                ));
            }
        }
        layers.write(self.compression).map_err(NodeError::Failed)
    }
}

const UNITS: &str = "units: colours linear Rec.709, in units of the photo; direct, indirect, stderr, room_error: irradiance / pi; depth: planar z in \
                     metres; normals: camera space, x right, y up, z backward";

/// A diagnostic plane at working size, and the numbers that it contains.
enum Diagnostic<'a> {
    /// Linear colors.
    Color(&'a Plane<Vec3>),
    /// Unit vectors.
    Direction(&'a Plane<Vec3>),
    /// Numbers in 0..1.
    Share(&'a Plane<f32>),
    /// Numbers without an upper limit.
    Number(&'a Plane<f32>),
    Depth(&'a Depth),
}

/// Puts a plane into the file, at the photo's size.
fn put(layers: &mut ExrLayers, name: &str, plane: Diagnostic, (width, height): (usize, usize)) {
    match plane {
        Diagnostic::Color(plane) => layers.rgb(name, plane),
        Diagnostic::Direction(plane) => {
            layers.xyz(name, &resize(plane, width, height).map(Vec3::normalize_or_zero));
        }
        Diagnostic::Share(plane) | Diagnostic::Number(plane) => {
            layers.half(&format!("{name}.Y"), plane);
        }
        Diagnostic::Depth(depth) => {
            layers.float(&format!("{name}.Z"), &resize_depth(depth, width, height).0);
        }
    }
}

/// Hands each diagnostic plane to `put`, in the order of the file.
fn diagnostics(inputs: &WriteIn, mut put: impl FnMut(&str, Diagnostic)) -> Result<(), NodeError> {
    use Diagnostic::{Color, Direction, Number, Share};
    put("albedo", Color(&inputs.albedo.0));
    put("normal", Direction(&inputs.normal.0));
    put("rough", Share(&inputs.roughness.0));
    let uneven =
        |plane: &&Arc<Specular>| plane.0.pixels().windows(2).any(|pair| pair[0] != pair[1]);
    if let Some(specular) = inputs.specular.as_ref().filter(uneven) {
        put("spec", Share(&specular.0));
    }
    for (id, glare) in inputs.glare.iter() {
        put(&format!("glare_{id}"), Color(&glare.0));
    }
    if let Some(filled) = &inputs.filled {
        put("filled", Share(&filled.0));
    }
    put("depth", Diagnostic::Depth(&inputs.depth));
    for (id, mask) in inputs.mask.iter() {
        put(&format!("mask_{id}"), Share(&mask.shares()));
    }
    for (id, radiance) in inputs.radiance.iter() {
        let (direct, visibility) = (inputs.direct.get(id), inputs.visibility.get(id));
        if let (Some(direct), Some(visibility)) = (direct, visibility)
            && !direct.lobes.is_empty()
        {
            let lobes = [
                &direct.lobes,
                &direct.stderr,
                &visibility.lit,
                &visibility.stderr,
                &visibility.unknown,
            ];
            check_lobes(id, radiance, &lobes.map(|planes| planes.len()))?;
            check_sizes(id, lobes.into_iter().flatten())?;
            put(&format!("direct_{id}"), Color(&lit_sum(radiance, direct, visibility)));
            put(&format!("shadow_{id}"), Share(&mean_share(radiance, &visibility.lit)));
            put(&format!("unknown_{id}"), Share(&mean_share(radiance, &visibility.unknown)));
        }
        let indirect = inputs.indirect.get(id).filter(|indirect| !indirect.lobes.is_empty());
        if let Some(indirect) = indirect {
            check_lobes(id, radiance, &[indirect.lobes.len(), indirect.stderr.len()])?;
            check_sizes(id, indirect.lobes.iter().map(|lobe| &lobe.0))?;
            check_sizes(id, indirect.stderr.iter())?;
            put(&format!("indirect_{id}"), Color(&indirect_sum(radiance, indirect)));
        }
        if let (Some(direct), Some(visibility), Some(indirect)) = (direct, visibility, indirect)
            && !direct.lobes.is_empty()
        {
            check_sizes(id, direct.stderr.iter().chain(&indirect.stderr))?;
            let error = standard_error(radiance, direct, visibility, indirect);
            put(&format!("stderr_{id}"), Number(&error));
        }
        let room_error = inputs.room_error.get(id).map(|error| &error.stderr);
        if let Some(error) = room_error.filter(|error| error.pixels().iter().any(|&e| e > 0.0)) {
            put(&format!("room_error_{id}"), Number(error));
        }
    }
    Ok(())
}

fn check_lobes(id: &str, radiance: &Radiance, got: &[usize]) -> Result<(), NodeError> {
    let wanted = radiance.0.len();
    match got.iter().find(|&&lobes| lobes != wanted) {
        Some(got) => Err(NodeError::Failed(format!(
            "light {id}: wanted {wanted} lobes, as its radiances, got {got}"
        ))),
        None => Ok(()),
    }
}

fn check_sizes<'a, T: Copy + 'a>(
    id: &str,
    planes: impl Iterator<Item = &'a Plane<T>>,
) -> Result<(), NodeError> {
    let sizes: Vec<_> = planes.map(Plane::size).collect();
    match sizes.iter().find(|&&size| size != sizes[0]) {
        Some(got) => Err(NodeError::Failed(format!(
            "light {id}: wanted planes of {:?} pixels, got {got:?}",
            sizes[0]
        ))),
        None => Ok(()),
    }
}

/// sum_k w_k D_k V_k
fn lit_sum(radiance: &Radiance, direct: &UnitDirect, visibility: &Visibility) -> Plane<Vec3> {
    let mut sum = direct.lobes[0].map(|_| Vec3::ZERO);
    for ((&w, d), v) in radiance.0.iter().zip(&direct.lobes).zip(&visibility.lit) {
        let lit = d.pixels().iter().zip(v.pixels()).map(|(d, v)| d * v);
        sum.pixels_mut().iter_mut().zip(lit).for_each(|(sum, lit)| *sum += w * lit);
    }
    sum
}

/// sum_k w_k I_k
fn indirect_sum(radiance: &Radiance, indirect: &UnitIndirect) -> Plane<Vec3> {
    let mut sum = indirect.lobes[0].0.map(|_| Vec3::ZERO);
    for (&w, shading) in radiance.0.iter().zip(&indirect.lobes) {
        sum.pixels_mut().iter_mut().zip(shading.0.pixels()).for_each(|(sum, &i)| *sum += w * i);
    }
    sum
}

/// sum_k Y(w_k) V_k / sum_k Y(w_k), or the plain mean.
fn mean_share(radiance: &Radiance, shares: &[Plane<f32>]) -> Plane<f32> {
    let luminances: Vec<f32> = radiance.0.iter().map(|w| w.dot(LUMINANCE)).collect();
    let total: f32 = luminances.iter().sum();
    let mut share = shares[0].map(|_| 0.0);
    for (&y, v) in luminances.iter().zip(shares) {
        let weight = if total > 0.0 { y / total } else { 1.0 / luminances.len() as f32 };
        share.pixels_mut().iter_mut().zip(v.pixels()).for_each(|(share, v)| *share += weight * v);
    }
    share
}

/// sqrt(sum_k Y(w_k)^2 ((s(D_k) V_k)^2 + (D_k s(V_k))^2) + (sum_k Y(w_k) s(I_k))^2)
fn standard_error(
    radiance: &Radiance,
    direct: &UnitDirect,
    visibility: &Visibility,
    indirect: &UnitIndirect,
) -> Plane<f32> {
    let (width, height) = direct.stderr[0].size();
    // In 64 bits: the square of a radiance of 1e20 overflows 32 bits.
    let luminances: Vec<f64> = radiance.0.iter().map(|w| f64::from(w.dot(LUMINANCE))).collect();
    let error = |p: usize| {
        let at = |planes: &[Plane<f32>], k: usize| f64::from(planes[k].pixels()[p]);
        let (mut apart, mut together) = (0.0, 0.0);
        for (k, y) in luminances.iter().enumerate() {
            let (of_direct, of_lit) =
                (at(&direct.stderr, k) * at(&visibility.lit, k), at(&visibility.stderr, k));
            apart += y * y * (of_direct.powi(2) + (at(&direct.lobes, k) * of_lit).powi(2));
            together += y * at(&indirect.stderr, k);
        }
        (apart + together * together).sqrt() as f32
    };
    Plane::new(width, height, (0..width * height).map(error).collect())
}
