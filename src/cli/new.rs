//! `relight new`: a scene folder from a photo, ready to be relit.

mod capture;
mod depth;
mod folder;
mod masks;
mod text;
mod view;

use std::path::Path;

use relight::files::scene;
use relight::geometry::{KnownHeight, KnownLength};
use relight::graph::{
    Cancel, Diagnostic, GraphFile, MAX_FILE_BYTES, Overlay, Source, from_ron, is_name, open, read,
};
use relight::image::{NamedBytes, PhotoHeader, read_photo_header};

use super::args::{JobArgs, NewArgs, SceneFiles};
use super::check::check;
use super::engine::{engine, finished, options, stop_on_ctrl_c};
use super::exit::{CliError, Exit, Stop};
use super::load::{backend, setting};
use super::messages::{message, shows_progress};
use super::progress::Progress;
use super::results;
use super::{networks, report, shipped, write};
use capture::Capture;
pub use depth::GivenKind;
use depth::{DepthFacts, SceneDepth, depth_for, depth_in, read_depth};
use folder::SceneFolder;
use masks::Lights;
use text::{SceneText, edit_text};
use view::View;

/// The graphs of the steps: name in messages, and text.
const DEPTH: (&str, &str) = ("graphs/depth.ron", include_str!("../../graphs/depth.ron"));
const FIND: (&str, &str) = ("graphs/find_lights.ron", include_str!("../../graphs/find_lights.ron"));
const FIND_IN_PHOTO: (&str, &str) =
    ("graphs/find_lights_photo.ron", include_str!("../../graphs/find_lights_photo.ron"));
const LOOK: (&str, &str) = ("graphs/look.ron", include_str!("../../graphs/look.ron"));
/// The graph that the scene is checked with and that its first run takes.
const FIRST: &str = "indoor";

/// Runs `relight new`.
///
/// # Errors
/// Arguments or files that cannot be used.
pub fn new(args: &NewArgs, verbose: u8) -> Result<Exit, CliError> {
    match (Maker { args, verbose, cancel: Cancel::default() }).scene() {
        Ok(exit) => Ok(exit),
        Err(Stop::Ended(exit)) => Ok(exit),
        Err(Stop::Error(error)) => Err(error),
    }
}

/// A call of the command.
struct Maker<'a> {
    args: &'a NewArgs,
    verbose: u8,
    cancel: Cancel,
}

/// The results of a graph.
struct Ran {
    /// Name and bytes of each file.
    files: Vec<(String, Vec<u8>)>,
    /// The notes of a node `depth`.
    notes: Vec<String>,
}

/// The photo as it was given, and its camera.
struct Shot {
    bytes: Vec<u8>,
    header: PhotoHeader,
    /// The place that it was read from, and of a capture the frame in words.
    origin: String,
    /// The name of the copy.
    name: String,
    view: View,
}

impl Maker<'_> {
    fn scene(&self) -> Result<Exit, Stop> {
        let args = self.args;
        // Everything that a person gives is read before anything is written.
        let capture = self.capture()?;
        let shot = match &capture {
            Some(capture) => of_capture(capture, args.fov)?,
            None => shot(&args.photo, args.fov)?,
        };
        let given_depth = self.given_depth(&shot, capture)?;
        if let Some(network) = &args.depth_network {
            open(network, MAX_FILE_BYTES)
                .map_err(|e| Diagnostic::file(network, format!("cannot be read: {e}")))?;
        }
        let given_masks = args.masks.as_deref().map(masks::given).transpose()?;
        stop_on_ctrl_c(&self.cancel)?;

        let mut folder = SceneFolder::open(&args.out)?;
        folder.put(&shot.name, &shot.bytes)?;
        let depth = match given_depth {
            None if args.depth_network.is_some() => Some(self.network_depth(&folder, &shot)?),
            given => given,
        };
        let depth = place_depth(&mut folder, depth)?;
        let (width, height) = shot.header.size;
        message!("photo   {} ({width} x {height})", shot.origin);
        if let Some(profile) = &shot.header.profile {
            message!("color   profile \"{profile}\", converted to linear Rec. 709");
        }
        if shot.header.has_gain_map {
            message!("light   its gain map brings saturated highlights back");
        }
        message!("camera  {}: {}", shot.view.ron, shot.view.origin);
        match &depth {
            Some(origin) => message!("depth   {origin}"),
            None => message!("depth   missing"),
        }

        let of_person = folder.is_of_person("scene.ron");
        if of_person {
            message!("lights  those of scene.ron, which you changed: it is kept as it is");
        } else {
            let lights = self.lights(&mut folder, &shot, depth.as_deref(), given_masks)?;
            let text = scene_text(&shot, depth.as_deref(), &lights.field);
            folder.put("scene.ron", text.as_bytes())?;
            folder.put("edit.ron", edit_text(&lights.names).as_bytes())?;
            if lights.names.is_empty() {
                message!("lights  none in view");
            } else {
                message!("lights  {}", lights.names.join(" "));
            }
            lights.notes.iter().for_each(|note| message!("        {note}"));
        }
        if depth.is_some() {
            let scene = |kinds: &[&str]| scene::read(&args.out, Some(kinds));
            let Ran { files, .. } = self.run(LOOK, scene, &args.out)?;
            put_all(&mut folder, &files)?;
        }
        let (written, kept) = folder.close()?;
        write::print_paths(&written)?;
        self.told(&shot, depth.is_some(), &kept);
        self.checked()
    }

    /// Says what is guessed, kept and missing.
    fn told(&self, shot: &Shot, has_depth: bool, kept: &[String]) {
        if shot.view.is_guess {
            message!(
                "guessed: the field of view; where you know it, give it with --fov DEGREES and the same \
                 --out (docs/new.md tells how to find it)"
            );
        }
        kept.iter().for_each(|name| {
            message!("kept: {name}, which you made or changed; delete it to have it written again")
        });
        if !has_depth {
            message!(
                "missing: depth; give it with --depth FILE (a depth camera's or phone's, docs/new.md) \
                 or --depth-network ONNX --known-length X,Y,X,Y=METERS (docs/networks.md), with the \
                 same --out"
            );
        }
    }

    /// Runs `check` on the scene, and names the next command.
    fn checked(&self) -> Result<Exit, Stop> {
        let out = &self.args.out;
        let (graph, edit) = (shipped::graph(FIRST), out.join("edit.ron"));
        let Some(graph) = graph else {
            message!("not checked: the graph {FIRST} cannot be unpacked");
            return Ok(Exit::Done);
        };
        let files = SceneFiles {
            scene: Some(out.clone()),
            networks: self.args.networks.clone(),
            ..SceneFiles::default()
        };
        let job = JobArgs { graph, edit: Some(edit), files };
        let exit = check(&job)?;
        if exit != Exit::Done {
            return Ok(exit);
        }
        message!(
            "next: look at {}, then: relight run {FIRST} {} --scene {} --out {}",
            out.join("look.png").display(),
            out.join("edit.ron").display(),
            out.display(),
            out.join("out").display()
        );
        Ok(Exit::Done)
    }

    /// The frame of a folder in place of a photo.
    fn capture(&self) -> Result<Option<Capture>, Diagnostic> {
        let (photo, frame) = (&self.args.photo, self.args.frame);
        if photo.is_dir() {
            return capture::open(photo, frame).map(Some);
        }
        match frame {
            None => Ok(None),
            Some(_) => {
                let message = "wanted the folder of a capture as PHOTO, got one picture";
                Err(Diagnostic::file("--frame".as_ref(), message))
            }
        }
    }

    /// The depth of `--depth`, else that of a capture or in the photo, unless a network makes it.
    fn given_depth(
        &self,
        shot: &Shot,
        capture: Option<Capture>,
    ) -> Result<Option<SceneDepth>, Diagnostic> {
        let (path, file) = match (&self.args.depth, capture) {
            (Some(path), _) => (path.clone(), read_depth(path)?),
            (None, Some(capture)) if self.args.depth_network.is_none() => {
                (capture.depth_path, capture.depth)
            }
            (None, None) if shot.header.has_depth && self.args.depth_network.is_none() => {
                (self.args.photo.clone(), depth_in(&self.args.photo, &shot.bytes)?)
            }
            _ => return self.no_depth(),
        };
        let lengths =
            self.args.lengths.known_length.iter().map(|text| from_ron::<KnownLength>(text));
        let lengths: Vec<KnownLength> = lengths
            .collect::<Result<_, _>>()
            .map_err(|e| Diagnostic::file("--known-length".as_ref(), e.to_string()))?;
        let args = self.args;
        let height = args.room_height.map(KnownHeight::Ceiling);
        let facts = DepthFacts {
            kind: args.depth_kind,
            scale: args.depth_scale,
            lengths,
            height: height.or(args.camera_height.map(KnownHeight::Camera)),
        };
        depth_for(&path, file, &shot.view.camera, &facts).map(Some)
    }

    /// No depth is given; options about it are then a mistake.
    fn no_depth(&self) -> Result<Option<SceneDepth>, Diagnostic> {
        let args = self.args;
        let stated = [
            ("--depth-kind", args.depth_kind.is_some()),
            ("--depth-scale", args.depth_scale.is_some()),
            ("--room-height", args.room_height.is_some()),
        ];
        match stated.iter().find(|(_, is_stated)| *is_stated) {
            None => Ok(None),
            Some((option, _)) => {
                let message = "wanted a depth that it describes, got a photo without one";
                Err(Diagnostic::file(option.as_ref(), message).help("give it with --depth FILE"))
            }
        }
    }

    /// Depth by the network of `--depth-network`.
    fn network_depth(&self, folder: &SceneFolder, shot: &Shot) -> Result<SceneDepth, Stop> {
        let text = scene_text(shot, None, "");
        let source = Source::new(folder.path("scene.ron"), text);
        let scene = |kinds: &[&str]| scene::parse(&source, Some(kinds));
        let Ran { files, notes } = self.run(DEPTH, scene, &self.args.out)?;
        let exr = files.into_iter().find(|(name, _)| name == "depth.exr");
        let (_, exr) = exr.expect("WriteDepth returns depth.exr");
        let network = self.args.depth_network.as_deref().unwrap_or(Path::new(""));
        let note = notes.last().map_or("", String::as_str);
        let mut origin = format!("the network {} ({note})", network.display());
        let is_relative = note.contains(", relative, ");
        match (&*self.args.lengths.known_length, self.args.camera_height) {
            ([], Some(height)) if is_relative => {
                origin += &format!(", scaled by a camera {height} m above the seen floor");
            }
            ([], None) if is_relative => {
                let height = KnownHeight::default().meters();
                origin += &format!(", scaled by a camera {height} m above the seen floor, a guess");
            }
            ([], _) => {}
            ([_], _) => origin += ", scaled to a known length",
            (lengths, _) => origin += &format!(", scaled to {} known lengths", lengths.len()),
        }
        Ok(SceneDepth { exr, origin, notes: Vec::new() })
    }

    /// The lights: those given, those of masks that a person made or changed, else proposals.
    fn lights(
        &self,
        folder: &mut SceneFolder,
        shot: &Shot,
        depth: Option<&str>,
        given: Option<Lights>,
    ) -> Result<Lights, Stop> {
        let own = folder.path("masks");
        let lights = match given {
            Some(lights) => {
                folder.set_origin("masks", "--masks");
                lights
            }
            None if folder.has_masks_of_person()? => masks::given(&own)?,
            None => {
                let text = scene_text(shot, depth, "");
                let source = Source::new(folder.path("scene.ron"), text);
                let graph = if depth.is_some() { FIND } else { FIND_IN_PHOTO };
                let scene = |kinds: &[&str]| scene::parse(&source, Some(kinds));
                let Ran { files, .. } = self.run(graph, scene, &self.args.out)?;
                if depth.is_none()
                    && let Some((_, found)) = files.iter().find(|(name, _)| name == "found.png")
                {
                    folder.put("look.png", found)?;
                }
                masks::proposed(&files)
            }
        };
        put_all(folder, &lights.files)?;
        Ok(lights)
    }

    /// Runs one of the graphs above on a scene, and shows the notes of its outputs.
    fn run(
        &self,
        (name, text): (&str, &str),
        scene: impl FnOnce(&[&str]) -> Result<Overlay, Vec<Diagnostic>>,
        folder: &Path,
    ) -> Result<Ran, Stop> {
        let file = GraphFile::parse(Source::new(name, text))?;
        let kinds: Vec<&str> = file.nodes().map(|node| node.kind).collect();
        let registry = networks::registry(&self.args.networks);
        let mut overlay = scene(&kinds)?;
        overlay.settings.extend(backend(&registry, &self.args.networks, &kinds)?);
        let mut faults = Vec::new();
        let mut sets = self.args.set.clone();
        if let Some(network) = &self.args.depth_network {
            sets.push(format!("depth.model={:?}", network.to_string_lossy()));
            let lengths = self.args.lengths.known_length.join(", ");
            sets.push(format!("depth.known_lengths=[{lengths}]"));
            let height = self.args.camera_height.unwrap_or(KnownHeight::default().meters());
            sets.push(format!("depth.camera_height={height}"));
        }
        // A setting is for the one of the graphs that has its node.
        let has_node = |text: &&String| {
            let node = text.split(['.', '=']).next().unwrap_or("").trim();
            !is_name(node) || file.nodes().any(|other| other.name == node)
        };
        for text in sets.iter().filter(has_node) {
            overlay.settings.extend(setting(text, &mut faults));
        }
        if !faults.is_empty() {
            return Err(faults.into());
        }
        let graph = file.resolve(&registry, &overlay)?;
        let options = options(&self.args.cache, name.as_ref(), Some(folder))?;
        let progress = Progress::new(self.verbose > 0, shows_progress());
        let done = engine(options)?.run(&graph, &graph.wanted(None)?, &self.cancel, &progress);
        progress.end();
        let done = finished(done)?;
        report::warnings(&done).iter().for_each(|warning| message!("warning: {warning}"));
        report::notes_of_outputs(&done).for_each(|note| message!("        {note}"));
        let depth = done.nodes.iter().filter(|node| node.name == "depth");
        let notes = depth.flat_map(|node| node.notes.clone()).collect();
        let files = results::files(&done);
        Ok(Ran { files, notes })
    }
}

/// Reads the photo and finds its camera; a stated field of view in degrees beats EXIF.
fn shot(path: &Path, fov: Option<f32>) -> Result<Shot, Diagnostic> {
    let bytes = read(path, MAX_FILE_BYTES)
        .map_err(|e| Diagnostic::file(path, format!("cannot be read: {e}")))?;
    let header = header(path, &bytes)?;
    let name = format!("photo.{}", header.extension);
    let view = View::of_lens(&header, fov);
    Ok(Shot { bytes, origin: path.display().to_string(), name, view, header })
}

/// The photo of a capture, with the camera that the capture states unless a person states one.
fn of_capture(capture: &Capture, fov: Option<f32>) -> Result<Shot, Diagnostic> {
    let Capture { photo, photo_path, depth, origin, .. } = capture;
    let header = header(photo_path, photo)?;
    let view = match (fov, &depth.camera) {
        (None, Some(stated)) => View::of_capture(&header, stated)
            .map_err(|message| Diagnostic::file(photo_path, message))?,
        _ => View::of_lens(&header, fov),
    };
    let origin = format!("{} ({origin})", photo_path.display());
    let name = format!("photo.{}", header.extension);
    Ok(Shot { bytes: photo.clone(), origin, name, view, header })
}

fn header(path: &Path, bytes: &[u8]) -> Result<PhotoHeader, Diagnostic> {
    let name = path.display().to_string();
    read_photo_header(NamedBytes::new(&name, bytes))
        .map_err(|e| Diagnostic::file(path, e.message()))
}

fn scene_text(shot: &Shot, depth: Option<&str>, lights: &str) -> String {
    SceneText { photo: &shot.name, view: &shot.view, depth, lights }.ron()
}

/// Writes the depth, or finds the one that is there; returns its origin.
fn place_depth(
    folder: &mut SceneFolder,
    depth: Option<SceneDepth>,
) -> Result<Option<String>, Diagnostic> {
    const NAME: &str = "depth.exr";
    match depth {
        Some(depth) => {
            depth.notes.iter().for_each(|note| message!("warning: {note}"));
            if folder.put(NAME, &depth.exr)? {
                folder.set_origin(NAME, &depth.origin);
            }
        }
        None if !folder.path(NAME).is_file() => return Ok(None),
        None => {}
    }
    let origin = if folder.is_of_person(NAME) { None } else { folder.origin(NAME) };
    Ok(Some(origin.unwrap_or("the depth.exr that was there, in meters").to_owned()))
}

fn put_all(folder: &mut SceneFolder, files: &[(String, Vec<u8>)]) -> Result<(), Diagnostic> {
    files.iter().try_for_each(|(name, bytes)| folder.put(name, bytes).map(|_| ()))
}
