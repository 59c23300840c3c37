//! The results of `relight run`: where they go, and who computed them.

use std::path::PathBuf;
use std::sync::Arc;

use relight::graph::{
    Artifact, Diagnostic, EarlierResults, EngineOptions, MAX_FILE_BYTES, PortValue, ResolvedGraph,
    RunReport, Value, read,
};
use relight::image::without_provenance;
use relight::nodes::artifacts::Files;
use relight::nodes::output::write::PICTURES;

use super::args::RunArgs;
use super::write::Output;
use super::{engine, networks};

/// Options of the engine for a run.
///
/// # Errors
/// A named key file cannot be used.
pub fn engine_options(args: &RunArgs) -> Result<EngineOptions, Diagnostic> {
    let threads = args.threads.map(usize::from);
    let options = engine::options(&args.cache, &args.graph, args.files.scene.as_deref())?;
    let earlier = Arc::new(FolderOfResults(args.out.clone()));
    Ok(EngineOptions { threads, budget: args.budget, earlier: Some(earlier), ..options })
}

/// The folder that an earlier run wrote its pictures to. Those of a large photo are not in the
/// cache: where nothing changed, they need not be made again.
#[derive(Debug)]
struct FolderOfResults(PathBuf);

impl EarlierResults for FolderOfResults {
    fn value(&self, type_name: &str) -> Option<Value> {
        if type_name != Files::TYPE {
            return None;
        }
        let picture = |name: &str| {
            let bytes = read(&self.0.join(name), MAX_FILE_BYTES).ok()?;
            Some((name.to_owned(), without_provenance(bytes)?))
        };
        let files = PICTURES.into_iter().map(picture).collect::<Option<_>>()?;
        Some(Value::new(Arc::new(Files(files))))
    }
}

/// The folder for the results of a run; none with `--verify`, which only compares.
///
/// # Errors
/// The folder cannot be made.
pub fn output(args: &RunArgs, graph: &ResolvedGraph) -> Result<Option<Output>, Diagnostic> {
    let output = || Output::of_graph(&args.out, graph, args.edit.as_deref(), args.force);
    (!args.verify).then(output).transpose()
}

/// The backend of the networks of a run; none where no node has a network.
///
/// # Errors
/// A named library cannot be used.
pub fn backend_of(args: &RunArgs, run: &RunReport) -> Result<Option<networks::Choice>, Diagnostic> {
    let registry = networks::registry(&args.files.networks);
    let has_network = run.nodes.iter().any(|node| networks::has_network(&registry, node.kind));
    has_network.then(|| networks::choose(&args.files.networks)).transpose()
}

/// The files of a run, by name.
pub fn files(run: &RunReport) -> Vec<(String, Vec<u8>)> {
    results(run).iter().flat_map(|(_, files)| files.0.clone()).collect()
}

/// The files among the outputs of a run, by output.
pub fn results(run: &RunReport) -> Vec<(String, Arc<Files>)> {
    let values = run.outputs.iter().flat_map(|(output, value)| {
        let values = match value {
            PortValue::One(value) => vec![value],
            PortValue::Many(values) => values.iter().map(|(_, value)| value).collect(),
            PortValue::Missing => Vec::new(),
        };
        values.into_iter().map(move |value| (output, value))
    });
    values.filter_map(|(output, value)| Some((output.clone(), value.get()?))).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use relight::image::{
        Compression, ExrLayers, Picture, Plane, Transfer, with_provenance, write_png,
    };

    use super::*;

    #[test]
    fn a_folder_has_the_pictures_without_their_records() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let earlier = FolderOfResults(folder.path().to_owned());
        let value = || earlier.value(Files::TYPE).map(|value| value.digest());
        assert_eq!(value(), None);
        let picture = Picture(Plane::from_fn(9, 5, |x, y| Vec3::new(x as f32, y as f32, 1.0)));
        let mut layers = ExrLayers::new(9, 5);
        layers.rgb("", &picture.0);
        let exr = layers.write(Compression::Zip).expect("it can be written");
        let plain = [write_png(&picture, Transfer::Srgb, false), exr];
        for record in ["one", "a longer one"] {
            for (name, bytes) in PICTURES.into_iter().zip(&plain) {
                let file = with_provenance(bytes, record).expect("it takes a record").concat();
                std::fs::write(folder.path().join(name), file).expect("it can be written");
            }
            let files = PICTURES.into_iter().map(str::to_owned).zip(plain.clone()).collect();
            assert_eq!(value(), Some(Value::new(Arc::new(Files(files))).digest()));
        }
        assert!(earlier.value("Picture").is_none());
        std::fs::remove_file(folder.path().join(PICTURES[1])).expect("it is there");
        assert_eq!(value(), None);
    }
}
