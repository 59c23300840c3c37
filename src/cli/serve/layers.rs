//! The layers of a picture for the page, which weights and sums them itself.
//!
//! They are those of the edit without changes of radiance, so that each light has a layer that any
//! weight can multiply. A layer is packed once: as long as its value stays the same, so do its
//! digest and what the page has of it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use axum::body::Bytes;
use glam::Vec3;
use rayon::prelude::*;
use relight::graph::{Digest, Inputs, PortValue, ResolvedGraph, RunReport, Source, Value};
use relight::image::{Layer, Picture, Plane, Transfer, fit, pack, resize};
use relight::nodes::artifacts::{REST, Radiance};
use relight::nodes::output::SavedRoom;
use relight::nodes::output::write::{PagePlanes, WriteIn};
use relight::{files::edit, graph::NodeError};
use serde_json::{Value as Json, json};

use super::scene::Scene;

/// Level of zlib: none, as the way to the page is short, and packing takes longer than it saves.
const PACKING: u32 = 0;
/// Manifests whose layers a page may still be loading.
const KEPT: usize = 4;

/// The results of a run of the edit without changes of radiance.
pub struct Base {
    pub revision: u64,
    pub preview: bool,
    pub room: Option<SavedRoom>,
    full: (usize, usize),
    /// The size of the layers before they are packed: a preview's is smaller.
    size: (usize, usize),
    transfer: Transfer,
    lights: Vec<Light>,
    rest: Value,
    photo: Option<Value>,
    /// In the manifest's form.
    planes: Vec<Json>,
    blobs: BTreeMap<String, Bytes>,
}

struct Light {
    id: String,
    kind: Option<String>,
    /// The entry of the edit without changes of radiance.
    entry: Option<String>,
    /// The color of each lobe in the base.
    radiance: Vec<[f32; 3]>,
    layer: Value,
}

/// The inputs of `Write` that a base needs, and a preview no others: it has no planes.
const NEEDED: [&str; 4] = ["layer", "residual", "photo", "radiance"];

/// The outputs that the inputs of the stage `writer` take: those that a base is made of.
pub fn wanted(graph: &ResolvedGraph, writer: &str, preview: bool) -> Vec<String> {
    let feeds = graph.feeds(writer).unwrap_or_default();
    let named = WriteIn::ports().into_iter().zip(feeds);
    let needed = named.filter(|(port, _)| !preview || NEEDED.contains(&port.name));
    needed.flat_map(|(_, outputs)| outputs).collect()
}

impl Base {
    /// Takes the inputs of the stage `writer` from a run that made the [`wanted`] ones.
    ///
    /// # Errors
    /// The inputs do not fit each other.
    pub fn new(
        (revision, preview): (u64, bool),
        (graph, writer): (&ResolvedGraph, &str),
        run: &RunReport,
        (source, scene): (&Arc<Source>, &Scene),
    ) -> Result<Base, NodeError> {
        let feeds = graph.feeds(writer).unwrap_or_default();
        let values: Vec<PortValue> = feeds.iter().map(|outputs| joined(outputs, run)).collect();
        let of_port = |name: &str| {
            let at = WriteIn::ports().iter().position(|port| port.name == name);
            at.and_then(|at| values.get(at)).cloned().unwrap_or(PortValue::Missing)
        };
        let one = |name: &str| match of_port(name) {
            PortValue::One(value) => Some(value),
            _ => None,
        };
        let many = |name: &str| match of_port(name) {
            PortValue::Many(values) => values,
            _ => Vec::new(),
        };
        let rest = one("residual").and_then(|rest| Some((rest.get::<Layer>()?.size(), rest)));
        let (size, rest) =
            rest.ok_or_else(|| NodeError::Failed("the picture has no residual".into()))?;
        let radiance: BTreeMap<String, Value> = many("radiance").into_iter().collect();
        let radiance = |id: &str| {
            let radiance = radiance.get(id).and_then(Value::get::<Radiance>);
            radiance.map(|r| r.0.iter().map(Vec3::to_array).collect()).unwrap_or_default()
        };
        let entries: BTreeMap<String, String> = edit::entries(source).into_iter().collect();
        let light = |(id, layer): (String, Value)| {
            let entry = entries.get(&id).cloned();
            let made = ["Lamp", "Window"]
                .into_iter()
                .find(|kind| entry.as_ref().is_some_and(|entry| entry.starts_with(kind)));
            let kind = made.or_else(|| Some(scene.light(&id)?.kind)).map(str::to_owned);
            Light { kind, entry, radiance: radiance(&id), layer, id }
        };
        let lights = many("layer").into_iter().map(light).collect();
        let photo = one("photo");
        let (mut blobs, mut planes, mut room) = (BTreeMap::new(), Vec::new(), None);
        if !preview {
            let made = PagePlanes::new(&WriteIn::take(values), PACKING)?;
            room = made.room;
            for plane in made.planes {
                let digest = digest(&plane.packed.bytes);
                blobs.insert(digest.clone(), Bytes::from(plane.packed.bytes));
                planes.push(json!({
                    "name": plane.name, "size": plane.size, "channels": plane.channels,
                    "scale": plane.packed.scale, "digest": digest, "white": plane.white,
                }));
            }
        }
        let (full, transfer) = (scene.full, scene.transfer);
        Ok(Base {
            revision,
            preview,
            room,
            full,
            size,
            transfer,
            lights,
            rest,
            photo,
            planes,
            blobs,
        })
    }
}

/// The value of an input port that takes `outputs`.
fn joined(outputs: &[String], run: &RunReport) -> PortValue {
    let mut all = outputs.iter().filter_map(|output| run.output(output));
    match (all.next(), all.next()) {
        (Some(PortValue::Many(first)), _) => {
            let others = outputs.iter().skip(1).filter_map(|output| match run.output(output)? {
                PortValue::Many(values) => Some(values.clone()),
                _ => None,
            });
            PortValue::Many(first.iter().cloned().chain(others.flatten()).collect())
        }
        (Some(value), None) => value.clone(),
        _ => PortValue::Missing,
    }
}

/// The newest base in packed form, at the sizes that pages asked for.
#[derive(Default)]
pub struct Packs {
    newest: VecDeque<Arc<Manifest>>,
    long_side: Option<u32>,
}

/// The answer to `/api/layers`, and the layers that it names.
pub struct Manifest {
    pub json: Json,
    revision: u64,
    long_side: u32,
    /// By the digest of the value.
    layers: BTreeMap<Digest, PackedLayer>,
    blobs: BTreeMap<String, Bytes>,
}

#[derive(Clone)]
struct PackedLayer {
    scale: f32,
    dark: bool,
    digest: String,
    bytes: Bytes,
}

impl Packs {
    /// The packed layers under a digest.
    pub fn blob(&self, digest: &str) -> Option<Bytes> {
        self.newest.iter().find_map(|manifest| manifest.blobs.get(digest)).cloned()
    }

    /// The size that a page asked for last.
    pub fn long_side(&self) -> Option<u32> {
        self.long_side
    }

    /// The manifest of this base at this size, if it is made.
    pub fn find(&mut self, base: &Base, long_side: u32) -> Option<Arc<Manifest>> {
        self.long_side = Some(long_side);
        let same = |m: &&Arc<Manifest>| (m.revision, m.long_side) == (base.revision, long_side);
        self.newest.iter().find(same).cloned()
    }

    /// All layers that are packed already, at this size.
    fn known(&self, long_side: u32) -> BTreeMap<Digest, PackedLayer> {
        let fitting = self.newest.iter().filter(|manifest| manifest.long_side == long_side);
        fitting.flat_map(|manifest| manifest.layers.clone()).collect()
    }
}

/// Packs a base at a size, or finds it packed.
pub fn manifest(packs: &std::sync::Mutex<Packs>, base: &Base, long_side: u32) -> Arc<Manifest> {
    let lock = || packs.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let known = {
        let mut packs = lock();
        if let Some(made) = packs.find(base, long_side) {
            return made;
        }
        packs.known(long_side)
    };
    let size = fit(base.size.0, base.size.1, long_side as usize);
    let values: Vec<&Value> = base
        .lights
        .iter()
        .map(|light| &light.layer)
        .chain([&base.rest])
        .chain(&base.photo)
        .collect();
    let layers: Vec<PackedLayer> = values
        .par_iter()
        .map(|value| match known.get(&value.digest()) {
            Some(layer) => layer.clone(),
            None => packed(value, size),
        })
        .collect();
    let entry = |id: &str, layer: &PackedLayer| json!({ "id": id, "scale": layer.scale, "digest": layer.digest, "dark": layer.dark });
    let lights = base.lights.iter().zip(&layers).map(|(light, layer)| {
        let mut entry = entry(&light.id, layer);
        entry["kind"] = json!(light.kind);
        entry["entry"] = json!(light.entry);
        entry["radiance"] = json!(light.radiance);
        entry
    });
    let lights: Vec<Json> = lights.collect();
    let count = base.lights.len();
    let photo = layers.get(count + 1).map(|layer| entry("photo", layer));
    let json = json!({
        "revision": base.revision, "preview": base.preview, "size": size, "full": base.full,
        "transfer": base.transfer, "rest": entry(REST, &layers[count]), "photo": photo,
        "lights": lights, "planes": base.planes,
    });
    let mut blobs = base.blobs.clone();
    blobs.extend(layers.iter().map(|layer| (layer.digest.clone(), layer.bytes.clone())));
    let layers = values.iter().map(|value| value.digest()).zip(layers).collect();
    let made = Arc::new(Manifest { json, revision: base.revision, long_side, layers, blobs });
    let mut packs = lock();
    packs.newest.push_front(made.clone());
    packs.newest.truncate(KEPT);
    made
}

fn packed(value: &Value, (width, height): (usize, usize)) -> PackedLayer {
    let picture = match value.get::<Layer>() {
        Some(layer) => Arc::new(layer.picture()),
        None => {
            value.get::<Picture>().unwrap_or_else(|| Arc::new(Picture(Plane::new(0, 0, vec![]))))
        }
    };
    let dark = picture.0.pixels().iter().all(|&color| color == Vec3::ZERO);
    let packed = if picture.0.size() == (width, height) {
        pack(&picture.0, PACKING)
    } else {
        pack(&resize(&picture.0, width, height), PACKING)
    };
    let digest = digest(&packed.bytes);
    PackedLayer { scale: packed.scale, dark, digest, bytes: packed.bytes.into() }
}

fn digest(bytes: &[u8]) -> String {
    Digest(*blake3::hash(bytes).as_bytes()).to_string()
}
