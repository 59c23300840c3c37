//! WriteEstimates: the estimated room, as files that `ReadLights` and `ReadMaterials` read back.

use std::sync::Arc;

use glam::Vec3;
use serde_json::{Map, Value, json};

use crate::graph::{Context, Gather, Node, NodeError};
use crate::image::{Albedo, Compression, ExrLayers, Normal, Roughness};
use crate::nodes::artifacts::{Files, LOBES};
use crate::optics::{
    BoxLamp, Lamp, MeshLamp, PhotometricLamp, Radiance, RectLamp, Shape, SphereLamp, Surfel,
};
use crate::{params, ports};

params! {
    /// Writes the estimated room as a scene's `truth` names it: `lights.json`, which `ReadLights`
    /// reads, and `albedo.exr`, `normal.exr` and `roughness.exr`, which `ReadMaterials` reads. To
    /// measure estimates, to mend them by hand, to hold them fixed.
    pub struct WriteEstimates {}
}

ports! {
    pub input WriteEstimatesIn {
        /// The shapes of the lights.
        shape: Gather<Shape>,
        /// The radiances of the lights.
        radiance: Gather<Radiance>,
        /// Albedo, working size.
        albedo: Arc<Albedo>,
        /// Normals, working size.
        normal: Arc<Normal>,
        /// Roughness, working size.
        roughness: Arc<Roughness>,
    }
}
ports! {
    pub output WriteEstimatesOut {
        /// `lights.json`, `albedo.exr`, `normal.exr`, `roughness.exr`.
        files: Arc<Files>,
    }
}

impl Node for WriteEstimates {
    const KIND: &'static str = "WriteEstimates";
    const VERSION: u32 = 1;
    type In = WriteEstimatesIn;
    type Out = WriteEstimatesOut;

    fn run(&self, inputs: WriteEstimatesIn, _: &Context) -> Result<WriteEstimatesOut, NodeError> {
        let mut lights = Map::new();
        for (id, shape) in inputs.shape.iter() {
            let radiance = inputs.radiance.get(id).map_or(&[][..], |radiance| &radiance.0);
            if radiance.len() != shape.lobes() {
                let (wanted, got) = (shape.lobes(), radiance.len());
                return Err(NodeError::Failed(format!(
                    "light {id}: wanted {wanted} radiances, one per lobe, got {got}"
                )));
            }
            if let Some(light) = light(shape, radiance) {
                lights.insert(id.into(), light);
            }
        }
        let mut text =
            serde_json::to_vec_pretty(&lights).map_err(|e| NodeError::Failed(e.to_string()))?;
        text.push(b'\n');
        let size = inputs.albedo.0.size();
        super::same_size("normal", inputs.normal.0.size(), "albedo", size)?;
        super::same_size("roughness", inputs.roughness.0.size(), "albedo", size)?;
        let file = |fill: &dyn Fn(&mut ExrLayers)| {
            let mut layers = ExrLayers::new(size.0, size.1);
            fill(&mut layers);
            layers.write(Compression::Zip).map_err(NodeError::Failed)
        };
        Ok(WriteEstimatesOut {
            files: Arc::new(Files(vec![
                ("lights.json".into(), text),
                ("albedo.exr".into(), file(&|layers| layers.float_rgb("", &inputs.albedo.0))?),
                ("normal.exr".into(), file(&|layers| layers.float_xyz("", &inputs.normal.0))?),
                ("roughness.exr".into(), file(&|layers| layers.float("Y", &inputs.roughness.0))?),
            ])),
        })
    }
}

/// A light as docs/planes.md has it; `None` where there is none.
fn light(shape: &Shape, radiance: &[Vec3]) -> Option<Value> {
    let numbers = |v: Vec3| json!(v.to_array().map(shortest));
    Some(match shape {
        Shape::Absent => return None,
        Shape::Lamp(lamp) => {
            let mut entry = match lamp {
                // These files do not hold profiles: a luminaire is the sphere of the same flux.
                Lamp::Sphere(SphereLamp { center, radius })
                | Lamp::Photometric(PhotometricLamp { center, radius, .. }) => {
                    json!({ "kind": "Sphere", "center": numbers(*center), "radius": shortest(*radius) })
                }
                Lamp::Rect(RectLamp { center, x, y }) => {
                    json!({ "kind": "Rect", "center": numbers(*center), "half_x": numbers(*x), "half_y": numbers(*y) })
                }
                Lamp::Box(BoxLamp { center, axes }) => {
                    json!({ "kind": "Box", "center": numbers(*center), "half_axes": axes.map(numbers) })
                }
                Lamp::Surfels(surfels) => {
                    json!({ "kind": "Mesh", "triangles": surfels.iter().flat_map(Surfel::square).map(|t| t.map(numbers)).collect::<Vec<_>>() })
                }
                Lamp::Mesh(MeshLamp { corners, triangles, .. }) => {
                    let corner = |&i: &u32| numbers(corners[i as usize]);
                    json!({ "kind": "Mesh", "triangles": triangles.iter().map(|t| t.each_ref().map(corner)).collect::<Vec<_>>() })
                }
            };
            entry["radiance"] = numbers(radiance[0]);
            entry
        }
        Shape::Window(window) => {
            let lobes = LOBES.iter().zip(&window.lobes).zip(radiance).map(|((name, lobe), radiance)| {
                json!({
                    "name": name, "direction": numbers(lobe.direction), "bandwidth": shortest(lobe.bandwidth),
                    "radiance": numbers(*radiance),
                })
            });
            json!({
                "kind": "Window", "center": numbers(window.center), "half_x": numbers(window.x),
                "half_y": numbers(window.y), "lobes": lobes.collect::<Vec<_>>(),
            })
        }
    })
}

/// The double that is written with the fewest digits of those that are this number in single
/// precision.
fn shortest(x: f32) -> f64 {
    x.to_string().parse().unwrap_or(f64::from(x))
}
