//! WritePlanes: the unit layers of every light as one EXR file at working size, for whoever trains
//! or measures on them.
//!
//! Channels, all of 32 bits, for lobe k = 0.. of each light: `direct_<light>_<k>.Y` is the
//! unshadowed shading of unit radiance, `lit_<light>_<k>.Y` the share of it that arrives,
//! `unknown_<light>_<k>.Y` the share that no ray determines, `indirect_<light>_<k>.{R,G,B}` the
//! indirect shading; and `normal.{X,Y,Z}`, `depth.Z`. A light that is absent has none.

use std::sync::Arc;

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Compression, Depth, ExrLayers, Normal};
use crate::nodes::artifacts::{Files, UnitDirect, UnitIndirect, Visibility};
use crate::{params, ports};

params! {
    /// Writes the layers of each lobe of each light for unit radiance, as EXR at working size:
    /// `direct_<light>_<k>.Y`, `lit_<light>_<k>.Y`, `unknown_<light>_<k>.Y`,
    /// `indirect_<light>_<k>.RGB`, `normal.XYZ` and `depth.Z`, all 32-bit floats.
    pub struct WritePlanes {
        /// The file's name, without a folder, ending in `.exr`.
        name: String = "planes.exr".into(),
        /// Compression of the file: None, Rle, Zip or Piz. All are lossless.
        compression: Compression = Compression::None,
    }
}

ports! {
    pub input WritePlanesIn {
        /// Unit direct shading of each light.
        direct: Gather<UnitDirect>,
        /// Visibility of each light.
        visibility: Gather<Visibility>,
        /// Unit indirect shading of each light.
        indirect: Gather<UnitIndirect>,
        /// Normals.
        normal: Arc<Normal>,
        /// Depth; all planes have its size.
        depth: Arc<Depth>,
    }
}
ports! {
    pub output WritePlanesOut {
        /// The EXR file.
        files: Arc<Files>,
    }
}

impl Node for WritePlanes {
    const KIND: &'static str = "WritePlanes";
    const VERSION: u32 = 1;
    type In = WritePlanesIn;
    type Out = WritePlanesOut;

    fn check_consistency(&self) -> Result<(), String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        let stem = self.name.strip_suffix(".exr").unwrap_or_default();
        if stem.is_empty() || stem.starts_with('.') || !stem.chars().all(plain) {
            return Err(format!(
                "name: wanted letters, digits, `_`, `-` and `.`, ending in .exr, got {:?}",
                self.name
            ));
        }
        Ok(())
    }

    fn run(&self, inputs: WritePlanesIn, _: &Context) -> Result<WritePlanesOut, NodeError> {
        let size = inputs.depth.0.size();
        let same_size = |name: &str, got| super::same_size(name, got, "depth", size);
        let mut layers = ExrLayers::new(size.0, size.1);
        same_size("normal", inputs.normal.0.size())?;
        layers.float_xyz("normal", &inputs.normal.0);
        layers.float("depth.Z", &inputs.depth.0);
        for (id, direct) in inputs.direct.iter() {
            let (visibility, indirect) = (inputs.visibility.get(id), inputs.indirect.get(id));
            let (Some(visibility), Some(indirect)) = (visibility, indirect) else {
                return Err(NodeError::Failed(format!(
                    "light {id}: wanted visibility and indirect, as direct, got none"
                )));
            };
            let wanted = direct.lobes.len();
            for (name, got) in
                [("visibility", visibility.lit.len()), ("indirect", indirect.lobes.len())]
            {
                if got != wanted {
                    return Err(NodeError::Failed(format!(
                        "light {id}: wanted {wanted} lobes, as direct, got {got} of {name}"
                    )));
                }
            }
            let numbers = [
                ("direct", &direct.lobes),
                ("lit", &visibility.lit),
                ("unknown", &visibility.unknown),
            ];
            for (name, lobes) in numbers {
                for (k, plane) in lobes.iter().enumerate() {
                    let name = format!("{name}_{id}_{k}");
                    same_size(&name, plane.size())?;
                    layers.float(&format!("{name}.Y"), plane);
                }
            }
            for (k, shading) in indirect.lobes.iter().enumerate() {
                let name = format!("indirect_{id}_{k}");
                same_size(&name, shading.0.size())?;
                layers.float_rgb(&name, &shading.0);
            }
        }
        layers.comment(UNITS);
        let bytes = layers.write(self.compression).map_err(NodeError::Failed)?;
        Ok(WritePlanesOut { files: Arc::new(Files(vec![(self.name.clone(), bytes)])) })
    }
}

const UNITS: &str = "units: direct, indirect: irradiance / pi for unit radiance; lit, unknown: shares; depth: planar z in meters; normals: \
                     camera space, x right, y up, z backward";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn a_name_is_no_path() {
        for (name, sound) in [
            ("planes.exr", true),
            ("a-b_c.2.exr", true),
            (".exr", false),
            ("../a.exr", false),
            ("a/b.exr", false),
            ("a", false),
        ] {
            let stage = WritePlanes { name: name.into(), ..WritePlanes::default() };
            assert_eq!(stage.check().is_ok(), sound, "{name}");
        }
    }

    #[test]
    fn what_does_not_fit_together_is_named() {
        let one = |lobes, size: (usize, usize)| {
            let plane = Plane::filled(size.0, size.1, 0.5f32);
            let planes = vec![plane; lobes];
            let visibility =
                Visibility { lit: planes.clone(), stderr: planes.clone(), unknown: planes.clone() };
            (UnitDirect { lobes: planes.clone(), stderr: planes }, visibility)
        };
        let message = |lobes, size, indirect: Vec<(String, Arc<UnitIndirect>)>| {
            let (direct, visibility) = one(lobes, size);
            let inputs = WritePlanesIn {
                direct: Gather(vec![("a".into(), Arc::new(direct))]),
                visibility: Gather(vec![("a".into(), Arc::new(visibility))]),
                indirect: Gather(indirect),
                normal: Arc::new(Normal(Plane::filled(4, 3, glam::Vec3::Z))),
                depth: Arc::new(Depth(Plane::filled(4, 3, 1.0))),
            };
            WritePlanes::default()
                .run(inputs, &Context::default())
                .err()
                .map(|e| e.to_string())
                .unwrap_or_default()
        };
        let nothing = || {
            vec![(
                "a".into(),
                Arc::new(UnitIndirect {
                    lobes: vec![],
                    stderr: vec![],
                    probes: vec![],
                    cells: vec![],
                }),
            )]
        };
        assert_eq!(message(0, (4, 3), nothing()), "");
        assert_eq!(
            message(1, (4, 3), nothing()),
            "light a: wanted 1 lobes, as direct, got 0 of indirect"
        );
        assert_eq!(
            message(1, (4, 3), vec![]),
            "light a: wanted visibility and indirect, as direct, got none"
        );
        let dark = crate::image::Shading(Plane::filled(4, 3, glam::Vec3::ZERO));
        let dark = vec![(
            "a".into(),
            Arc::new(UnitIndirect {
                lobes: vec![dark],
                stderr: vec![],
                probes: vec![],
                cells: vec![],
            }),
        )];
        assert_eq!(message(1, (3, 4), dark), "direct_a_0: wanted 4 x 3 pixels as depth, got 3 x 4");
    }
}
