//! `EditMaterials`: paints surfaces and changes their finish.

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::Color;
use crate::geometry::{Creases, grow_region};
use crate::graph::{Context, File, Gather, Node, NodeError, check_range};
use crate::image::{
    self, Albedo, AlphaMatte, Depth, Grain, Mask, NamedBytes, Normal, PaintChange, PaintLayer,
    PaintLayers, Picture, Plane, Points, Roughness, SPECULAR_EDIT, Specular, SpecularEdit,
    Upsampler, alpha_matte, dilate, distance, refine_mask, resize, same_aspect,
};
use crate::nodes::artifacts::same_size;
use crate::optics::LightKind;
use crate::tuning::tuning;
use crate::{params, ports};

params! {
    /// Paints and polishes regions of the photo; with nothing to paint, everything passes through
    /// unchanged.
    ///
    /// The photo of a region is multiplied by new over old albedo, where the old one is the mean of
    /// `known` there: so the photo determines the lighting of the region. Bounced light is computed
    /// with the new albedo; the picture is repainted at the photo's size, by `Compose`.
    pub struct EditMaterials {
        /// In order, later ones over earlier ones: `Paint(region: Mask("wall.png") | Grow(x, y),
        /// albedo: Srgb("#c8642a") | Linear(r, g, b), roughness: 0.6, specular: 0.5, keep_texture:
        /// true)`.
        materials: Vec<MaterialEdit> = Vec::new(),
    }
}

/// One entry of an edit's `materials`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum MaterialEdit {
    /// Other paint on a region.
    Paint {
        /// Pixels that are painted.
        region: Region,
        /// Mean albedo of the region afterwards; as it was when not given.
        #[serde(default)]
        albedo: Option<Color>,
        /// GGX roughness, 0..=1; as it was when not given.
        #[serde(default)]
        roughness: Option<f32>,
        /// Specular level, 0..=1, of which 0.08 is reflected straight back.
        #[serde(default)]
        specular: Option<f32>,
        /// Texture and unevenness of the photo stay visible under the new paint.
        #[serde(default = "yes")]
        keep_texture: bool,
    },
}

fn yes() -> bool {
    true
}

/// Part of the photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Region {
    /// White in a picture of the photo's shape: PNG, JPEG or EXR.
    Mask(File),
    /// The surface of like paint, in one plane, around a photo pixel.
    Grow(f32, f32),
}

ports! {
    pub input EditMaterialsIn {
        /// The linear photo.
        photo: Arc<Picture>,
        /// Mask of saturated pixels, photo size.
        clipped: Arc<Mask>,
        /// Mask of each visible light, photo size. A surface that does not grow from a light ends
        /// there.
        mask: Gather<Mask>,
        /// Kind of each visible light.
        kind: Gather<LightKind>,
        /// Planar depth at the photo's size.
        full_depth: Arc<Depth>,
        /// The photo at working size.
        small: Arc<Picture>,
        /// Planar depth at working size.
        depth: Arc<Depth>,
        /// Points of the seen surface, working size.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Reflectance at working size: photo over shading, filled in under lights.
        reflectance: Arc<Albedo>,
        /// Albedo by a network, working size. `Grow` compares paints by its geometric mean with
        /// `reflectance`: light that the fit missed remains in `reflectance` alone, and light that
        /// the network took for paint in this albedo alone.
        network_albedo: Option<Arc<Albedo>>,
        /// Albedo estimated from the photo alone, working size: the old paint.
        known: Arc<Albedo>,
        /// Albedo for bounced light, working size.
        albedo: Arc<Albedo>,
        /// Albedo after the fit, working size.
        fitted: Arc<Albedo>,
        /// Roughness at working size.
        roughness: Arc<Roughness>,
    }
}

ports! {
    pub output EditMaterialsOut {
        /// `albedo` with the regions repainted.
        albedo: Arc<Albedo>,
        /// `fitted` with the regions repainted.
        fitted: Arc<Albedo>,
        /// The input, with the new roughness of the regions that have one.
        roughness: Arc<Roughness>,
        /// Specular level: that of a usual dielectric, and the new one of the regions that have
        /// one.
        specular: Arc<Specular>,
        /// The paint at the photo's size.
        paint_layers: Arc<PaintLayers>,
        /// New roughness and specular level at the photo's size.
        specular_edit: Arc<SpecularEdit>,
        /// Whether a region has a new roughness or specular level.
        has_specular_edit: bool,
    }
}

tuning! {
    /// Constants of `EditMaterials`.
    pub const TUNING: EditMaterialsTuning {
        /// Least mean reflectance of a region.
        min_reflectance: f32 = 0.01,
            unit "reflectance", source Derived("the noise of photos"),
            effect "a smaller value makes paint of dark regions noisy";
        /// Largest distance from a saturated pixel at which noise may hide that a pixel beside a
        /// light is saturated.
        white: f32 = 2.0,
            unit "pixels", source Measured("JPEG around the lamp of scenes/demo"),
            effect "a smaller value leaves white specks beside lights unpainted";
    }
}

impl Node for EditMaterials {
    const KIND: &'static str = "EditMaterials";
    const VERSION: u32 = 13;
    type In = EditMaterialsIn;
    type Out = EditMaterialsOut;

    fn check_consistency(&self) -> Result<(), String> {
        let entry = |(i, edit): (usize, &MaterialEdit)| {
            edit.check().map_err(|e| format!("materials: entry {}: {e}", i + 1))
        };
        self.materials.iter().enumerate().try_for_each(entry)
    }

    fn files(&mut self) -> Vec<&mut File> {
        let regions = self.materials.iter_mut().map(|MaterialEdit::Paint { region, .. }| region);
        regions
            .filter_map(|region| if let Region::Mask(file) = region { Some(file) } else { None })
            .collect()
    }

    fn run(&self, inputs: EditMaterialsIn, ctx: &Context) -> Result<EditMaterialsOut, NodeError> {
        let (width, height) = inputs.small.0.size();
        if let Some(network) = &inputs.network_albedo {
            let wanted = inputs.reflectance.0.size();
            same_size("network_albedo", network.0.size(), "reflectance", wanted)?;
        }
        let photo = inputs.photo.0.size();
        same_size("clipped", inputs.clipped.0.size(), "photo", photo)?;
        for (id, mask) in inputs.mask.iter() {
            same_size(&format!("mask[{id}]"), mask.0.size(), "photo", photo)?;
        }
        let (mut paint_layers, mut finish) = (Vec::new(), SpecularEdit::default());
        let mut out = EditMaterialsOut {
            albedo: inputs.albedo.clone(),
            fitted: inputs.fitted.clone(),
            roughness: inputs.roughness.clone(),
            specular: Arc::new(Specular(Plane::filled(width, height, SPECULAR_EDIT.dielectric))),
            paint_layers: Arc::default(),
            specular_edit: Arc::default(),
            has_specular_edit: false,
        };
        let grain = (!self.materials.is_empty()).then(|| Grain::measure(&inputs.photo)).flatten();
        for (i, edit) in self.materials.iter().enumerate() {
            let MaterialEdit::Paint { region, albedo, roughness, specular, keep_texture } = edit;
            ctx.check_cancelled()?;
            let bad =
                |e: String| NodeError::BadParameter(format!("materials: entry {}: {e}", i + 1));
            let matte = region.matte(&inputs, grain.as_ref(), ctx, bad)?;
            let share = resize(&matte.alpha, width, height);
            if roughness.is_some() || specular.is_some() {
                finish.lay(&matte.alpha, [*roughness, *specular], &inputs.roughness);
                out.has_specular_edit = true;
            }
            if let Some(color) = albedo {
                let new = color.linear().map_err(bad)?;
                let keep_texture = *keep_texture;
                for (was, is) in
                    [(&inputs.albedo, &mut out.albedo), (&inputs.fitted, &mut out.fitted)]
                {
                    let old = mean(&was.0, &share);
                    let paint = PaintChange { old, new, keep_texture, noise: Vec3::ZERO };
                    *is = Arc::new(Albedo(painted(&is.0, &was.0, &share, paint)));
                }
                let (known, old) =
                    (mean(&inputs.known.0, &share), mean(&inputs.reflectance.0, &share));
                let part = 100.0 * share.pixels().iter().sum::<f32>() / share.len() as f32;
                ctx.note(format!(
                    "entry {}: {part:.1} % of the photo, albedo {known:.3} before, {new:.3} after",
                    i + 1
                ));
                let new = new * old / known;
                let level = mean(&inputs.small.0, &share);
                let noise = grain.as_ref().map_or(Vec3::ZERO, |grain| old * grain.relative(level));
                let paint = PaintChange { old, new, keep_texture, noise };
                paint_layers.push(PaintLayer { paint, matte });
            }
            if let Some(new) = roughness {
                out.roughness = Arc::new(Roughness(mixed(&out.roughness.0, *new, &share)));
            }
            if let Some(new) = specular {
                out.specular = Arc::new(Specular(mixed(&out.specular.0, *new, &share)));
            }
        }
        out.paint_layers = Arc::new(PaintLayers(paint_layers));
        out.specular_edit = Arc::new(finish);
        Ok(out)
    }
}

impl MaterialEdit {
    fn check(&self) -> Result<(), String> {
        let MaterialEdit::Paint { region, albedo, roughness, specular, keep_texture: _ } = self;
        if let Region::Mask(file) = region
            && file.path.is_empty()
        {
            return Err("region: Mask: wanted a file, got none".into());
        }
        if albedo.is_none() && roughness.is_none() && specular.is_none() {
            return Err("wanted at least one of albedo, roughness and specular, got none".into());
        }
        if let Some(color) = albedo {
            color.linear().map_err(|e| format!("albedo: {e}"))?;
        }
        for (name, value) in [("roughness", roughness), ("specular", specular)] {
            check_range(name, value, 0.0..=1.0)?;
        }
        Ok(())
    }
}

impl Region {
    fn matte(
        &self,
        inputs: &EditMaterialsIn,
        grain: Option<&Grain>,
        ctx: &Context,
        bad: impl Fn(String) -> NodeError,
    ) -> Result<AlphaMatte, NodeError> {
        let (width, height) = inputs.photo.0.size();
        let (mask, reach, exact) = match self {
            Region::Mask(file) => (mask(file, (width, height), ctx)?, 0.0, Vec::new()),
            &Region::Grow(x, y) => {
                if !((0.0..width as f32).contains(&x) && (0.0..height as f32).contains(&y)) {
                    let wanted = format!("wanted a pixel of the photo, 0..{width} and 0..{height}");
                    return Err(bad(format!("region: Grow: {wanted}, got ({x}, {y})")));
                }
                // The outline of a grown region is exact to one working pixel and a half.
                let reach = 1.5 * width as f32 / inputs.small.0.width() as f32;
                let (first, lights) = ((x as usize, y as usize), lights(inputs));
                let beside_light = if lights.get(first.0, first.1) {
                    Vec::new()
                } else {
                    saturated_by_light(&lights, &inputs.clipped, reach)
                };
                let (mask, exact) = grown(first, inputs, grain, &lights, beside_light);
                (mask, reach, exact)
            }
        };
        ctx.check_cancelled()?;
        let refined = refine_mask(&mask, &inputs.photo, Some(&inputs.full_depth), reach);
        let mut matte = alpha_matte(&refined, &inputs.photo);
        for &i in &exact {
            matte.alpha.pixels_mut()[i as usize] = mask.pixels()[i as usize];
        }
        matte.boundary.retain(|(i, _)| exact.binary_search(i).is_err());
        Ok(matte)
    }
}

/// A mask at the photo's size, with some of it white.
fn mask(file: &File, photo: (usize, usize), ctx: &Context) -> Result<Plane<f32>, NodeError> {
    let name = file.location().display().to_string();
    let bytes = ctx.read(file)?;
    let bad = |message: String| NodeError::BadFile { path: name.clone(), message };
    let mask = image::read_mask(NamedBytes::new(&name, &bytes)).map_err(|e| bad(e.message()))?.0;
    let ((w, h), (pw, ph)) = (mask.size(), photo);
    if !same_aspect((w, h), photo) {
        return Err(bad(format!(
            "region size: wanted the photo's {pw} x {ph}, or its aspect ratio to 2 %, got {w} x {h}"
        )));
    }
    if (w, h) != photo {
        ctx.warn(format!("{}: {w} x {h}, resampled to the photo's {pw} x {ph}", file.path));
    }
    if mask.pixels().iter().all(|&share| share == 0.0) {
        return Err(bad("wanted a region in white, got a mask that is black everywhere".into()));
    }
    Ok(resize(&mask, pw, ph))
}

/// The pixels of all lights in view, photo size.
fn lights(inputs: &EditMaterialsIn) -> Plane<bool> {
    let (w, h) = inputs.photo.0.size();
    let shows_light = |i: usize| inputs.mask.iter().any(|(_, mask)| mask.0.pixels()[i] > 0.5);
    Plane::new(w, h, (0..w * h).map(shows_light).collect())
}

/// The pixels of all lamps in view, working size.
fn lamps(inputs: &EditMaterialsIn) -> Plane<bool> {
    let ((w, h), (pw, ph)) = (inputs.small.0.size(), inputs.photo.0.size());
    let is_lamp = |id| inputs.kind.get(id).is_some_and(|kind| **kind == LightKind::Lamp);
    let mut lamps = Plane::filled(w, h, false);
    for (_, mask) in inputs.mask.iter().filter(|(id, _)| is_lamp(id)) {
        for i in (0..pw * ph).filter(|&i| mask.0.pixels()[i] > 0.5) {
            lamps.set(i % pw * w / pw, i / pw * h / ph, true);
        }
    }
    lamps
}

/// Indices, rising, of the pixels of `lights` and of the saturated pixels within `reach` of them,
/// where the photo has no edge between a light and the surface behind it.
fn saturated_by_light(lights: &Plane<bool>, clipped: &Mask, reach: f32) -> Vec<u32> {
    if !lights.pixels().contains(&true) {
        return Vec::new();
    }
    let (to_light, to_white) = (distance(lights), distance(&clipped.0.map(|share| share > 0.5)));
    let far = to_light.pixels().iter().zip(to_white.pixels());
    let is_white =
        |(&light, &white): (&f32, &f32)| light == 0.0 || light <= reach && white <= TUNING.white;
    (0..).zip(far).filter(|(_, far)| is_white(*far)).map(|(i, _)| i).collect()
}

/// The surface around a photo pixel, found at working size and upsampled to the photo's along its
/// edges. Of the pixels `beside_light` it contains those that are not of `lights` and have a pixel
/// of it among the nearest working pixels. Also returns the indices, rising, of the pixels in which
/// the mask is exact: those beside lights and at creases.
fn grown(
    (x, y): (usize, usize),
    inputs: &EditMaterialsIn,
    grain: Option<&Grain>,
    lights: &Plane<bool>,
    beside_light: Vec<u32>,
) -> (Plane<f32>, Vec<u32>) {
    let ((w, h), (pw, ph)) = (inputs.small.0.size(), inputs.photo.0.size());
    let seed = (x * w / pw, y * h / ph);
    let (points, normal) = (&inputs.points, &inputs.normal);
    let with_network =
        inputs.network_albedo.as_ref().map(|network| geometric_mean(&inputs.reflectance, network));
    let paint = with_network.as_ref().unwrap_or(&inputs.reflectance);
    let lamps = lamps(inputs);
    let found = grow_region(seed, &inputs.small, paint, points, normal, grain, &lamps);
    let creases = Creases::find(&found, points, normal, &inputs.photo);
    let found = Mask(found.map(|inside| f32::from(u8::from(inside))));
    let near = dilate([&found].into_iter(), (w, h), 1);
    let found = found.0.map(Vec3::splat);
    let upsampler = Upsampler::new(&inputs.photo, &inputs.full_depth, &inputs.small, &inputs.depth);
    let mut grown = Plane::from_fn(pw, ph, |x, y| upsampler.taps(x, y).of(&found).x.round());
    let mut exact = creases.map_or_else(Vec::new, |creases| creases.draw(&mut grown));
    for i in beside_light.iter().map(|&i| i as usize) {
        if lights.pixels()[i] || exact.binary_search(&(i as u32)).is_err() {
            let is_inside = !lights.pixels()[i] && near.get(i % pw * w / pw, i / pw * h / ph);
            grown.pixels_mut()[i] = f32::from(u8::from(is_inside));
        }
    }
    exact.extend(beside_light);
    exact.sort_unstable();
    exact.dedup();
    (grown, exact)
}

/// Geometric mean per channel of two albedos of one size.
fn geometric_mean(a: &Albedo, b: &Albedo) -> Albedo {
    let (width, height) = a.0.size();
    let pixels = a.0.pixels().iter().zip(b.0.pixels());
    let mean = pixels.map(|(&a, &b)| (a * b).max(Vec3::ZERO).map(f32::sqrt));
    Albedo(Plane::new(width, height, mean.collect()))
}

fn mixed(below: &Plane<f32>, new: f32, share: &Plane<f32>) -> Plane<f32> {
    let mixed =
        below.pixels().iter().zip(share.pixels()).map(|(old, share)| old + share * (new - old));
    Plane::new(below.width(), below.height(), mixed.collect())
}

/// Mean over a region.
fn mean(albedo: &Plane<Vec3>, share: &Plane<f32>) -> Vec3 {
    let terms = albedo.pixels().iter().zip(share.pixels()).filter(|(_, share)| **share > 0.0);
    let (sum, weight) = terms
        .fold((Vec3::ZERO, 0.0), |(sum, weight), (a, &share)| (sum + share * *a, weight + share));
    (sum / weight.max(1e-6)).max(Vec3::splat(TUNING.min_reflectance))
}

/// `below` with `paint` over `bare`, the albedo without any paint, weighted by the painted fraction
/// of each pixel.
fn painted(
    below: &Plane<Vec3>,
    bare: &Plane<Vec3>,
    share: &Plane<f32>,
    paint: PaintChange,
) -> Plane<Vec3> {
    let (width, height) = below.size();
    let layers = below.pixels().iter().zip(bare.pixels()).zip(share.pixels());
    let over = layers.map(
        |((&below, &bare), &share)| {
            if share > 0.0 { below.lerp(paint.over(bare), share) } else { below }
        },
    );
    Plane::new(width, height, over.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (40, 30);

    /// A wall at 3 m, left half of `left` and right half of `right` paint, under light that fades
    /// from left to right. The albedo that is known is four fifths of photo over shading.
    fn wall(left: Vec3, right: Vec3) -> EditMaterialsIn {
        let (w, h) = SIZE;
        let paint = Plane::from_fn(w, h, |x, _| if x < w / 2 { left } else { right });
        let photo = Plane::from_fn(w, h, |x, y| paint.get(x, y) * (1.0 - 0.01 * x as f32));
        let photo = Arc::new(Picture(photo));
        let depth = Arc::new(Depth(Plane::filled(w, h, 3.0)));
        let points = Plane::from_fn(w, h, |x, y| Vec3::new(0.1 * x as f32, -0.1 * y as f32, -3.0));
        let albedo = Arc::new(Albedo(paint.map(|a| 0.8 * a)));
        EditMaterialsIn {
            photo: photo.clone(),
            clipped: Arc::new(Mask(Plane::filled(w, h, 0.0))),
            mask: Gather(vec![]),
            kind: Gather(vec![]),
            full_depth: depth.clone(),
            small: photo,
            depth,
            points: Arc::new(Points(points)),
            normal: Arc::new(Normal(Plane::filled(w, h, Vec3::Z))),
            network_albedo: None,
            reflectance: Arc::new(Albedo(paint)),
            known: albedo.clone(),
            fitted: albedo.clone(),
            albedo,
            roughness: Arc::new(Roughness(Plane::filled(w, h, 0.8))),
        }
    }

    const GRAY: Vec3 = Vec3::splat(0.5);
    const RED: Vec3 = Vec3::new(0.5, 0.1, 0.1);
    const NEW: Vec3 = Vec3::new(0.2, 0.4, 0.1);

    fn paint(region: Region, color: Vec3) -> MaterialEdit {
        let albedo = Some(Color::Linear(color.x, color.y, color.z));
        MaterialEdit::Paint { region, albedo, roughness: None, specular: None, keep_texture: true }
    }

    fn run(
        materials: Vec<MaterialEdit>,
        inputs: EditMaterialsIn,
    ) -> Result<EditMaterialsOut, NodeError> {
        EditMaterials { materials }.run(inputs, &Context::default())
    }

    /// A mask in a file that lives as long as the first.
    fn mask_file(
        size: (usize, usize),
        share: impl Fn(usize, usize) -> f32,
    ) -> (tempfile::NamedTempFile, Region) {
        let picture = Picture(Plane::from_fn(size.0, size.1, |x, y| Vec3::splat(share(x, y))));
        let mut file = tempfile::NamedTempFile::new().expect("a temporary file can be made");
        let png = image::write_png(&picture, image::Transfer::Linear, false);
        std::io::Write::write_all(&mut file, &png).expect("it can be written to");
        let region = Region::Mask(File::new(file.path().display().to_string()));
        (file, region)
    }

    #[test]
    fn nothing_to_paint_passes_through() {
        let inputs = wall(GRAY, RED);
        let (albedo, fitted, roughness) =
            (inputs.albedo.clone(), inputs.fitted.clone(), inputs.roughness.clone());
        let out = run(vec![], inputs).expect("it is sound");
        assert!(Arc::ptr_eq(&albedo, &out.albedo) && Arc::ptr_eq(&fitted, &out.fitted));
        assert!(Arc::ptr_eq(&roughness, &out.roughness) && out.paint_layers.0.is_empty());
        assert_eq!(*out.specular_edit, SpecularEdit::default());
    }

    #[test]
    fn a_surface_grows_to_the_next_paint_and_takes_the_new_one() {
        let out =
            run(vec![paint(Region::Grow(5.0, 12.0), NEW)], wall(GRAY, RED)).expect("it is sound");
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let want = if x < SIZE.0 / 2 { NEW } else { 0.8 * RED };
            let got = out.albedo.0.get(x, y);
            // Light fades: beside the edge, a hundredth of it is attributed to the other paint.
            assert!((got - want).abs().max_element() < 0.01, "({x}, {y}): {got} against {want}");
        }
        // The photo is a fifth brighter than by its albedo, and stays so.
        let layer = &out.paint_layers.0[0];
        assert!(
            (layer.paint.over(GRAY) - NEW / 0.8).abs().max_element() < 1e-4,
            "{}",
            layer.paint.over(GRAY)
        );
        assert!(out.paint_layers.at(5, 5).reflectance(GRAY, GRAY).distance(NEW / 0.8) < 1e-4);
        assert_eq!(out.paint_layers.at(30, 5).reflectance(GRAY, GRAY), GRAY);
    }

    #[test]
    fn a_surface_grows_over_light_that_the_fit_missed() {
        let half = |x: usize| if x < SIZE.0 / 2 { 1.0 } else { 0.2 };
        let lit = Plane::from_fn(SIZE.0, SIZE.1, |x, _| GRAY * half(x));
        let right = |network_albedo| {
            let reflectance = Arc::new(Albedo(lit.clone()));
            let inputs = EditMaterialsIn { reflectance, network_albedo, ..wall(GRAY, GRAY) };
            let out = run(vec![paint(Region::Grow(5.0, 12.0), NEW)], inputs).expect("it is sound");
            out.paint_layers.0[0].matte.alpha.get(SIZE.0 - 2, 12)
        };
        assert_eq!(right(None), 0.0, "photo over shading alone");
        let even = Albedo(Plane::filled(SIZE.0, SIZE.1, GRAY));
        assert_eq!(right(Some(Arc::new(even))), 1.0, "with a network that sees one paint");
    }

    #[test]
    fn a_surface_that_grows_ends_at_the_outline_of_a_light_in_white() {
        // Four photo pixels a working one; the lamp and four pixels around it are white, and the
        // working pixels of the lamp and beside it are of no surface.
        let (w, h) = (4 * SIZE.0, 4 * SIZE.1);
        let lamp = |x: usize, y: usize| (70..91).contains(&x) && (50..71).contains(&y);
        let white = |x: usize, y: usize| (66..95).contains(&x) && (46..75).contains(&y);
        let small = wall(GRAY, GRAY);
        let found = |paint: &Plane<Vec3>| {
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                let beside = (17..23).contains(&x) && (12..18).contains(&y);
                if beside { Vec3::ONE } else { paint.get(x, y) }
            })
        };
        let share = |is: &dyn Fn(usize, usize) -> bool| {
            Arc::new(Mask(Plane::from_fn(w, h, |x, y| f32::from(u8::from(is(x, y))))))
        };
        let photo = resize(&small.photo.0, w, h);
        let photo =
            Plane::from_fn(w, h, |x, y| if white(x, y) { Vec3::ONE } else { photo.get(x, y) });
        let inputs = || EditMaterialsIn {
            photo: Arc::new(Picture(photo.clone())),
            clipped: share(&white),
            mask: Gather(vec![("lamp".to_owned(), share(&lamp))]),
            full_depth: Arc::new(Depth(Plane::filled(w, h, 3.0))),
            small: Arc::new(Picture(found(&small.small.0))),
            reflectance: Arc::new(Albedo(found(&small.reflectance.0))),
            ..wall(GRAY, GRAY)
        };
        let alpha = |inputs: EditMaterialsIn| {
            let out = run(vec![paint(Region::Grow(20.0, 48.0), NEW)], inputs).expect("it is sound");
            out.paint_layers.0[0].matte.alpha.clone()
        };
        let outline = |alpha: &Plane<f32>| {
            let around = (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| white(x, y));
            around.filter(|&(x, y)| alpha.get(x, y) != f32::from(u8::from(!lamp(x, y)))).count()
        };
        let got = alpha(inputs());
        assert_eq!(outline(&got), 0);
        let without = EditMaterialsIn { mask: Gather(vec![]), ..inputs() };
        assert!(outline(&alpha(without)) > 50);
        // A shade can be painted, too.
        let shade = run(vec![paint(Region::Grow(80.0, 60.0), NEW)], inputs()).expect("it is sound");
        assert_eq!(shade.paint_layers.0[0].matte.alpha.get(80, 60), 1.0);
    }

    #[test]
    fn a_plane_of_another_size_is_an_error() {
        let check = |inputs: EditMaterialsIn, wanted: &str| {
            let all = paint(Region::Grow(5.0, 12.0), NEW);
            let error = run(vec![all], inputs).err().expect("the sizes differ").to_string();
            assert!(error.contains(wanted), "{error}");
        };
        let albedo = Some(Arc::new(Albedo(Plane::filled(2, 1, GRAY))));
        check(
            EditMaterialsIn { network_albedo: albedo, ..wall(GRAY, GRAY) },
            "network_albedo: wanted 40 x 30 pixels as reflectance, got 2 x 1",
        );
        let mask = Gather(vec![("lamp".to_owned(), Arc::new(Mask(Plane::filled(2, 1, 1.0))))]);
        check(
            EditMaterialsIn { mask, ..wall(GRAY, GRAY) },
            "mask[lamp]: wanted 40 x 30 pixels as photo, got 2 x 1",
        );
    }

    #[test]
    fn later_entries_lie_over_earlier_ones() {
        let all = || Region::Grow(5.0, 5.0);
        let out =
            run(vec![paint(all(), RED), paint(all(), NEW)], wall(GRAY, GRAY)).expect("it is sound");
        assert!(out.albedo.0.pixels().iter().all(|a| a.distance(NEW) < 1e-4));
        assert!(out.paint_layers.at(9, 9).reflectance(GRAY, GRAY).distance(NEW / 0.8) < 1e-4);
    }

    #[test]
    fn soft_masks_of_other_sizes_blend() {
        let (_file, region) =
            mask_file(
                (80, 60),
                |x, _| if x < 20 { 1.0 } else { (1.0 - (x - 20) as f32 / 40.0).max(0.0) },
            );
        let edit = MaterialEdit::Paint {
            region,
            albedo: Some(Color::Linear(0.2, 0.2, 0.2)),
            roughness: Some(0.2),
            specular: Some(1.0),
            keep_texture: true,
        };
        let out = run(vec![edit], wall(GRAY, GRAY)).expect("it is sound");
        let share = |x: usize| out.paint_layers.0[0].matte.alpha.get(x, 7);
        assert_eq!((share(3), share(35)), (1.0, 0.0));
        assert!((share(20) - 0.49).abs() < 0.02, "{}", share(20));
        for x in [3, 15, 20, 25, 35] {
            let mix = |old: f32, new: f32| old + share(x) * (new - old);
            let near = |got: f32, want: f32| {
                assert!((got - want).abs() < 1e-3, "{x}: {got} against {want}")
            };
            near(out.roughness.0.get(x, 7), mix(0.8, 0.2));
            near(out.specular.0.get(x, 7), mix(0.5, 1.0));
            near(out.albedo.0.get(x, 7).y, mix(0.4, 0.2));
            let [roughness, specular] = out.specular_edit.gloss.get(x, 7);
            let is_new = share(x) > 0.0;
            assert_eq!((roughness, specular), if is_new { (0.2, 1.0) } else { (0.8, 0.5) }, "{x}");
            assert_eq!(out.specular_edit.share.get(x, 7), share(x));
            near(out.paint_layers.at(x, 7).reflectance(GRAY, GRAY).x, mix(0.5, 0.25));
        }
    }

    #[test]
    fn bad_entries_are_told() {
        let message = |edit: MaterialEdit| {
            run(vec![edit], wall(GRAY, RED)).err().expect("it is refused").to_string()
        };
        let (_file, square) = mask_file((40, 40), |_, _| 1.0);
        let wrong_shape = message(paint(square, NEW));
        assert!(
            wrong_shape
                .ends_with("wanted the photo's 40 x 30, or its aspect ratio to 2 %, got 40 x 40"),
            "{wrong_shape}"
        );
        let (_other, black) = mask_file(SIZE, |_, _| 0.0);
        let black = message(paint(black, NEW));
        assert!(black.contains("black everywhere"), "{black}");
        let outside = message(paint(Region::Grow(40.0, 3.0), NEW));
        assert_eq!(
            outside,
            "materials: entry 1: region: Grow: wanted a pixel of the photo, 0..40 and 0..30, got (40, 3)"
        );
    }
}
