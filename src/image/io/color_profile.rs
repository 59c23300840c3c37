//! The ICC profile of a photo: from its stored numbers to linear Rec. 709.
//!
//! Profiles are those of ICC.1:2022. A display profile has a curve per channel and the tristimulus
//! values of its primaries under D50. With M the matrix of these for the photo and S that of sRGB,
//! linear Rec. 709 is S^-1 M times the linear channels; each row is scaled so that white stays
//! white.

use glam::{Mat3, Vec3};
use moxcms::{ColorProfile, DataColorSpace, ProfileText, ToneReprCurve, Xyzd};

use crate::image::Transfer;

/// Difference from sRGB, linear, that is within the rounding of profiles: half a step of 8 bits at
/// white.
const SAME: f32 = 0.004;
/// Numbers for which the curves are compared with that of sRGB.
const COMPARED: usize = 256;
/// Most characters of a profile's name.
const MAX_NAME: usize = 64;

/// The conversion of a photo whose colors are not those of sRGB.
pub(in crate::image) struct ToRec709 {
    /// By channel, the curve to linear light.
    curves: [Box<dyn Fn(f32) -> f32>; 3],
    /// From linear light in the photo's channels to linear Rec. 709.
    pub(in crate::image) matrix: Mat3,
    /// The profile's own name.
    pub(in crate::image) name: String,
}

impl ToRec709 {
    /// The conversion by an ICC profile; `None` where it is that of sRGB, or of a photo that is not
    /// RGB.
    ///
    /// # Errors
    /// The profile is damaged, or is not made of curves and a matrix.
    pub(in crate::image) fn new(icc: &[u8]) -> Result<Option<ToRec709>, String> {
        let profile = ColorProfile::new_from_slice(icc)
            .map_err(|e| format!("its color profile is damaged ({e})"))?;
        if profile.color_space != DataColorSpace::Rgb {
            return Ok(None);
        }
        let name = name(&profile);
        let tables = || format!("its color profile \"{name}\" has tables in place of a matrix");
        let curve = |curve: &Option<ToneReprCurve>| {
            let curve = curve.as_ref().ok_or_else(tables)?.make_linear_evaluator();
            let curve = curve.map_err(|e| format!("its color profile is damaged ({e})"))?;
            Ok::<_, String>(Box::new(move |v| curve.evaluate_value(v)) as Box<dyn Fn(f32) -> f32>)
        };
        let curves =
            [curve(&profile.red_trc)?, curve(&profile.green_trc)?, curve(&profile.blue_trc)?];
        let matrix = primaries(&ColorProfile::new_srgb()).inverse() * primaries(&profile);
        let white = matrix * Vec3::ONE;
        let matrix = Mat3::from_diagonal(white.recip()) * matrix;
        let curves_are_finite = curves.iter().all(|curve| steps().all(|v| curve(v).is_finite()));
        if !matrix.is_finite() || !curves_are_finite {
            return Err(format!("its color profile \"{name}\" is damaged"));
        }
        let off_curve = |curve: &dyn Fn(f32) -> f32| {
            steps().map(|v| (curve(v) - Transfer::Srgb.decode(v)).abs()).fold(0.0, f32::max)
        };
        let off_matrix = (matrix - Mat3::IDENTITY).to_cols_array();
        let is_srgb = curves.iter().all(|curve| off_curve(curve) <= SAME)
            && off_matrix.iter().all(|off| off.abs() <= SAME);
        Ok((!is_srgb).then_some(ToRec709 { curves, matrix, name }))
    }

    /// The curve of each channel at 0..=`top` of `top`.
    pub(in crate::image) fn tables(&self, top: usize) -> [Vec<f32>; 3] {
        let table = |curve: &dyn Fn(f32) -> f32| {
            (0..=top).map(|v| curve(v as f32 / top as f32)).collect::<Vec<f32>>()
        };
        self.curves.each_ref().map(|curve| table(curve))
    }

    /// Linear Rec. 709 of linear light in the photo's channels; what lies outside of its gamut
    /// loses its negative parts.
    pub(in crate::image) fn convert(&self, linear: Vec3) -> Vec3 {
        (self.matrix * linear).max(Vec3::ZERO)
    }
}

fn steps() -> impl Iterator<Item = f32> {
    (0..COMPARED).map(|i| i as f32 / (COMPARED - 1) as f32)
}

/// Tristimulus values of red, green and blue as columns.
fn primaries(profile: &ColorProfile) -> Mat3 {
    let column = |c: &Xyzd| Vec3::new(c.x as f32, c.y as f32, c.z as f32);
    Mat3::from_cols(
        column(&profile.red_colorant),
        column(&profile.green_colorant),
        column(&profile.blue_colorant),
    )
}

fn name(profile: &ColorProfile) -> String {
    let text = match &profile.description {
        Some(ProfileText::PlainString(text)) => text,
        Some(ProfileText::Localizable(texts)) => texts.first().map_or("", |text| &text.value),
        Some(ProfileText::Description(text)) => &text.ascii_string,
        None => "",
    };
    text.trim_matches('\0').trim().chars().take(MAX_NAME).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{NamedBytes, Photo, read_photo};
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::codecs::png::PngEncoder;
    use ::image::{ExtendedColorType, ImageEncoder};

    const COLOR: [u8; 3] = [200, 120, 60];

    fn read(file: &[u8]) -> Photo {
        read_photo(NamedBytes::new("photo", file), Transfer::Srgb).expect("it is sound")
    }

    fn pixels() -> Vec<u8> {
        COLOR.repeat(16 * 16)
    }

    fn encoded(mut encoder: impl ImageEncoder, profile: Option<&ColorProfile>) {
        if let Some(profile) = profile {
            let icc = profile.encode().expect("it has a form");
            encoder.set_icc_profile(icc).expect("the format has profiles");
        }
        encoder
            .write_image(&pixels(), 16, 16, ExtendedColorType::Rgb8)
            .expect("memory can be written to");
    }

    fn png(profile: Option<&ColorProfile>) -> Vec<u8> {
        let mut file = Vec::new();
        encoded(PngEncoder::new(&mut file), profile);
        file
    }

    fn jpeg(profile: Option<&ColorProfile>) -> Vec<u8> {
        let mut file = Vec::new();
        encoded(JpegEncoder::new_with_quality(&mut file, 100), profile);
        file
    }

    /// The matrices are those that Lindbloom's page and CSS Color 4 print for these spaces.
    #[test]
    fn wide_gamuts_become_rec_709() {
        let linear = |v: u8| Transfer::Srgb.decode(f32::from(v) / 255.0);
        let p3 = Vec3::new(linear(COLOR[0]), linear(COLOR[1]), linear(COLOR[2]));
        let from_p3 = Mat3::from_cols(
            Vec3::new(1.224_94, -0.042_057, -0.019_638),
            Vec3::new(-0.224_94, 1.042_057, -0.078_636),
            Vec3::new(0.0, 0.0, 1.098_274),
        );
        let adobe = Vec3::from_array(COLOR.map(|v| (f32::from(v) / 255.0).powf(2.199_22)));
        let from_adobe = Mat3::from_cols(
            Vec3::new(1.398_36, 0.0, 0.0),
            Vec3::new(-0.398_36, 1.0, -0.042_93),
            Vec3::new(0.0, 0.0, 1.042_93),
        );
        for (profile, wanted) in [
            (ColorProfile::new_display_p3(), from_p3 * p3),
            (ColorProfile::new_adobe_rgb(), from_adobe * adobe),
        ] {
            for (file, tolerance) in [(png(Some(&profile)), 1.0), (jpeg(Some(&profile)), 2.0)] {
                let got = read(&file).picture.0.get(8, 8);
                let off = (got - wanted).abs().max_element();
                assert!(off < tolerance / 255.0, "{got}, wanted {wanted}");
            }
        }
    }

    #[test]
    fn srgb_and_a_missing_profile_give_the_same_bits() {
        let srgb = ColorProfile::new_srgb();
        for (with, without) in [(png(Some(&srgb)), png(None)), (jpeg(Some(&srgb)), jpeg(None))] {
            assert!(with.len() > without.len(), "the profile is there");
            assert_eq!(read(&with).picture, read(&without).picture);
        }
    }

    #[test]
    fn white_and_gray_stay_neutral() {
        let icc = ColorProfile::new_pro_photo_rgb().encode().expect("it has a form");
        let profile = ToRec709::new(&icc).expect("it is sound").expect("it is not sRGB");
        let tables = profile.tables(255);
        for level in [40, 128, 255] {
            let gray = profile.convert(Vec3::from_array(tables.each_ref().map(|t| t[level])));
            assert!(gray.max_element() - gray.min_element() < 1e-3, "{level}: {gray}");
        }
    }

    #[test]
    fn a_damaged_profile_is_told_and_left_out() {
        let mut file = Vec::new();
        let mut encoder = PngEncoder::new(&mut file);
        encoder.set_icc_profile(b"not a profile".to_vec()).expect("the format has profiles");
        encoder
            .write_image(&pixels(), 16, 16, ExtendedColorType::Rgb8)
            .expect("memory can be written to");
        let photo = read(&file);
        assert_eq!(photo.picture, read(&png(None)).picture);
        assert!(photo.warnings[0].contains("its color profile is damaged"), "{:?}", photo.warnings);
    }
}
