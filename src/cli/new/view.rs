//! The camera of a new scene, and its origin in words.

use std::fmt::Write as _;

use relight::geometry::{Camera, FieldOfView, FieldOfViewSource, field_of_view};
use relight::image::{Intrinsics, PhotoHeader, same_aspect};

/// The camera of a photo as `scene.ron` states it.
pub struct View {
    /// The camera at the photo's size.
    pub camera: Camera,
    /// The value of the field `camera`.
    pub ron: String,
    /// The meaning of its numbers.
    pub meaning: &'static str,
    /// The origin of its numbers.
    pub origin: String,
    /// The photo says nothing about its lens.
    pub is_guess: bool,
}

impl View {
    /// The camera by a stated field of view in degrees, else by EXIF, else a guess.
    pub fn of_lens(photo: &PhotoHeader, fov: Option<f32>) -> View {
        let view = fov.map_or_else(|| field_of_view(photo), FieldOfView::stated);
        let (width, height) = photo.size;
        View {
            camera: Camera::from_fov_x(width, height, view.degrees),
            ron: format!("FovX({:.2})", view.degrees),
            meaning: "The horizontal field of view in degrees",
            origin: origin(&view, photo),
            is_guess: view.source == FieldOfViewSource::Assumed,
        }
    }

    /// The camera that a capture states, scaled to the photo.
    ///
    /// # Errors
    /// The capture states it for pictures of another shape.
    pub fn of_capture(photo: &PhotoHeader, stated: &Intrinsics) -> Result<View, String> {
        let (width, height) = photo.size;
        let of = (stated.width.round() as usize, stated.height.round() as usize);
        if !same_aspect(of, photo.size) {
            return Err(format!(
                "camera: wanted the aspect ratio of the photo ({width} x {height}) to 2 %, got {} x {}",
                of.0, of.1
            ));
        }
        let &Intrinsics { fx, fy, cx, cy, .. } = stated;
        let camera = Camera { width: of.0, height: of.1, fx, fy, cx, cy }.resized(width, height);
        let Camera { fx, fy, cx, cy, .. } = camera;
        Ok(View {
            camera,
            ron: format!("Pinhole(fx: {fx:.2}, fy: {fy:.2}, cx: {cx:.2}, cy: {cy:.2})"),
            meaning: "The focal lengths and the principal point in pixels of the photo",
            origin: "the capture's own".into(),
            is_guess: false,
        })
    }
}

/// The origin of a field of view in words.
fn origin(view: &FieldOfView, photo: &PhotoHeader) -> String {
    let camera = photo.lens.camera.as_deref().unwrap_or("the camera");
    let mut text = match view.source {
        FieldOfViewSource::Stated => "stated by --fov".into(),
        FieldOfViewSource::Equivalent(mm) => {
            format!("EXIF of {camera}, {mm:.0} mm on 35 mm film by the diagonal")
        }
        FieldOfViewSource::Sensor(focal, sensor) => {
            format!("EXIF of {camera}, {focal:.1} mm on a sensor of {sensor:.1} mm")
        }
        FieldOfViewSource::Assumed => {
            "a guess, 65 degrees along the longer side, as the photo has no EXIF of its lens".into()
        }
    };
    if let Some((width, height)) = view.cut_from {
        write!(text, "; cut out of {width} x {height}, from the middle by assumption")
            .expect("memory can be written to");
    }
    text
}
