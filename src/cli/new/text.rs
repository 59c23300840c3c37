//! The texts of `scene.ron` and `edit.ron` of a new scene.

use std::fmt::Write as _;

use relight::geometry::{FieldOfView, FieldOfViewSource};
use relight::image::PhotoHeader;

/// The parts of `scene.ron`.
pub struct SceneText<'a> {
    /// The name of the photo's file.
    pub photo: &'a str,
    /// The horizontal field of view.
    pub view: &'a FieldOfView,
    /// The origin of the field of view in words.
    pub view_origin: &'a str,
    /// The origin of `depth.exr`; `None` without depth.
    pub depth: Option<&'a str>,
    /// The field `lights`, with comments, and `ignore` where there is one; may be empty.
    pub lights: &'a str,
}

impl SceneText<'_> {
    /// The whole file.
    pub fn ron(&self) -> String {
        let mut text = String::from(
            "// Written by `relight new`, to be edited. A second call changes no file that was edited.\n\
             // All fields: docs/files.md.\nScene(\n    version: 1,\n",
        );
        let line = |text: &mut String, comment: &str, field: &str| {
            writeln!(text, "    // {}\n    {field}", one_line(comment))
                .expect("memory can be written to");
        };
        line(&mut text, "The photo as it was given.", &format!("photo: {:?},", self.photo));
        line(
            &mut text,
            &format!("The horizontal field of view in degrees: {}.", self.view_origin),
            &format!("camera: FovX({:.2}),", self.view.degrees),
        );
        match self.depth {
            Some(origin) => line(
                &mut text,
                &format!("Meters along the camera's axis: {origin}."),
                r#"depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0),"#,
            ),
            None => line(
                &mut text,
                "Depth is missing: give it with `relight new .. --depth FILE`, then this line:",
                r#"// depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0),"#,
            ),
        }
        text.push_str(self.lights);
        line(
            &mut text,
            "Facts, where you know them: the room's height in meters, a white sheet's illuminance in lux.",
            "// room: (height: 2.6),\n    // exposure: Lux(300.0),",
        );
        text.push_str(")\n");
        text
    }
}

/// A comment ends at the end of its line, whatever a file or a name has in it.
fn one_line(text: &str) -> String {
    text.replace(|c: char| c.is_control() || c == '\u{2028}' || c == '\u{2029}', " ")
}

/// The origin of a field of view in words.
pub fn origin_of_view(view: &FieldOfView, photo: &PhotoHeader) -> String {
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

/// The first edit of a scene with lights of these names.
pub fn edit_text(lights: &[String]) -> String {
    let mut text = String::from(
        "// Written by `relight new`, to be edited. All changes: docs/files.md, docs/edits-lights.md.\n\
         Edit(\n    version: 1,\n    lights: {\n",
    );
    match lights {
        [] => text.push_str("        // No light in view is known. The lamps that are out of view:\n        \"inv_lamp\": Scale(0.3),\n"),
        [first, others @ ..] => {
            writeln!(text, "        {first:?}: Scale(0.3),").expect("memory can be written to");
            for name in others {
                writeln!(text, "        // {name:?}: Off,").expect("memory can be written to");
            }
        }
    }
    text.push_str(
        "        // \"desk\": Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 300, y: 330, lift: 0.3), flux: 800, temperature: 2700),\n    },\n)\n",
    );
    text
}
