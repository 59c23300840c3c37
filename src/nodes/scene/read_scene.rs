//! `ReadScene`: decodes the files of a scene, checks that they belong together, fills the holes of
//! the depth and marks saturated pixels.
//!
//! Everything later is computed at the *working size*, the photo fitted into `long_side`; the
//! photo's own size is kept beside it, because the result is written at that size.
//!
//! Depth, by `kind` (d the stored number plus the `shift`, s the `scale`): planar z = s d; a ray
//! length gives z = s d / |r| with r the ray of the pixel at planar depth 1; a disparity gives
//! z = s / d. Relative depth of a network is a disparity with a shift.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{CameraSpec, Exposure, Photograph, Shot, bad, open, size, warn};
use crate::geometry::{Camera, SeenRoom, doubts};
use crate::graph::{Context, File, Node, NodeError, Scatter, check_range};
use crate::image::{self, Depth, Mask, Picture, Plane, Transfer};
use crate::nodes::artifacts::{Encoding, INV_LAMP, INV_WINDOW, REST};
use crate::optics::LightKind;
use crate::optics::inverse::RADIANCE_FIT;
use crate::{params, ports};

/// The quantity in a depth file: relative or inverse depth is a `Disparity` with a `shift`.
pub use crate::image::Measure as DepthKind;

/// The depth file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthSpec {
    /// The file.
    pub path: File,
    /// Meaning of its numbers.
    #[serde(default)]
    pub kind: DepthKind,
    /// Meters per stored unit.
    #[serde(default = "one")]
    pub scale: f32,
    /// Added to each stored number before anything else, stored units.
    #[serde(default)]
    pub shift: f32,
}

fn one() -> f32 {
    1.0
}

/// A visible light: its kind, and the file that marks its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LightSpec {
    /// A lamp.
    Lamp {
        /// Picture whose white pixels show the lamp.
        mask: File,
    },
    /// A window.
    Window {
        /// Picture whose white pixels show the window.
        mask: File,
    },
}

impl LightSpec {
    fn mask(&self) -> &File {
        match self {
            LightSpec::Lamp { mask } | LightSpec::Window { mask } => mask,
        }
    }

    fn kind(&self) -> LightKind {
        match self {
            LightSpec::Lamp { .. } => LightKind::Lamp,
            LightSpec::Window { .. } => LightKind::Window,
        }
    }
}

params! {
    /// Reads the photo, its depth and the masks of its visible lights.
    pub struct ReadScene {
        /// The photo: PNG (8 or 16 bits), JPEG, WebP, HDR or EXR.
        photo: File = File::default(),
        /// Transfer function of a PNG or JPEG photo. HDR and EXR are always linear. The result's
        /// PNG has the same.
        transfer: Transfer = Transfer::Srgb,
        /// The photo's camera: FovX(degrees) or Pinhole(fx, fy, cx, cy in photo pixels).
        camera: CameraSpec = CameraSpec::FovX(60.0),
        /// Depth: EXR (channel Z, else Y, else R), gray PNG, NPY, NPZ, PFM or TIFF, in units of
        /// `scale` meters after `shift` is added.
        depth: DepthSpec =
            DepthSpec { path: File::default(), kind: DepthKind::PlanarZ, scale: 1.0, shift: 0.0 },
        /// The visible lights by name, each with the mask of its pixels: PNG, JPEG or EXR; at most
        /// 32 masks.
        lights: BTreeMap<String, LightSpec> = BTreeMap::new(),
        /// Mask of pixels that are not part of the room.
        ignore: Option<File> = None,
        /// Mask of the pixels lit by the sun, in place of those that `FindSun` finds; black for a
        /// photo without sunlight.
        sunlight: Option<File> = None,
        /// Illuminance of a white surface of value 1: Lux(value).
        exposure: Option<Exposure> = None,
        /// Longer side of the working size, pixels. A smaller photo is not enlarged.
        long_side: u32 = 320, in 1..,
    }
}

ports! {
    pub output ReadSceneOut {
        /// The linear photo at its own size.
        photo: Arc<Picture>,
        /// Mask of saturated pixels, the photo's size: 1 where the photo is saturated.
        clipped: Arc<Mask>,
        /// The linear photo at working size.
        small: Arc<Picture>,
        /// Fraction of saturated pixels, working size.
        small_clipped: Arc<Mask>,
        /// Planar depth at working size, holes filled.
        depth: Arc<Depth>,
        /// Planar depth at the photo's size, holes filled.
        full_depth: Arc<Depth>,
        /// Fraction of depth pixels without a reading, working size.
        holes: Arc<Mask>,
        /// The camera at the photo's size.
        camera: Arc<Camera>,
        /// The camera at working size.
        small_camera: Arc<Camera>,
        /// Pixels that are not part of the room, working size; all 0 when the scene names none.
        ignore: Arc<Mask>,
        /// Pixels lit by the sun, working size; empty when the scene names no mask of them.
        sunlight: Arc<Mask>,
        /// Mask of each visible light, working size.
        mask: Scatter<Mask>,
        /// Mask of each visible light, the photo's size.
        full_mask: Scatter<Mask>,
        /// Kind of each visible light.
        kind: Scatter<LightKind>,
        /// Encoding of the photo.
        encoding: Arc<Encoding>,
    }
}
ports! { pub input ReadSceneIn {} }

impl Node for ReadScene {
    const KIND: &'static str = "ReadScene";
    const VERSION: u32 = 6;
    type In = ReadSceneIn;
    type Out = ReadSceneOut;

    fn check_consistency(&self) -> Result<(), String> {
        self.shot().check()?;
        if self.depth.path.path.is_empty() {
            return Err("depth.path: wanted a file, got none".into());
        }
        check_range("depth: scale", &self.depth.scale, 1e-9..=1e9)?;
        check_range("depth: shift", &self.depth.shift, -1e9..=1e9)?;
        self.lights.keys().try_for_each(|id| check_id(id))?;
        let masks: BTreeSet<(LightKind, &File)> =
            self.lights.values().map(|light| (light.kind(), light.mask())).collect();
        if masks.len() > RADIANCE_FIT.max_lights {
            return Err(format!(
                "lights: wanted at most {} lights with masks of their own, got {}; leave out the weakest: \
                their light stays in the picture",
                RADIANCE_FIT.max_lights,
                masks.len()
            ));
        }
        Ok(())
    }

    fn files(&mut self) -> Vec<&mut File> {
        let masks = self.lights.values_mut().map(|light| match light {
            LightSpec::Lamp { mask } | LightSpec::Window { mask } => mask,
        });
        [&mut self.photo, &mut self.depth.path]
            .into_iter()
            .chain(masks)
            .chain(&mut self.ignore)
            .chain(&mut self.sunlight)
            .collect()
    }

    fn run(&self, _: ReadSceneIn, ctx: &Context) -> Result<ReadSceneOut, NodeError> {
        let Photograph { photo, clipped, small, camera, encoding } = self.shot().read(ctx)?;
        let full = photo.0.size();

        // The faults of all files are told at once.
        let mut faults = Vec::new();
        let mut masks = Vec::new();
        for (id, light) in &self.lights {
            ctx.check_cancelled()?;
            let mask = self.mask(ctx, light.mask(), full);
            masks.extend(collect(mask, &mut faults)?.map(|mask| (id.clone(), mask)));
        }
        let ignore = self.ignore.as_ref().map(|file| self.mask(ctx, file, full));
        let ignore = ignore.map(|mask| collect(mask, &mut faults)).transpose()?.flatten();
        let sunlight = self.sunlight.as_ref().map(|file| self.any_mask(ctx, file, full));
        let sunlight = sunlight.map(|mask| collect(mask, &mut faults)).transpose()?.flatten();

        ctx.check_cancelled()?;
        let depth = self.depth(ctx, &camera, &masks, ignore.as_ref());
        let depth = match collect(depth, &mut faults)? {
            Some(depth) if faults.is_empty() => depth,
            _ => return Err(NodeError::BadFiles(faults)),
        };
        let ReadDepth { depth, holes, confidence, outside } = depth;
        ctx.check_cancelled()?;
        let small_picture = Picture(image::resize(&photo.0, small.0, small.1));
        let small_depth = image::resize_depth(&depth, small.0, small.1);
        let room = SeenRoom {
            depth: &small_depth,
            camera: &camera.resized(small.0, small.1),
            measure: self.depth.kind,
            outside: &image::resize(&outside, small.0, small.1),
            photo: &small_picture,
            lights: masks.iter().map(|(id, mask)| (id.as_str(), mask)).collect(),
        };
        doubts(&room).iter().for_each(|doubt| ctx.warn(doubt.to_string()));
        ctx.check_cancelled()?;
        let full_depth = if full.0 >= GUIDED * depth.0.width() {
            image::guided_depth(&depth, confidence.as_ref(), &photo)
        } else {
            image::resize_depth(&depth, full.0, full.1)
        };
        let shrink = |mask: &Mask| Arc::new(Mask(image::resize(&mask.0, small.0, small.1)));
        Ok(ReadSceneOut {
            small: Arc::new(small_picture),
            small_clipped: shrink(&clipped),
            photo: Arc::new(photo),
            clipped: Arc::new(clipped),
            full_depth: Arc::new(full_depth),
            holes: shrink(&holes),
            depth: Arc::new(small_depth),
            small_camera: Arc::new(camera.resized(small.0, small.1)),
            camera: Arc::new(camera),
            ignore: ignore.map_or_else(
                || Arc::new(Mask(Plane::filled(small.0, small.1, 0.0))),
                |mask| shrink(&mask),
            ),
            sunlight: sunlight
                .map_or_else(|| Arc::new(Mask(Plane::new(0, 0, Vec::new()))), |mask| shrink(&mask)),
            mask: Scatter(masks.iter().map(|(id, mask)| (id.clone(), shrink(mask))).collect()),
            full_mask: Scatter(masks.into_iter().map(|(id, mask)| (id, Arc::new(mask))).collect()),
            kind: Scatter(
                self.lights
                    .iter()
                    .map(|(id, light)| (id.clone(), Arc::new(light.kind())))
                    .collect(),
            ),
            encoding: Arc::new(encoding),
        })
    }
}

/// A photo so many times wider than its depth guides the depth to its own size.
const GUIDED: usize = 2;

/// The depth of a scene at its own size.
struct ReadDepth {
    /// Planar depth, holes filled.
    depth: Depth,
    /// 1 where the file has no depth.
    holes: Mask,
    /// Confidence of each number, if the file states it.
    confidence: Option<Plane<f32>>,
    /// Above 0 on panes and what is not part of the room.
    outside: Plane<f32>,
}

impl ReadScene {
    fn shot(&self) -> Shot<'_> {
        let &ReadScene { ref photo, transfer, camera, exposure, long_side, .. } = self;
        Shot { photo, transfer, camera, exposure, long_side }
    }

    /// A mask at the photo's size; one of all pixels is a fault.
    fn any_mask(
        &self,
        ctx: &Context,
        file: &File,
        full: (usize, usize),
    ) -> Result<Mask, NodeError> {
        let mask = open(ctx, file, image::read_mask)?;
        let got = mask.0.size();
        if got != full {
            self.check_aspect("mask", file, got, full)?;
            ctx.warn(format!(
                "{}: {}, resampled to the photo's {}",
                file.path,
                size(got),
                size(full)
            ));
        }
        let mask = if got == full { mask } else { Mask(image::resize(&mask.0, full.0, full.1)) };
        if mask.0.pixels().iter().all(|&m| m >= 1.0) {
            return Err(bad(
                file,
                "mask: wanted some pixels left black, got a mask that covers everything".into(),
            ));
        }
        Ok(mask)
    }

    /// A mask at the photo's size; an empty mask and one of all pixels are faults.
    fn mask(&self, ctx: &Context, file: &File, full: (usize, usize)) -> Result<Mask, NodeError> {
        let mask = self.any_mask(ctx, file, full)?;
        if mask.0.pixels().iter().all(|&m| m <= 0.0) {
            return Err(bad(
                file,
                "mask: wanted white pixels where the light is, got a black picture".into(),
            ));
        }
        Ok(mask)
    }

    /// Planar depth in meters at the depth file's own size.
    fn depth(
        &self,
        ctx: &Context,
        camera: &Camera,
        masks: &[(String, Mask)],
        ignore: Option<&Mask>,
    ) -> Result<ReadDepth, NodeError> {
        let file = &self.depth.path;
        let stored = open(ctx, file, image::read_depth_file)?;
        warn(ctx, file, &stored.notes);
        let (width, height) = stored.values.size();
        self.check_aspect("depth", file, (width, height), (camera.width, camera.height))?;
        if let Some(measure) = stored.measure.filter(|m| *m != self.depth.kind) {
            ctx.warn(format!(
                "{}: the file states {measure:?}, the scene {:?}; in scene.ron: `depth: (.., kind: {measure:?})`",
                file.path, self.depth.kind
            ));
        }
        if let Some(doubt) = normalized(&stored.values)
            .filter(|_| self.depth.kind != DepthKind::Disparity && self.depth.shift == 0.0)
        {
            ctx.warn(format!("{}: {doubt}", file.path));
        }
        let meters = planar(&stored.values, &self.depth, &camera.resized(width, height));

        // The view through a pane, and surfaces outside the room, may be far away: their depth must
        // not spread into the room.
        let is_pane = |id: &str| self.lights.get(id).is_some_and(|l| l.kind() == LightKind::Window);
        let panes = masks.iter().filter(|(id, _)| is_pane(id));
        let mut untrusted = Plane::filled(width, height, 0.0f32);
        for outside in panes.map(|(_, mask)| mask).chain(ignore) {
            let outside = image::resize(&outside.0, width, height);
            untrusted
                .pixels_mut()
                .iter_mut()
                .zip(outside.pixels())
                .for_each(|(u, &m)| *u = u.max(m));
        }
        let (depth, holes) = image::inpaint_depth(&meters, &untrusted).ok_or_else(|| {
            let wanted = format!(
                "at least one depth between {} and {} m",
                image::DEPTH_PLANE.near,
                image::DEPTH_PLANE.far
            );
            bad(file, format!("depth: wanted {wanted}, got holes everywhere; is the scale right?"))
        })?;
        let share =
            holes.0.pixels().iter().filter(|&&h| h > 0.0).count() as f32 / holes.0.len() as f32;
        if share > 0.5 {
            ctx.warn(format!(
                "{}: {:.0} % of the depth are holes; they are filled from the others",
                file.path,
                100.0 * share
            ));
        }
        Ok(ReadDepth { depth, holes, confidence: stored.confidence, outside: untrusted })
    }

    fn check_aspect(
        &self,
        what: &str,
        file: &File,
        got: (usize, usize),
        photo: (usize, usize),
    ) -> Result<(), NodeError> {
        if image::same_aspect(got, photo) {
            return Ok(());
        }
        let wanted = format!("the aspect ratio of {} ({}) to 2 %", self.photo.path, size(photo));
        Err(bad(file, format!("{what} size: wanted {wanted}, got {}", size(got))))
    }
}

/// The value, or `None` after noting the fault of a file, each file's once.
///
/// # Errors
/// Any other error.
fn collect<T>(
    result: Result<T, NodeError>,
    faults: &mut Vec<String>,
) -> Result<Option<T>, NodeError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error @ NodeError::BadFile { .. }) => {
            let fault = error.to_string();
            if !faults.contains(&fault) {
                faults.push(fault);
            }
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// The doubt about numbers that fill 0 to 1 or 0 to 255 exactly, as relative depth does.
fn normalized(stored: &Plane<f32>) -> Option<String> {
    let numbers = stored.pixels().iter().filter(|d| d.is_finite());
    let (least, most) = numbers.fold((f32::MAX, f32::MIN), |(l, m), &d| (l.min(d), m.max(d)));
    (least == 0.0 && [1.0, 255.0].contains(&most)).then(|| {
        format!(
            "its numbers fill 0 to {most} exactly, as relative depth does, and the scene declares \
            distances; in scene.ron: `depth: (.., kind: Disparity, scale: .., shift: ..)`"
        )
    })
}

/// Stored numbers as planar z in meters by the kind, scale and shift of `spec`; holes pass through
/// as holes. `camera` has the depth's size.
pub fn planar(stored: &Plane<f32>, spec: &DepthSpec, camera: &Camera) -> Plane<f32> {
    let (width, height) = stored.size();
    let &DepthSpec { kind, scale, shift, .. } = spec;
    match kind {
        DepthKind::PlanarZ => stored.map(|d| scale * (d + shift)),
        DepthKind::RayLength => Plane::from_fn(width, height, |x, y| {
            let ray: Vec3 = camera.pixel_point(x, y, 1.0);
            scale * (stored.get(x, y) + shift) / ray.length()
        }),
        // A negative disparity stays a hole: its depth is negative.
        DepthKind::Disparity => stored.map(|d| scale / (d + shift)),
    }
}

/// Ids become names of nodes and of EXR layers.
fn check_id(id: &str) -> Result<(), String> {
    let mut letters = id.chars();
    let sound = letters.next().is_some_and(|c| c.is_ascii_alphabetic())
        && letters.all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !sound {
        return Err(format!(
            "lights: wanted a name of letters, digits and _ that starts with a letter, got \"{id}\""
        ));
    }
    if [INV_LAMP, INV_WINDOW, REST].contains(&id) {
        return Err(format!(
            "lights: \"{id}\" names a light that is estimated in every scene; wanted another name"
        ));
    }
    Ok(())
}
