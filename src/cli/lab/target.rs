//! The graph under evaluation: the user's, with stages that read the truth and score, and with
//! parts replaced by the truth.

use std::path::{Path, PathBuf};

use relight::files::{edit, scene};
use relight::graph::{
    Diagnostic, Diagnostics, GraphFile, Key, Member, Overlay, Raw, Registry, ResolvedGraph,
    Setting, Source, Target,
};
use relight::nodes::artifacts::{INV_LAMP, INV_WINDOW};
use relight_lab::eval::Substitution;

use crate::cli::args::Networks;
use crate::cli::load::{backend, setting};
use crate::cli::networks;

/// The true surface; `true_scene` is a copy of the node that reads the scene.
const SURFACE: &str = r#"
    "true_room": (op: Mesh(), in: {
        "depth": "true_scene.depth", "camera": "true_scene.small_camera", "ignore": "true_scene.ignore",
        "masks": "true_scene.mask", "kinds": "true_scene.kind",
    }),
"#;
/// `$NORMAL` is an output with the normals of the true surface.
const LIGHTS: &str = r#"
    "true_lights": (op: ReadLights(), in: { "kind": "true_scene.kind" }),
    "true_direct": (op: Direct(), each: "estimated", in: {
        "points": "true_room.points", "normal": "$NORMAL", "shape": "true_lights.shape",
    }),
    "found_direct": (op: Direct(), each: "estimated", in: {
        "points": "true_room.points", "normal": "$NORMAL", "shape": "$SHAPES",
    }),
    "score_lights": (op: ScoreLights(), in: {
        "shape": "$SHAPES", "radiance": "$RADIANCES", "direct": "found_direct", "mask": "true_scene.mask",
        "true_shape": "true_lights.shape", "true_radiance": "true_lights.radiance", "true_direct": "true_direct",
    }),
"#;
const MATERIALS: &str = r#"
    "true_materials": (op: ReadMaterials(), in: { "normal": "true_room.normal", "camera": "true_scene.small_camera" }),
    "score_materials": (op: ScoreMaterials(), in: {
        "albedo": "$ALBEDO", "true_albedo": "true_materials.albedo", "mask": "true_scene.mask", $MORE
    }),
"#;
const PICTURES: &str = r#"
    "true_pictures": (op: ReadPictures()),
"#;
/// `$LIGHTS` is the list of nodes with the true pictures of lights.
const SHADING: &str = r#"
    "score_shading": (op: ScoreShading(), in: {
        "light": "$BEFORE", "residual": "$RESIDUAL", "truth": [$LIGHTS], "albedo": "true_materials.albedo",
        "photo": "true_scene.small", "clipped": "true_scene.small_clipped", "mask": "true_scene.mask",
    }),
"#;
const DIRECT: &str = r#"
    "true_shadowed": (op: ReadPictures()),
    "score_direct": (op: ScoreDirect(), in: {
        "direct": "$UNITS", "visibility": "$VISIBILITY", "radiance": "$RADIANCES", "truth": "true_shadowed.picture",
        "true_direct": "true_direct", "true_radiance": "true_lights.radiance", "mask": "true_scene.mask",
    }),
"#;
const LIGHTING: &str = r#"
    "score_lighting": (op: ScoreLighting(), in: { "lighting": "lighting" }),
"#;
const PICTURE: &str = r#"
    "score_picture": (op: ScorePicture(), in: {
        "picture": "$PICTURE", "photo": "true_scene.photo", "light": [$LIGHTS], "mask": "true_scene.full_mask", "coverage": "$COVERAGE",
    }),
"#;

/// An edit with a true picture.
pub struct Edit {
    pub name: String,
    change: Overlay,
    /// Parameters of `ScorePicture`.
    truth: Vec<(&'static str, Raw)>,
}

/// The measured outputs of the user's graph, as `node.port`.
struct Ends {
    scene: String,
    depth: String,
    full_depth: String,
    fit: Option<String>,
    shapes: String,
    radiances: String,
    before: String,
    residual: String,
    albedo: String,
    first: Option<String>,
    bounced: Option<String>,
    normal: Option<String>,
    roughness: Option<String>,
    coverage: String,
    picture: String,
    units: Option<[String; 2]>,
    lighting: bool,
}

/// A graph, a scene with truth, and their measures.
pub struct EvalTarget {
    registry: Registry,
    graph: PathBuf,
    room: Overlay,
    truth: Vec<(Key, Raw)>,
    ends: Ends,
    pub edits: Vec<Edit>,
    /// Measures that are missing, each with its reason.
    pub left_out: Vec<String>,
}

impl EvalTarget {
    /// Reads the graph, the scene and its truth; `set` contains settings of the command line.
    ///
    /// # Errors
    /// A file or a setting cannot be used; every fault is in the list.
    pub fn new(
        graph: &Path,
        folder: &Path,
        set: &[String],
        networks: &Networks,
    ) -> Result<EvalTarget, Vec<Diagnostic>> {
        let registry = networks::registry(networks);
        let mut file = GraphFile::read(graph)?;
        file.accept_old_names(&registry);
        let truth = scene::truth(folder)?;
        let kinds: Vec<&str> = file.nodes().map(|node| node.kind).collect();
        let mut room = scene::read(folder, Some(&kinds))?;
        room.settings.extend(backend(&registry, networks, &kinds).map_err(|fault| vec![fault])?);
        let mut faults = Vec::new();
        room.settings.extend(set.iter().filter_map(|text| setting(text, &mut faults)));
        if !faults.is_empty() {
            return Err(faults);
        }
        let ends = Ends::of(&file, graph).map_err(|fault| vec![fault])?;
        let (graph, edits, left_out) = (graph.to_owned(), Vec::new(), Vec::new());
        let mut target = EvalTarget { registry, graph, room, truth, ends, edits, left_out };
        target.list_missing();
        target.find_edits(folder, &file)?;
        if target.truth.is_empty() {
            let fault = Diagnostic::file(
                &folder.join("scene.ron"),
                "wanted a scene with a `truth`, got none",
            );
            return Err(vec![fault.help("docs/eval.md lists its fields")]);
        }
        Ok(target)
    }

    /// The value of a field of `truth`.
    fn of(&self, field: &str) -> Option<&Raw> {
        self.truth.iter().find(|(key, _)| key.name == field).map(|(_, value)| value)
    }

    fn has(&self, field: &str) -> bool {
        self.of(field).is_some()
    }

    /// Whether direct light can be measured.
    fn direct(&self) -> bool {
        self.has("direct") && self.has("lights") && self.ends.units.is_some()
    }

    fn lighting(&self) -> bool {
        self.has("lighting") && self.ends.lighting
    }

    /// Lists the measures without truth or without stages.
    fn list_missing(&mut self) {
        let lacks = |field: &'static str| (!self.has(field)).then_some(field);
        let rows: [(&str, Vec<Option<&str>>); 7] = [
            ("Chamfer and E_j; true lights in the ablation", vec![lacks("lights")]),
            ("materials and E; true materials in the ablation", vec![lacks("albedo")]),
            ("normal", vec![lacks("albedo"), lacks("normal")]),
            ("roughness", vec![lacks("albedo"), lacks("roughness")]),
            ("E_d and shadow", vec![lacks("direct"), lacks("lights")]),
            ("lighting", vec![lacks("lighting")]),
            ("estimated against true depth", vec![lacks("depth")]),
        ];
        for (what, lacking) in rows {
            let lacking: Vec<String> =
                lacking.into_iter().flatten().map(|field| format!("`{field}`")).collect();
            if !lacking.is_empty() {
                self.left_out
                    .push(format!("{what}: the scene's truth has no {}", lacking.join(", no ")));
            }
        }
        if self.has("lighting") && !self.ends.lighting {
            self.left_out.push("lighting: the graph has no node `lighting`".into());
        }
        if self.has("direct") && self.ends.units.is_none() {
            self.left_out.push("E_d and shadow: the graph mixes no layers of direct light".into());
        }
    }

    /// Collects the edits: each light off, all lights out of view off, and those that the truth
    /// names.
    fn find_edits(&mut self, folder: &Path, file: &GraphFile) -> Result<(), Vec<Diagnostic>> {
        let mut faults = Diagnostics::default();
        let lights = self.of("pictures").map(|value| value.as_map(&mut faults)).unwrap_or_default();
        let known: Vec<String> = self
            .room
            .members
            .iter()
            .filter(|m| m.set == "visible")
            .map(|m| m.name.clone())
            .collect();
        let invisible = [INV_LAMP, INV_WINDOW];
        for (key, _) in &lights {
            if !known.contains(&key.name) && !invisible.contains(&key.name.as_str()) {
                faults.push(|| {
                    let fault = Diagnostic::at(
                        &key.origin,
                        format!("the scene has no light `{}`", key.name),
                    );
                    fault.suggest(&key.name, known.iter().map(String::as_str).chain(invisible))
                });
            }
        }
        for light in known.iter().filter(|id| lights.iter().all(|(key, _)| key.name != **id)) {
            if let Some(pictures) = self.of("pictures") {
                let message =
                    format!("`pictures` has none of the light `{light}`: wanted one of each light");
                faults.push(|| pictures.fault(message));
            }
        }
        let present = |id: &&str| lights.iter().any(|(key, _)| key.name == **id);
        let unseen: Vec<&str> = invisible.into_iter().filter(present).collect();
        let one = known
            .iter()
            .filter(|id| present(&id.as_str()))
            .map(|id| (id.clone(), vec![id.as_str()], vec![id.as_str()]));
        let all = (!unseen.is_empty())
            .then(|| ("invisible lights".to_owned(), unseen.clone(), invisible.to_vec()));
        for (name, dark, off) in one.chain(all) {
            let entries: Vec<String> = off.iter().map(|id| format!("{id:?}: Off")).collect();
            let value = raw(format!("{{ {} }}", entries.join(", ")), Path::new(OURS));
            let setting = Setting {
                target: Target::Kind("EditLights".into()),
                field: "lights".into(),
                value,
            };
            let change = Overlay { settings: vec![setting], members: Vec::new() };
            self.edits.push(Edit {
                name: format!("{name} off"),
                change,
                truth: vec![("off", raw(format!("{dark:?}"), Path::new(OURS)))],
            });
        }
        self.find_edit_files(folder, file, &mut faults);
        if !self.has("pictures") && !self.has("edits") {
            self.left_out.push("edits: the scene's truth has no `pictures`, no `edits`".into());
        }
        if faults.is_empty() { Ok(()) } else { Err(faults.into_vec()) }
    }

    /// Adds the edit files of the truth; those that need a stage which the graph lacks are left
    /// out.
    fn find_edit_files(&mut self, folder: &Path, file: &GraphFile, faults: &mut Diagnostics) {
        for (key, picture) in self.of("edits").map(|value| value.as_map(faults)).unwrap_or_default()
        {
            let path = folder.join(&key.name);
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            match edit::read(&path, Some(&self.room), None) {
                Ok(change) => {
                    let lacking =
                        change.settings.iter().find_map(|setting| match &setting.target {
                            Target::Kind(kind) => {
                                file.nodes().all(|node| node.kind != kind).then_some(kind)
                            }
                            Target::Node(_) => None,
                        });
                    match lacking {
                        Some(kind) => {
                            self.left_out.push(format!("{name}: the graph has no {kind} stage"))
                        }
                        None => {
                            self.edits.push(Edit { name, change, truth: vec![("truth", picture)] })
                        }
                    }
                }
                Err(new) => new.into_iter().for_each(|fault| faults.push(|| fault)),
            }
        }
    }

    /// The parts whose truth is known.
    pub fn known(&self) -> Substitution {
        Substitution {
            depth: self.has("depth"),
            lights: self.has("lights"),
            materials: self.has("albedo"),
        }
    }

    /// The outputs with scores under a substitution, without any edit.
    pub fn measures(&self, substitution: Substitution) -> Vec<String> {
        let nodes = [
            ("score_lights", self.has("lights") && !substitution.lights),
            ("score_materials", self.has("albedo") && !substitution.materials),
            ("score_shading", self.has("albedo")),
            ("score_direct", self.direct()),
            ("score_lighting", self.lighting()),
        ];
        nodes.iter().filter(|(_, asked)| *asked).map(|(name, _)| format!("{name}.scores")).collect()
    }

    /// The graph under a substitution and an edit, ready to run.
    ///
    /// # Errors
    /// The graph cannot be resolved with the settings; every fault is in the list.
    pub fn graph(
        &self,
        substitution: Substitution,
        edit: Option<&Edit>,
    ) -> Result<ResolvedGraph, Vec<Diagnostic>> {
        let text = format!(
            "Graph(version: 1, extends: {:?}, nodes: {{{}}})",
            self.graph.display().to_string(),
            self.stages()
        );
        let mut file = GraphFile::parse(Source::new(OURS, text))?;
        file.accept_old_names(&self.registry);
        let ends = &self.ends;
        file.copy(&ends.scene, "true_scene");
        let mut settings = self.room.settings.clone();
        let of_scene =
            self.room.settings.iter().filter(|s| s.target == Target::Node(ends.scene.clone()));
        settings.extend(
            of_scene.map(|s| Setting { target: Target::Node("true_scene".into()), ..s.clone() }),
        );
        let mut set = |target: Target, field: &str, value: &Raw| {
            settings.push(Setting { target, field: field.to_owned(), value: value.clone() });
        };
        let node = |name: &str| Target::Node(name.to_owned());
        let ours = |text: String| raw(text, Path::new(OURS));
        if let Some(depth) = self.of("depth") {
            let value = raw(format!("(path: {})", depth.text()), &depth.origin.source.path);
            set(node("true_scene"), "depth", &value);
        }
        if substitution.depth {
            file.redirect(&ends.depth, "true_scene.depth");
            file.redirect(&ends.full_depth, "true_scene.full_depth");
        }
        if let Some(pictures) = self.of("pictures") {
            set(node("true_pictures"), "files", pictures);
        }
        if let Some(direct) = self.of("direct").filter(|_| self.direct()) {
            set(node("true_shadowed"), "files", direct);
        }
        if let Some(maps) = self.of("lighting").filter(|_| self.lighting()) {
            set(node("score_lighting"), "truth", maps);
        }
        if substitution.lights {
            file.redirect(&ends.shapes, "true_lights.shape");
            file.redirect(&ends.radiances, "true_lights.radiance");
            if let Some(fit) = &ends.fit {
                // True lights emit all light of the room, so the residual is zero.
                set(node(fit), "rest_cost", &ours("1e9".into()));
            }
        }
        if substitution.materials {
            file.redirect(&ends.albedo, "true_materials.albedo");
            for albedo in [&ends.first, &ends.bounced].into_iter().flatten() {
                file.redirect(albedo, "true_materials.albedo");
            }
            // Normals belong to the materials where the same stage gives albedo; else to the depth.
            let own = |end: &&String| {
                ends.first.as_ref().is_some_and(|first| node_of(first) == node_of(end))
            };
            if let Some(normal) = ends.normal.as_ref().filter(own).filter(|_| self.has("normal")) {
                file.redirect(normal, "true_materials.normal");
            }
            if let Some(roughness) = ends.roughness.as_ref().filter(|_| self.has("roughness")) {
                file.redirect(roughness, "true_materials.roughness");
            }
            if let Some(fit) = &ends.fit {
                set(node(fit), "keep_albedo", &ours("true".into()));
            }
        }
        let mut members: Vec<Member> = self.room.members.clone();
        if let Some(edit) = edit {
            set(node("score_picture"), "subject", &ours(format!("{:?}", edit.name)));
            edit.truth.iter().for_each(|(field, value)| set(node("score_picture"), field, value));
            settings.extend(edit.change.settings.iter().cloned());
            members.extend(edit.change.members.iter().cloned());
        }
        file.resolve(&self.registry, &Overlay { settings, members })
    }

    /// The stages that read the truth and score, as the body of `nodes`.
    fn stages(&self) -> String {
        let ends = &self.ends;
        let has_normal = self.has("albedo") && self.has("normal");
        let more = |name: &str, end: &Option<String>, known: bool| match end {
            Some(end) if known => {
                format!("\"{name}\": {end:?}, \"true_{name}\": \"true_materials.{name}\", ")
            }
            _ => String::new(),
        };
        let first =
            ends.first.as_ref().map_or(String::new(), |end| format!("\"first\": {end:?}, "));
        let more = first
            + &more("normal", &ends.normal, has_normal)
            + &more("roughness", &ends.roughness, self.has("roughness"));
        let units = ends.units.clone().unwrap_or_default();
        let blocks = [
            (SURFACE, true),
            (LIGHTS, self.has("lights")),
            (MATERIALS, self.has("albedo")),
            (PICTURES, self.has("pictures")),
            (SHADING, self.has("albedo")),
            (DIRECT, self.direct()),
            (LIGHTING, self.lighting()),
        ];
        let text: String =
            blocks.iter().filter(|(_, asked)| *asked).map(|(block, _)| *block).collect();
        let lights = if self.has("pictures") { "\"true_pictures.picture\"" } else { "" };
        (text + PICTURE)
            .replace("$LIGHTS", lights)
            .replace("$MORE", &more)
            .replace(
                "$NORMAL",
                if has_normal { "true_materials.normal" } else { "true_room.normal" },
            )
            .replace("$SHAPES", &ends.shapes)
            .replace("$RADIANCES", &ends.radiances)
            .replace("$ALBEDO", &ends.albedo)
            .replace("$BEFORE", &ends.before)
            .replace("$RESIDUAL", &ends.residual)
            .replace("$UNITS", &units[0])
            .replace("$VISIBILITY", &units[1])
            .replace("$PICTURE", &ends.picture)
            .replace("$COVERAGE", &ends.coverage)
    }
}

impl Ends {
    fn of(file: &GraphFile, graph: &Path) -> Result<Ends, Diagnostic> {
        let find = |kind: &str| {
            file.nodes().find(|node| node.kind == kind).map(|node| node.name.to_owned())
        };
        let node = |kind: &str| {
            let fault =
                || Diagnostic::file(graph, format!("wanted a graph with a stage {kind}, got none"));
            find(kind).ok_or_else(|| {
                fault().help("eval measures graphs with the wires of graphs/physics.ron")
            })
        };
        let wire = |node: &str, port: &str| file.wired(node, port).next().map(str::to_owned);
        let end = |node: &str, port: &str| {
            let fault = || {
                Diagnostic::file(
                    graph,
                    format!("node `{node}`: wanted a wire to `{port}`, got none"),
                )
            };
            wire(node, port).ok_or_else(fault)
        };
        let (scene, edit, compose) = (node("ReadScene")?, node("EditLights")?, node("Compose")?);
        let room = node("Mesh")?;
        let (fit, write) = (find("FitLights"), find("Write"));
        let written = |port: &str| write.as_ref().and_then(|write| wire(write, port));
        let before = end(&compose, "before")?;
        let mix = node_of(&before);
        Ok(Ends {
            scene,
            depth: end(&room, "depth")?,
            full_depth: end(&edit, "depth")?,
            shapes: end(&edit, "shapes")?,
            radiances: end(&edit, "radiances")?,
            residual: end(&compose, "residual")?,
            albedo: end(&compose, "albedo")?,
            coverage: end(&compose, "coverage")?,
            picture: format!("{compose}.picture"),
            first: fit.as_ref().and_then(|fit| wire(fit, "albedo")),
            bounced: wire(mix, "indirect").and_then(|end| wire(node_of(&end), "albedo")),
            normal: written("normal"),
            roughness: written("roughness"),
            units: wire(mix, "direct")
                .zip(wire(mix, "visibility"))
                .map(|(direct, lit)| [direct, lit]),
            lighting: file.nodes().any(|node| node.name == "lighting"),
            before,
            fit,
        })
    }
}

/// The file name of generated text in messages. It has no folder, so paths start from the working
/// directory.
const OURS: &str = "relight eval";

/// A value as if read from the file `path`; relative paths in it start from there.
fn raw(text: String, path: &Path) -> Raw {
    Raw::document(&Source::new(path, text), &mut Diagnostics::default())
        .expect("we write sound RON")
}

/// The node of `node.port`.
fn node_of(end: &str) -> &str {
    end.split_once('.').map_or(end, |(node, _)| node)
}
