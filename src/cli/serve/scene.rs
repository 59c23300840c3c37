//! The scene as the page needs it before anything is computed: its photo, camera and lights.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use relight::files::scene;
use relight::geometry::Camera;
use relight::graph::{Cancel, Diagnostic, Diagnostics, Engine, Raw, ResolvedGraph};
use relight::image::{Picture, Transfer, fit, resize, write_png};
use relight::nodes::artifacts::{Encoding, INV_LAMP, INV_WINDOW};
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::args::RunArgs;
use crate::cli::load::load;

/// Longer side of the photo in the page, in pixels, unless the page asks for another size.
pub const LONG_SIDE: u32 = 1280;

/// The kinds of stages that a page needs.
pub const READER: &str = "ReadScene";
pub const WRITER: &str = "Write";

/// A scene that was read.
pub struct Scene {
    pub full: (usize, usize),
    pub working: (usize, usize),
    pub transfer: Transfer,
    pub lights: Vec<SceneLight>,
    /// The mask of the pixels lit by the sun, where the scene names one.
    sunlight: Option<PathBuf>,
    photo: Arc<Picture>,
    camera: Arc<Camera>,
}

/// A light of the scene, in view or not.
#[derive(Clone, Serialize)]
pub struct SceneLight {
    pub id: String,
    pub kind: &'static str,
    pub in_view: bool,
    #[serde(skip)]
    pub mask: Option<PathBuf>,
}

impl Scene {
    /// Reads the scene of a run.
    ///
    /// # Errors
    /// All faults of graph and scene.
    pub fn read(job: &RunArgs, engine: &Engine) -> Result<Scene, Vec<Diagnostic>> {
        let graph = load(&job.graph, None, &job.files)?;
        let reader = node(&graph, READER, &job.graph)?;
        node(&graph, WRITER, &job.graph)?;
        let output = |port: &str| format!("{reader}.{port}");
        let ports = ["photo", "camera", "small_camera", "encoding"].map(output);
        let wanted = graph.wanted(Some(&ports)).map_err(|fault| vec![fault])?;
        let run = engine.run(&graph, &wanted, &Cancel::default(), &());
        let value = (run.value::<Picture>(&ports[0]), run.value::<Camera>(&ports[1]));
        let other = (run.value::<Camera>(&ports[2]), run.value::<Encoding>(&ports[3]));
        let ((Some(photo), Some(camera)), (Some(small), Some(encoding))) = (value, other) else {
            return Err(failures(&run));
        };
        let folder = job.files.scene.as_deref().unwrap_or("".as_ref());
        let overlay = scene::read_within(folder, None, job.files.reach())?;
        let field = |name: &str| overlay.settings.iter().find(|setting| setting.field == name);
        Ok(Scene {
            full: photo.0.size(),
            working: (small.width, small.height),
            transfer: encoding.transfer,
            lights: lights(field("lights").map(|field| &field.value)),
            sunlight: field("sunlight").and_then(|field| file(&field.value)),
            photo,
            camera,
        })
    }

    /// The photo as PNG, its longer side at most `long_side`.
    pub fn png(&self, long_side: u32) -> Vec<u8> {
        let (width, height) = fit(self.full.0, self.full.1, long_side as usize);
        let shown = Picture(resize(&self.photo.0, width, height));
        write_png(&shown, self.transfer, false)
    }

    /// The intrinsics in pixels of the photo.
    pub fn camera(&self) -> Value {
        let Camera { fx, fy, cx, cy, .. } = *self.camera;
        json!({ "fx": fx, "fy": fy, "cx": cx, "cy": cy })
    }

    /// The light of this name.
    pub fn light(&self, id: &str) -> Option<&SceneLight> {
        self.lights.iter().find(|light| light.id == id)
    }

    /// The masks of the scene: those of its lights by their names, and `sunlight`.
    pub fn masks(&self) -> impl Iterator<Item = (&str, &Path)> {
        let of_lights =
            self.lights.iter().filter_map(|light| Some((&*light.id, light.mask.as_deref()?)));
        of_lights.chain(self.sunlight.as_deref().map(|path| ("sunlight", path)))
    }
}

/// The failed nodes of a run, as faults.
pub fn failures(run: &relight::graph::RunReport) -> Vec<Diagnostic> {
    let fault = |node: &relight::graph::NodeReport| {
        let error = node.error.as_deref().unwrap_or("failed");
        Diagnostic::file("".as_ref(), format!("{}: {error}", node.name))
    };
    run.failed().map(fault).collect()
}

/// The first node of a kind.
pub fn node(graph: &ResolvedGraph, kind: &str, path: &Path) -> Result<String, Vec<Diagnostic>> {
    let node = graph.of_kind(kind).next().map(str::to_owned);
    node.ok_or_else(|| {
        let message = format!("the page needs a graph with a stage {kind}, got none");
        vec![Diagnostic::file(path, message).help("graphs/indoor.ron and graphs/physics.ron have")]
    })
}

/// The file that a value of `scene.ron` names.
fn file(value: &Raw) -> Option<PathBuf> {
    Some(value.origin.source.folder().join(value.string()?))
}

/// The lights of the field `lights` of `scene.ron`, and those out of view.
fn lights(field: Option<&Raw>) -> Vec<SceneLight> {
    let seen = field.map(|lights| lights.as_map(&mut Diagnostics::ignored())).unwrap_or_default();
    let mask = |light: &Raw| {
        file(&light.as_struct(None, &["mask"], &mut Diagnostics::ignored()).first()?.1)
    };
    let seen = seen.into_iter().map(|(key, light)| SceneLight {
        kind: kind(&light).unwrap_or("Lamp"),
        mask: mask(&light),
        id: key.name,
        in_view: true,
    });
    let hidden = [(INV_LAMP, "Lamp"), (INV_WINDOW, "Window")].map(|(id, kind)| SceneLight {
        id: id.to_owned(),
        kind,
        in_view: false,
        mask: None,
    });
    seen.chain(hidden).collect()
}

/// The kind of light that a value makes.
fn kind(light: &Raw) -> Option<&'static str> {
    ["Lamp", "Window"].into_iter().find(|kind| light.variant() == Some(kind))
}
