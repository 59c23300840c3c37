//! The field of view of a photo by the lens that its EXIF block describes.

use super::Camera;
use crate::image::{PhotoHeader, same_aspect};

/// Diagonal of a frame of 36 x 24 mm, millimeters: `FocalLengthIn35mmFilm` compares diagonals
/// (CIPA DCG-001-2005).
const FULL_FRAME_DIAGONAL: f32 = 43.266_6;
/// The field of view along the longer side that a photo without facts gets, degrees: the main
/// camera of phones, 26 mm, has 67 in photos of 4:3.
const USUAL_DEGREES: f32 = 65.0;
/// Fields of view along the longer side that a rectilinear lens has, degrees.
const SENSIBLE_DEGREES: std::ops::RangeInclusive<f32> = 3.0..=150.0;

/// The origin of a field of view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldOfViewSource {
    /// A person stated it.
    Stated,
    /// EXIF `FocalLengthIn35mmFilm`, millimeters.
    Equivalent(f32),
    /// EXIF `FocalLength` and the width of the sensor, millimeters.
    Sensor(f32, f32),
    /// No fact: 65 degrees along the longer side.
    Assumed,
}

/// A field of view and its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOfView {
    /// Horizontal field of view of the upright photo, degrees.
    pub degrees: f32,
    /// The origin of the number.
    pub source: FieldOfViewSource,
    /// The size that the camera recorded, columns and rows, where the photo has another aspect
    /// ratio. It is then taken as cut out of the middle of that picture.
    pub cut_from: Option<(usize, usize)>,
}

impl FieldOfView {
    /// A field of view that a person states, degrees.
    pub fn stated(degrees: f32) -> Self {
        Self { degrees, source: FieldOfViewSource::Stated, cut_from: None }
    }
}

/// The horizontal field of view of a photo with square pixels whose center is on the axis.
///
/// With F the focal length, d the diagonal of the recorded picture in pixels: f = d F / 43.27 mm
/// for an equivalent F, else f = F times pixels per millimeter of the sensor, and the field of view
/// is 2 atan(width / 2 f). A photo of the recorded aspect ratio is the recorded picture at another
/// size; one of another aspect ratio is a part of it, at its size unless it is larger.
pub fn field_of_view(photo: &PhotoHeader) -> FieldOfView {
    let lens = &photo.lens;
    let (width, height) = photo.size;
    // Programs that turn the pixels upright often keep the numbers of the lying picture.
    let recorded =
        lens.recorded.map(|(w, h)| if (w < h) == (width < height) { (w, h) } else { (h, w) });
    let cut_from = recorded.filter(|recorded| !same_aspect(*recorded, photo.size));
    let (recorded_width, recorded_height) = recorded.unwrap_or(photo.size);
    let ratio = |size: usize, recorded: usize| size as f32 / recorded.max(1) as f32;
    let shrink = match cut_from {
        None => ratio(width, recorded_width),
        Some((w, h)) => ratio(width, w).max(ratio(height, h)).max(1.0),
    };
    let diagonal = (recorded_width as f32).hypot(recorded_height as f32);
    let equivalent = lens.equivalent_mm.map(|mm| {
        (mm / FULL_FRAME_DIAGONAL * diagonal * shrink, FieldOfViewSource::Equivalent(mm))
    });
    // Without the recorded size, the resolution of the sensor says nothing about this photo.
    let sensor = lens.focal_mm.zip(lens.pixels_per_mm).zip(recorded).map(|((mm, pixels), _)| {
        let sensor_mm = recorded_width.max(recorded_height) as f32 / pixels;
        (mm * pixels * shrink, FieldOfViewSource::Sensor(mm, sensor_mm))
    });
    let longer = width.max(height) as f32;
    let is_sensible =
        |(focal, _): &(f32, FieldOfViewSource)| SENSIBLE_DEGREES.contains(&angle(longer, *focal));
    let found = equivalent.filter(is_sensible).or(sensor.filter(is_sensible));
    let (focal, source) = found.unwrap_or_else(|| {
        let camera = Camera::from_fov_x(width.max(height), 1, USUAL_DEGREES);
        (camera.fx, FieldOfViewSource::Assumed)
    });
    let cut_from = cut_from.filter(|_| found.is_some());
    FieldOfView { degrees: angle(width as f32, focal), source, cut_from }
}

/// The angle under which `size` pixels appear, degrees, at a focal length in pixels.
fn angle(size: f32, focal: f32) -> f32 {
    2.0 * (0.5 * size / focal).atan().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Lens;

    fn photo(size: (usize, usize), lens: Lens) -> PhotoHeader {
        PhotoHeader { size, lens, ..PhotoHeader::default() }
    }

    /// Computed by hand: 26 mm on 36 x 24 mm has a diagonal field of view of 79.5 degrees; the
    /// longer side of 4:3 is 0.8 of the diagonal.
    #[test]
    fn an_equivalent_focal_length_compares_diagonals() {
        let lens = Lens { equivalent_mm: Some(26.0), ..Lens::default() };
        let lying = field_of_view(&photo((4000, 3000), lens.clone()));
        let wanted = 2.0 * (0.8f32 * 43.2666 / 2.0 / 26.0).atan().to_degrees();
        assert!((lying.degrees - wanted).abs() < 1e-3, "{lying:?}, wanted {wanted}");
        assert!((lying.degrees - 67.3).abs() < 0.1);
        assert_eq!(lying.source, FieldOfViewSource::Equivalent(26.0));
        let upright = field_of_view(&photo((3000, 4000), lens));
        assert!((upright.degrees - 53.1).abs() < 0.1, "{upright:?}");
    }

    /// A full-frame camera: 24 mm on 36 mm of 6000 pixels.
    #[test]
    fn a_focal_length_and_a_sensor_are_enough() {
        let lens = Lens {
            focal_mm: Some(24.0),
            pixels_per_mm: Some(6000.0 / 36.0),
            recorded: Some((6000, 4000)),
            ..Lens::default()
        };
        for size in [(6000, 4000), (1500, 1000)] {
            let found = field_of_view(&photo(size, lens.clone()));
            assert!((found.degrees - 73.74).abs() < 0.01, "{found:?}");
            assert_eq!(
                (found.source, found.cut_from),
                (FieldOfViewSource::Sensor(24.0, 36.0), None)
            );
        }
    }

    #[test]
    fn a_cut_photo_sees_less() {
        let lens =
            Lens { equivalent_mm: Some(26.0), recorded: Some((4000, 3000)), ..Lens::default() };
        let whole = field_of_view(&photo((2000, 1500), lens.clone()));
        assert!((whole.degrees - 67.3).abs() < 0.1 && whole.cut_from.is_none(), "{whole:?}");
        let cut = field_of_view(&photo((2000, 2000), lens));
        assert!((cut.degrees - 36.8).abs() < 0.1, "{cut:?}");
        assert_eq!(cut.cut_from, Some((4000, 3000)));
    }

    #[test]
    fn numbers_that_no_lens_has_are_not_taken() {
        for mm in [1e-3, 1e9] {
            let lens = Lens { equivalent_mm: Some(mm), ..Lens::default() };
            let found = field_of_view(&photo((4000, 3000), lens));
            assert_eq!(found.source, FieldOfViewSource::Assumed);
            assert!((found.degrees - 65.0).abs() < 1e-3, "{found:?}");
        }
        let upright = field_of_view(&photo((3000, 4000), Lens::default()));
        assert!((upright.degrees - 51.1).abs() < 0.1, "65 degrees are along the longer side");
    }
}
