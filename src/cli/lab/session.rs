//! A graph that runs under changing parameters, on one engine that keeps all unchanged results.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use relight::graph::{
    Artifact, Cancel, Diagnostic, Engine, EngineOptions, GraphFile, PortValue, RunReport, Value,
};

use relight_lab::bench::ParamSetting;

use super::args::Bench;
use crate::cli::args::SceneFiles;
use crate::cli::engine::{engine, finished, stop_on_ctrl_c};
use crate::cli::exit::Stop;
use crate::cli::load::load;

/// A result, with the wall time and the number of rays of its node or run.
pub struct Timed<T> {
    pub value: Arc<T>,
    pub seconds: f64,
    pub rays: u64,
}

/// A node of the graph file: its name, its kind, and its set where there is an instance per member.
struct NodeOf {
    name: String,
    kind: String,
    each: Option<String>,
}

/// A graph on a scene, and the engine that runs it.
pub struct Session {
    graph: PathBuf,
    scene: Option<PathBuf>,
    /// Settings of the command line.
    set: Vec<String>,
    nodes: Vec<NodeOf>,
    engine: Engine,
    threads: Option<usize>,
    cancel: Cancel,
    seed: Cell<u64>,
}

impl Session {
    /// Reads the graph and starts an engine without a disk cache; Ctrl-C stops its runs.
    ///
    /// # Errors
    /// The graph cannot be read, or the engine cannot be started.
    pub fn new(args: &Bench) -> Result<Session, Stop> {
        let mut file = GraphFile::read(&args.graph)?;
        file.accept_old_names(&relight::nodes::registry());
        let nodes = file.nodes().map(|node| NodeOf {
            name: node.name.to_owned(),
            kind: node.kind.to_owned(),
            each: node.each.map(str::to_owned),
        });
        let nodes = nodes.collect();
        let scene = args.scene.clone().map_or_else(|| file.scene(), |scene| Ok(Some(scene)))?;
        let threads = args.threads.map(usize::from);
        let cancel = Cancel::default();
        stop_on_ctrl_c(&cancel)?;
        let engine = engine(EngineOptions { threads, ..EngineOptions::default() })?;
        let (graph, set) = (args.graph.clone(), args.set.clone());
        Ok(Session { graph, scene, set, nodes, engine, threads, cancel, seed: Cell::new(1) })
    }

    /// Returns the path of the scene, if one was given.
    pub fn scene(&self) -> Option<&Path> {
        self.scene.as_deref()
    }

    /// Returns the number of the engine's worker threads.
    pub fn threads(&self) -> usize {
        self.engine.threads()
    }

    /// A seed that was not used before: a cached result would not take any run time.
    pub fn seed(&self) -> u64 {
        self.seed.replace(self.seed.get() + 1)
    }

    /// The name of the first node of a kind.
    ///
    /// # Errors
    /// The graph has none.
    pub fn node(&self, kind: &str) -> Result<&str, Stop> {
        let node = self.nodes.iter().find(|node| node.kind == kind);
        Ok(&node.ok_or_else(|| self.lacks(kind, ""))?.name)
    }

    /// The names of the nodes `Direct` and `Shadow` of one set of lights.
    ///
    /// # Errors
    /// The graph has none.
    pub fn layers(&self) -> Result<(&str, &str), Stop> {
        let direct = self.nodes.iter().find(|node| node.kind == "Direct" && node.each.is_some());
        let direct = direct.ok_or_else(|| self.lacks("Direct", " of each light"))?;
        let shadow =
            self.nodes.iter().find(|node| node.kind == "Shadow" && node.each == direct.each);
        Ok((
            &direct.name,
            &shadow.ok_or_else(|| self.lacks("Shadow", " of the same lights as Direct"))?.name,
        ))
    }

    fn lacks(&self, kind: &str, which: &str) -> Diagnostic {
        Diagnostic::file(
            &self.graph,
            format!("wanted a graph with a stage {kind}{which}, got none"),
        )
    }

    /// The members of a node that has one instance per light.
    ///
    /// # Errors
    /// Those of the graph.
    pub fn members(&self, node: &str) -> Result<Vec<String>, Stop> {
        let graph = load(&self.graph, None, &self.files(&[]))?;
        let member = |name: &str| {
            Some(name.strip_prefix(node)?.strip_prefix('[')?.strip_suffix(']')?.to_owned())
        };
        Ok(graph.instances().filter_map(member).collect())
    }

    /// One output, with the cost of its node.
    ///
    /// # Errors
    /// Those of the graph and its run.
    pub fn make<T: Artifact>(
        &self,
        node: &str,
        port: &str,
        settings: &[ParamSetting],
    ) -> Result<Timed<T>, Stop> {
        let output = format!("{node}.{port}");
        let report = self.run(&self.engine, settings, std::slice::from_ref(&output))?;
        let of_node = report
            .nodes
            .iter()
            .find(|n| n.name == node)
            .expect("a node that gave its output is reported");
        Ok(Timed {
            value: self.one(&report, &output)?,
            seconds: of_node.seconds,
            rays: of_node.rays,
        })
    }

    /// The values of an output, member by member.
    ///
    /// # Errors
    /// Those of the graph and its run.
    pub fn members_of<T: Artifact>(&self, node: &str, port: &str) -> Result<Vec<Arc<T>>, Stop> {
        let output = format!("{node}.{port}");
        let report = self.run(&self.engine, &[], std::slice::from_ref(&output))?;
        Ok(match report.output(&output) {
            Some(PortValue::Many(values)) => {
                values.iter().filter_map(|(_, value)| Value::get(value)).collect()
            }
            _ => Vec::new(),
        })
    }

    /// One output under each group of settings, on a new engine; the seconds are those of whole
    /// runs.
    ///
    /// # Errors
    /// Those of the graph and its runs.
    pub fn make_anew<T: Artifact>(
        &self,
        node: &str,
        port: &str,
        settings: &[Vec<ParamSetting>],
    ) -> Result<Vec<Timed<T>>, Stop> {
        let fresh = engine(EngineOptions { threads: self.threads, ..EngineOptions::default() })?;
        let output = format!("{node}.{port}");
        let made = settings.iter().map(|group| {
            let report = self.run(&fresh, group, std::slice::from_ref(&output))?;
            let value = self.one(&report, &output)?;
            Ok(Timed {
                value,
                seconds: report.seconds,
                rays: report.nodes.iter().map(|node| node.rays).sum(),
            })
        });
        made.collect()
    }

    fn one<T: Artifact>(&self, report: &RunReport, output: &str) -> Result<Arc<T>, Stop> {
        let value = match report.output(output) {
            Some(PortValue::One(value)) => value.get(),
            _ => None,
        };
        Ok(value.ok_or_else(|| {
            Diagnostic::file(&self.graph, format!("`{output}`: bench cannot measure this type"))
        })?)
    }

    fn files(&self, settings: &[ParamSetting]) -> SceneFiles {
        let mut set = self.set.clone();
        for (kind, field, value) in settings {
            let named = self.nodes.iter().filter(|node| node.kind == *kind);
            set.extend(named.map(|node| format!("{}.{field}={value}", node.name)));
        }
        SceneFiles { scene: self.scene.clone(), set, ..SceneFiles::default() }
    }

    fn run(
        &self,
        engine: &Engine,
        settings: &[ParamSetting],
        wanted: &[String],
    ) -> Result<RunReport, Stop> {
        let graph = load(&self.graph, None, &self.files(settings))?;
        finished(engine.run(&graph, &graph.wanted(Some(wanted))?, &self.cancel, &()))
    }
}
