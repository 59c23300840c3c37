//! The equations of gain maps: from a photo and a map to the light of the scene.
//!
//! With g the map in 0..1, ISO 21496-1 and Ultra HDR have the logarithm of the gain
//! L = min + (max - min) g^(1 / gamma), and the scene is
//! (photo + offset_base) 2^L - offset_alternate, all in linear light. Apple's page "Applying Apple
//! HDR effect to your photos" has, with m the map decoded by the curve of Rec. 709 and H the
//! headroom, (1 + (H - 1) m) times the photo.

use glam::{Mat3, Vec3};

use crate::image::io::color_profile::ToRec709;
use crate::image::io::raster::Raster;
use crate::image::{Plane, resize};

/// The largest exponent of a gain that is believed: cameras write 2 to 4.
const MAX_STOPS: f32 = 10.0;
/// Stored numbers from here on are saturated: between 253 and 254 of 255.
const SATURATED: f32 = 253.5 / 255.0;

/// Reason for which a gain map cannot be used.
pub(in crate::image) const OUT_OF_RANGE: &str = "its numbers are not those that a camera writes";
/// Reason for which a gain map cannot be used.
pub(in crate::image) const BASE_IS_HDR: &str = "it darkens a photo that is HDR itself";

/// The numbers of a gain map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::image) enum Gains {
    /// The equation of ISO 21496-1 and Ultra HDR, by channel.
    Logarithmic {
        min: Vec3,
        max: Vec3,
        gamma: Vec3,
        offset_base: Vec3,
        offset_alternate: Vec3,
        /// The channels are those of the map's own color profile, and not those of the photo's.
        by_map_profile: bool,
    },
    /// Apple's equation: the largest gain.
    Headroom(f32),
}

/// Gains, or the reason for which they cannot be used.
pub(in crate::image) type GainsOrReason = Result<Gains, &'static str>;

impl Gains {
    /// The same gains, if they are those that a camera would write.
    ///
    /// # Errors
    /// A number is out of range.
    pub(in crate::image) fn checked(self) -> GainsOrReason {
        let is_sensible = match self {
            Gains::Logarithmic { min, max, gamma, offset_base, offset_alternate, .. } => {
                let numbers = [min, max, gamma, offset_base, offset_alternate];
                numbers.iter().all(|numbers| numbers.is_finite())
                    && min.abs().max(max.abs()).max_element() <= MAX_STOPS
                    && min.cmple(max).all()
                    && gamma.min_element() > 1e-3
                    && gamma.max_element() < 1e3
                    && offset_base.abs().max(offset_alternate.abs()).max_element() <= 1.0
            }
            Gains::Headroom(headroom) => headroom > 1.0 && headroom <= MAX_STOPS.exp2(),
        };
        if is_sensible { Ok(self) } else { Err(OUT_OF_RANGE) }
    }

    /// The light of the scene for the linear light `pixel` of the photo, in the channels of the
    /// gains, where the map has the stored numbers `stored`, 0..1.
    fn light(&self, pixel: Vec3, stored: Vec3) -> Vec3 {
        match *self {
            Gains::Logarithmic { min, max, gamma, offset_base, offset_alternate, .. } => {
                let g = Vec3::from_array(std::array::from_fn(|c| stored[c].powf(gamma[c].recip())));
                let stops = min + (max - min) * g;
                let gain = Vec3::from_array(stops.to_array().map(f32::exp2));
                ((pixel + offset_base) * gain - offset_alternate).max(Vec3::ZERO)
            }
            Gains::Headroom(headroom) => pixel * (1.0 + (headroom - 1.0) * rec_709(stored.x)),
        }
    }

    /// Brightens a picture to the light of the scene: `picture` is linear in the photo's own
    /// channels, which `base` converts to Rec. 709. A pixel is saturated no more where the map has
    /// a gain for it below its largest number.
    ///
    /// # Errors
    /// The map's color profile cannot be used.
    pub(in crate::image) fn apply(
        &self,
        map: &Raster,
        base: Option<&ToRec709>,
        picture: &mut Plane<Vec3>,
        clipped: &mut Plane<f32>,
    ) -> Result<(), String> {
        let by_map_profile = matches!(self, Gains::Logarithmic { by_map_profile: true, .. });
        let channels = match &map.profile {
            Some(icc) if by_map_profile => Some(between(base, ToRec709::new(icc)?.as_ref())?),
            _ => None,
        };
        let stored = resize(&map.colors(|v| v), picture.width(), picture.height());
        let pixels = picture.pixels_mut().iter_mut().zip(clipped.pixels_mut()).zip(stored.pixels());
        for ((pixel, clipped), &stored) in pixels {
            *pixel = match channels {
                Some((to, from)) => from * self.light(to * *pixel, stored),
                None => self.light(*pixel, stored),
            };
            if stored.max_element() < SATURATED {
                *clipped = 0.0;
            }
        }
        Ok(())
    }
}

/// The matrices from linear light in the channels of `base` to those of `map` and back; `None` is
/// Rec. 709.
///
/// # Errors
/// The channels of the map are not independent.
fn between(base: Option<&ToRec709>, map: Option<&ToRec709>) -> Result<(Mat3, Mat3), String> {
    let matrix = |profile: Option<&ToRec709>| profile.map_or(Mat3::IDENTITY, |p| p.matrix);
    let to = matrix(map).inverse() * matrix(base);
    let from = to.inverse();
    let is_sound = to.is_finite() && from.is_finite();
    if is_sound { Ok((to, from)) } else { Err("its color profile is damaged".into()) }
}

/// From a stored number, 0..1, to linear: the inverse of the curve of ITU-R BT.709-6, item 1.2.
fn rec_709(stored: f32) -> f32 {
    if stored < 0.081 { stored / 4.5 } else { ((stored + 0.099) / 1.099).powf(1.0 / 0.45) }
}
