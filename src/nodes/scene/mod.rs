//! Stages that read the files of a scene, and known lights and materials.

pub mod mesh;
pub mod read_lights;
pub mod read_materials;
pub mod read_photo;
pub mod read_scene;
pub mod room_box;

use serde::{Deserialize, Serialize};

use crate::geometry::Camera;
use crate::graph::{Context, File, NodeError, check_range};
use crate::image::{self, Bits, Mask, NamedBytes, Picture, ReadError, Transfer};
use crate::nodes::artifacts::Encoding;
use crate::tuning::Table;

/// The viewpoint of the photo: the camera stands at the origin and looks along -z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum CameraSpec {
    /// Horizontal field of view in degrees; square pixels, centered.
    FovX(f32),
    /// Focal lengths and principal point in photo pixels.
    Pinhole {
        /// Horizontal focal length.
        fx: f32,
        /// Vertical focal length.
        fy: f32,
        /// Column coordinate of the principal point.
        cx: f32,
        /// Row coordinate of the principal point.
        cy: f32,
    },
}

/// The photo's exposure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Exposure {
    /// The illuminance, in lux, at which a white surface shows 1.
    Lux(f32),
}

/// The parameters of a photo that all who read it share.
struct Shot<'a> {
    photo: &'a File,
    transfer: Transfer,
    camera: CameraSpec,
    exposure: Option<Exposure>,
    long_side: u32,
}

/// A photo as it was read.
struct Photograph {
    /// Linear, the photo's size.
    photo: Picture,
    /// 1 where it is saturated.
    clipped: Mask,
    /// Columns and rows of the working size.
    small: (usize, usize),
    /// At the photo's size.
    camera: Camera,
    encoding: Encoding,
}

impl Shot<'_> {
    fn check(&self) -> Result<(), String> {
        if self.photo.path.is_empty() {
            return Err("photo: wanted a file, got none".into());
        }
        if let Transfer::Gamma(gamma) = self.transfer {
            check_range("transfer: Gamma", &gamma, Transfer::GAMMA)?;
        }
        match self.camera {
            CameraSpec::FovX(degrees) => {
                check_range("camera: FovX", &degrees, 1.0..=175.0).map_err(|e| match degrees {
                    0.02..1.0 => {
                        format!("{e} degrees; radians? Write `{:.0}`", degrees.to_degrees())
                    }
                    _ => e,
                })?;
            }
            CameraSpec::Pinhole { fx, fy, cx, cy } => {
                for (name, focal) in [("camera: fx", fx), ("camera: fy", fy)] {
                    check_range(name, &focal, 1e-3..=1e6)?;
                }
                for (name, center) in [("camera: cx", cx), ("camera: cy", cy)] {
                    check_range(name, &center, -1e6..=1e6)?;
                }
            }
        }
        if let Some(Exposure::Lux(lux)) = self.exposure {
            check_range("exposure: Lux", &lux, 1e-6..=1e9)?;
        }
        Ok(())
    }

    fn read(&self, ctx: &Context) -> Result<Photograph, NodeError> {
        let read = open(ctx, self.photo, |source| image::read_photo(source, self.transfer))?;
        warn(ctx, self.photo, &read.warnings);
        let (width, height) = read.picture.0.size();
        let camera = match self.camera {
            CameraSpec::FovX(degrees) => Camera::from_fov_x(width, height, degrees),
            CameraSpec::Pinhole { fx, fy, cx, cy } => Camera { width, height, fx, fy, cx, cy },
        };
        Ok(Photograph {
            photo: read.picture,
            clipped: read.clipped,
            small: image::fit(width, height, self.long_side as usize),
            camera,
            encoding: Encoding {
                transfer: self.transfer,
                lux: self.exposure.map(|Exposure::Lux(lux)| lux),
                sixteen_bit: read.bits == Bits::Sixteen,
                exif: read.exif,
            },
        })
    }
}

/// A picture file through one of the readers of `image`.
fn open<T>(
    ctx: &Context,
    file: &File,
    read: impl FnOnce(NamedBytes) -> Result<T, ReadError>,
) -> Result<T, NodeError> {
    let bytes = ctx.read(file)?;
    let name = file.location().display().to_string();
    read(NamedBytes::new(&name, &bytes)).map_err(|e| bad(file, e.message()))
}

fn bad(file: &File, message: String) -> NodeError {
    NodeError::BadFile { path: file.location().display().to_string(), message }
}

fn warn(ctx: &Context, file: &File, warnings: &[String]) {
    warnings.iter().for_each(|warning| ctx.warn(format!("{}: {warning}", file.path)));
}

fn size((width, height): (usize, usize)) -> String {
    format!("{width} x {height}")
}

/// The constants of the checks of files.
pub fn tuning() -> Vec<Table> {
    vec![
        read_lights::ReadLightsTuning::table(),
        read_materials::ReadMaterialsTuning::table(),
        room_box::RoomBoxTuning::table(),
    ]
}
