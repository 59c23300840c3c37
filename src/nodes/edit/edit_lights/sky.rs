//! The sky, ground and sun of a window that an edit opens.

use std::sync::Arc;

use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::level;
use crate::graph::{Context, File, NodeError, above, check_range};
use crate::image::{NamedBytes, Picture, Transfer, read_photo};
use crate::optics::{Daylight, Heading, Lobe, Radiance, Shape, Window, fit_window_model};
use crate::tuning::tuning;

/// Radiance of a window above the horizon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Sky {
    /// Linear RGB in units of the photo.
    Radiance(f32, f32, f32),
    /// A picture of all directions, equirectangular: HDR or EXR, its values in units of the photo.
    /// It holds sky, ground and sun.
    Env(File),
    /// A clear sky over gray earth, 1.7..=10: 2 is very clear air, 6 haze. Needs a `sun`, for its
    /// height.
    Turbidity(f32),
}

impl Default for Sky {
    /// Overcast.
    fn default() -> Sky {
        Sky::Radiance(4.0, 4.4, 5.0)
    }
}

/// Radiance of a window below the horizon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Half {
    /// Linear RGB in units of the photo.
    Radiance(f32, f32, f32),
}

impl Half {
    fn rgb(&self) -> Vec3 {
        let Half::Radiance(r, g, b) = *self;
        Vec3::new(r, g, b)
    }
}

/// The sun in a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Sun {
    /// Degrees: azimuth from the view direction towards the right, elevation above the horizon.
    Direction {
        azimuth: f32,
        elevation: f32,
        /// Peak radiance; when not given, that of the sky's own sun, or where it has none such that
        /// a white surface facing the sun shows 3.
        #[serde(default)]
        radiance: Option<[f32; 3]>,
        /// 1e4 is a sun of about one degree.
        #[serde(default = "Sun::bandwidth")]
        bandwidth: f32,
    },
}

impl Sun {
    fn bandwidth() -> f32 {
        TUNING.sun_bandwidth
    }

    fn direction(&self, up: Vec3) -> Vec3 {
        let Sun::Direction { azimuth, elevation, .. } = self;
        let (right, ahead) = level(up);
        let (sin_a, cos_a) = azimuth.to_radians().sin_cos();
        let (sin_e, cos_e) = elevation.to_radians().sin_cos();
        (right * sin_a + ahead * cos_a) * cos_e + up * sin_e
    }
}

/// The surroundings of a window.
pub struct Environment<'a> {
    /// Above the horizon, or everywhere.
    pub sky: &'a Sky,
    /// Below the horizon.
    pub ground: Option<&'a Half>,
    /// The sun.
    pub sun: Option<&'a Sun>,
    /// Turn of a picture of the sky to the right of the view, degrees.
    pub yaw: f32,
    /// Factor of the radiance of a picture or a clear sky.
    pub scale: f32,
}

impl Environment<'_> {
    /// Checks all numbers, and that its parts go together.
    ///
    /// # Errors
    /// The first rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        match self.sky {
            Sky::Radiance(r, g, b) => check_range("sky", &[*r, *g, *b], 0.0..)?,
            Sky::Env(_) => {}
            Sky::Turbidity(turbidity) => {
                check_range("sky: turbidity", turbidity, 1.7..=10.0)?;
                match self.sun {
                    Some(Sun::Direction { elevation, .. }) => {
                        check_range(
                            "sun elevation (degrees) of a clear sky",
                            elevation,
                            above(0.0),
                        )?;
                    }
                    None => {
                        return Err(
                            "sky: Turbidity needs `sun: Direction(azimuth: .., elevation: ..)`"
                                .into(),
                        );
                    }
                }
            }
        }
        check_range("scale", &self.scale, 0.0..)?;
        if !matches!(self.sky, Sky::Env(_)) && self.yaw != 0.0 {
            return Err("yaw rotates a picture of the sky: it requires sky: Env(..)".into());
        }
        if matches!(self.sky, Sky::Radiance(..)) && self.scale != 1.0 {
            return Err(
                "scale requires sky: Env(..) or Turbidity(..); a Radiance has its own scale".into(),
            );
        }
        check_range("ground", &self.ground.map(|ground| ground.rgb().to_array()), 0.0..)?;
        if let Some(Sun::Direction { elevation, radiance, bandwidth, .. }) = self.sun {
            check_range("sun radiance", radiance, 0.0..)?;
            check_range("sun bandwidth", bandwidth, 0.0..)?;
            check_range("sun elevation (degrees)", elevation, -90.0..=90.0)?;
        }
        Ok(())
    }

    /// `window` before these surroundings, and the radiances of its lobes. A sky of one radiance
    /// alone is even, without horizon; sky and ground are broad lobes above and below the window's
    /// outward direction. `lux` is the illuminance at which white shows 1.
    ///
    /// # Errors
    /// A picture of the sky cannot be used.
    pub fn through(
        &self,
        id: &str,
        mut window: Window,
        up: Vec3,
        lux: &dyn Fn() -> f32,
        ctx: &Context,
    ) -> Result<(Shape, Radiance), NodeError> {
        let outside = window.y.cross(window.x).normalize();
        let towards = |up: Vec3| (up + outside).try_normalize().unwrap_or(outside);
        let broad = |up: Vec3, bandwidth: f32| Lobe { direction: towards(up), bandwidth };
        let ahead = level(up).1;
        // Weight of the sky's own sun by unit of bandwidth: a lobe of bandwidth b and weight w
        // gives a facing white surface 2 w / b.
        let mut own_sun = Vec3::ZERO;
        let (mut lobes, mut radiance) = match self.sky {
            Sky::Radiance(r, g, b) => {
                let bandwidth = if self.ground.is_some() { TUNING.broad_bandwidth } else { 0.0 };
                let sun = broad(up, Sun::bandwidth());
                (
                    [sun, broad(up, bandwidth), broad(-up, bandwidth)],
                    [Vec3::ZERO, Vec3::new(*r, *g, *b), Vec3::ZERO],
                )
            }
            Sky::Env(file) => {
                let picture = picture(file, ctx)?;
                let turned = Quat::from_axis_angle(up, -self.yaw.to_radians()) * ahead;
                let model =
                    fit_window_model(&picture.0, Heading { up, ahead: turned }, outside, true);
                let message = format!(
                    "light {id:?}: three lobes move {:.0} % of the light of {} through this window to other \
                    directions than in the picture",
                    100.0 * model.misplaced,
                    file.path
                );
                if model.misplaced > TUNING.max_misplaced {
                    ctx.warn(message)
                } else {
                    ctx.note(message)
                }
                own_sun = model.radiance[0] / model.lobes[0].bandwidth;
                (model.lobes, model.radiance)
            }
            Sky::Turbidity(turbidity) => {
                let sun = self.sun.map_or(up, |sun| sun.direction(up));
                let day = Daylight { turbidity: f64::from(*turbidity), sun: sun.as_dvec3() };
                let (lux, heading) = (f64::from(lux()), Heading { up, ahead });
                let model =
                    fit_window_model(&day.surrounding(heading, lux), heading, outside, false);
                own_sun = (0.5 * day.sun_lux(up.as_dvec3()) / lux).as_vec3();
                ctx.note(format!(
                    "light {id:?}: three lobes move {:.0} % of the light of this clear sky through the window to \
                    other directions than in the sky",
                    100.0 * model.misplaced
                ));
                (model.lobes, model.radiance)
            }
        };
        radiance = radiance.map(|w| w * self.scale);
        own_sun *= self.scale;
        if let Some(ground) = self.ground {
            lobes[2] = broad(-up, TUNING.broad_bandwidth);
            radiance[2] = ground.rgb();
        }
        if let Some(sun @ Sun::Direction { radiance: given, bandwidth, .. }) = self.sun {
            lobes[0] = Lobe { direction: sun.direction(up), bandwidth: *bandwidth };
            let usual = if own_sun.max_element() > 0.0 {
                own_sun
            } else {
                Vec3::from_array(TUNING.usual_sun)
            };
            radiance[0] = given.map_or(usual * bandwidth.max(1.0), Vec3::from_array);
        }
        window.lobes = lobes;
        Ok((Shape::Window(window), Radiance(radiance.to_vec())))
    }
}

tuning! {
    /// Constants of the surroundings of an inserted window.
    pub const TUNING: SkyTuning {
        /// Bandwidth of a sun whose edit names none, of about one degree.
        sun_bandwidth: f32 = 1e4,
            unit "1", source Taste, effect "a larger value makes sharper shadows";
        /// Bandwidth of sky and ground where they have radiances of their own.
        broad_bandwidth: f32 = 1.5,
            unit "1", source Taste, effect "a larger value separates sky and ground more";
        /// Radiance over bandwidth of a sun whose edit and sky name none: a white surface that
        /// faces it shows about 3.
        usual_sun: [f32; 3] = [1.5, 1.41, 1.23],
            unit "units of the photo", source Taste, effect "a larger value brightens such suns";
        /// Fraction of a picture's light in other directions than its three lobes above which a
        /// person is warned.
        max_misplaced: f64 = 0.4,
            unit "1", source Taste, effect "a larger value warns less often; no picture changes";
    }
}

/// A picture of all directions; decoded once for all frames.
fn picture(file: &File, ctx: &Context) -> Result<Arc<Picture>, NodeError> {
    ctx.shared(file, "sky", |bytes| {
        let path = file.location().display().to_string();
        let bad = |message: String| NodeError::BadFile { path: path.clone(), message };
        let photo = read_photo(NamedBytes::new(&path, &bytes), Transfer::Srgb)
            .map_err(|e| bad(e.message()))?;
        let (width, height) = photo.picture.0.size();
        if width != 2 * height {
            return Err(bad(format!(
                "wanted an equirectangular picture, twice as wide as high, got {width} x {height}"
            )));
        }
        Ok(photo.picture)
    })
}
