//! How a picture was made: a record inside each PNG and EXR file of a run.

mod explain;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Component, Path};
use std::sync::Arc;
use std::time::Duration;

use relight::graph::{Diagnostic, MAX_FILE_BYTES, ResolvedGraph, open, plain_error};
use relight::image::{read_provenance, with_provenance};
use relight::nodes::artifacts::Files;
use serde::{Deserialize, Serialize};

use super::args::RunArgs;

pub use explain::explain;

/// Bytes of a picture that hold its record: EXIF and color profile, or other attributes, may come
/// before it.
const BEGINNING: u64 = 8 << 20;

/// Everything that decides a picture. It depends on no path outside of the scene's folder: the
/// same inputs give the same bytes in every folder.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program.
    relight: String,
    /// Name of the graph file, without folder and ending.
    graph: String,
    /// The output that the file is of.
    output: String,
    /// Text of the edit file; `None` where nothing is changed.
    edit: Option<String>,
    /// Number of the picture in a sequence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    frame: Option<u32>,
    /// Time limit of a light in seconds, with which results depend on the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    budget: Option<f64>,
    /// Digests of the files that the stages read, by the paths that scene, graph and
    /// edit give, or names alone.
    files: BTreeMap<String, String>,
    /// Digest of all that decides the picture: stages, their versions, parameters and files.
    inputs: String,
    /// Weights of the lights by `relight mix` after the run.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    mix: BTreeMap<String, [f32; 3]>,
}

/// A file by its name, in pieces.
pub type Pieces<'a> = (String, Vec<Cow<'a, [u8]>>);

/// The inputs of a run, as its arguments name them.
pub struct Inputs<'a> {
    pub graph: &'a Path,
    pub budget: Option<Duration>,
    /// Text of the edit.
    pub edit: Option<&'a str>,
    pub frame: Option<u32>,
}

impl<'a> Inputs<'a> {
    /// Those of a run with the edit of the text `edit`.
    pub fn new(args: &'a RunArgs, edit: Option<&'a str>, frame: Option<u32>) -> Inputs<'a> {
        Inputs { graph: &args.graph, budget: args.budget, edit, frame }
    }

    /// The record of files that `output` of the resolved `graph` gives.
    ///
    /// # Errors
    /// The graph does not have the output.
    fn provenance(&self, graph: &ResolvedGraph, output: &str) -> Result<Provenance, Diagnostic> {
        // As its text names it, from the folder of the text; but no path of this machine.
        let name = |path: &str| {
            let is_below = Path::new(path).components().all(|c| matches!(c, Component::Normal(_)));
            let name = Path::new(path).file_name().filter(|_| !is_below);
            name.map_or(path.into(), |name| name.to_string_lossy().into_owned())
        };
        let wanted = graph.wanted(Some(&[output.to_owned()]))?;
        let files = graph.files(&wanted);
        let files = files.map(|(file, digest)| (name(&file.path), digest.to_string()));
        Ok(Provenance {
            relight: env!("CARGO_PKG_VERSION").into(),
            graph: self.graph.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            output: output.into(),
            edit: self.edit.map(str::to_owned),
            frame: self.frame,
            budget: self.budget.map(|budget| budget.as_secs_f64()),
            files: files.collect(),
            inputs: graph.digest(&wanted).to_string(),
            mix: BTreeMap::new(),
        })
    }

    /// The files of the outputs of a run, each with its record where its format takes one.
    ///
    /// # Errors
    /// The graph does not have one of the outputs.
    pub fn stamp<'f>(
        &self,
        graph: &ResolvedGraph,
        results: &'f [(String, Arc<Files>)],
    ) -> Result<Vec<Pieces<'f>>, Diagnostic> {
        let mut all = Vec::new();
        for (output, files) in results {
            all.extend(stamped(Some(&self.provenance(graph, output)?), &files.0));
        }
        Ok(all)
    }
}

impl Provenance {
    /// The record inside a picture.
    ///
    /// # Errors
    /// The file cannot be read, or has no record, or one of another form.
    pub fn read(picture: &Path) -> Result<Provenance, Diagnostic> {
        let fault = |message: String| Diagnostic::file(picture, message);
        let unreadable = |e| fault(format!("cannot be read: {}", plain_error(e)));
        let file = open(picture, MAX_FILE_BYTES).map_err(unreadable)?;
        let mut bytes = Vec::new();
        file.take(BEGINNING).read_to_end(&mut bytes).map_err(unreadable)?;
        let text = read_provenance(&bytes).ok_or_else(|| {
            let wanted = "wanted a PNG or EXR picture with the record of its making";
            fault(format!("{wanted}, as `relight run` writes it, got none"))
        })?;
        serde_json::from_str(text)
            .map_err(|e| fault(format!("the record of its making cannot be read: {e}")))
    }

    /// The record of a picture that `weights` make of one with this record.
    pub fn mixed(mut self, weights: &BTreeMap<String, [f32; 3]>) -> Provenance {
        for (light, weight) in weights {
            let before = self.mix.entry(light.clone()).or_insert([1.0; 3]);
            before.iter_mut().zip(weight).for_each(|(before, weight)| *before *= weight);
        }
        self
    }
}

/// The files, each with the record where there is one and the format takes it.
pub fn stamped<'f>(record: Option<&Provenance>, files: &'f [(String, Vec<u8>)]) -> Vec<Pieces<'f>> {
    let text = record
        .map(|record| serde_json::to_string(record).expect("text and finite numbers are JSON"));
    let pieces = |(name, bytes): &'f (String, Vec<u8>)| {
        let with = text.as_ref().and_then(|text| with_provenance(bytes, text));
        (name.clone(), with.unwrap_or_else(|| vec![Cow::Borrowed(bytes)]))
    };
    files.iter().map(pieces).collect()
}
