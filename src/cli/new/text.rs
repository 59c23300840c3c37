//! The texts of `scene.ron` and `edit.ron` of a new scene.

use std::fmt::Write as _;

use super::view::View;

/// The parts of `scene.ron`.
pub struct SceneText<'a> {
    /// The name of the photo's file.
    pub photo: &'a str,
    /// The camera.
    pub view: &'a View,
    /// The origin of `depth.exr`; `None` without depth.
    pub depth: Option<&'a str>,
    /// The field `lights`, with comments, and those of other masks that were given; may be empty.
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
        let View { ron, meaning, origin, .. } = self.view;
        line(&mut text, &format!("{meaning}: {origin}."), &format!("camera: {ron},"));
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
