//! The tasks of a batch, and the files that a scheduler runs them by: a job array of Slurm, or a
//! template of Open Job Description.
//!
//! A photo's jobs share most of their stages, so a task has all jobs of a photo where it can. A
//! photo with more jobs than a task takes, or a film, has a first task for its first job, which
//! computes what the others share; they follow once it has ended. A task that finds the shared part
//! missing computes it, so the order saves time and decides no result.

use std::path::{Path, PathBuf};

use relight::graph::Diagnostic;
use serde_json::json;

use super::args::BatchArgs;
use super::list::{Job, List};
use crate::cli::args::WhichBackend;
use crate::cli::exit::{CliError, Exit};
use crate::cli::messages::message;
use crate::cli::write::{self, Output};

/// Tasks in one array of Slurm, whose default limit is 1001.
const ARRAY: u32 = 1000;

/// Tasks of a plan: the numbers below `shared` compute first jobs, those from there to `count` the
/// others.
struct Tasks {
    shared: u32,
    count: u32,
    /// The task of each job.
    of: Vec<u32>,
}

/// Writes the files of a plan.
///
/// # Errors
/// The kind of plan, or the folder, cannot be used.
pub fn write(args: &BatchArgs, list: &List, target: &[String]) -> Result<Exit, CliError> {
    let [kind, folder] = target else { unreachable!("clap takes two values") };
    if !["slurm", "openjd"].contains(&kind.as_str()) {
        let message = format!("wanted `slurm` or `openjd`, got `{kind}`");
        return Err(Diagnostic::file("--plan".as_ref(), message).help("--plan slurm DIR").into());
    }
    let tasks = Tasks::of(list, args.jobs_per_task as usize);
    let out = Output::new(folder.as_ref(), [], false)?;
    let folder = absolute(folder.as_ref())?;
    let command = Command::new(args, &folder)?;
    let mut files =
        vec![("jobs.ron", jobs_ron(list)?.into_bytes()), ("jobs.csv", jobs_csv(list, &tasks)?)];
    if kind == "slurm" {
        std::fs::create_dir_all(folder.join("log"))
            .map_err(|e| Diagnostic::file(&folder, format!("the folder cannot be made: {e}")))?;
        files.push(("task.sbatch", command.task_script().into_bytes()));
        files.push(("finish.sbatch", command.finish_script().into_bytes()));
        files.push(("submit.sh", submit_script(&folder, &tasks).into_bytes()));
    } else {
        files.push(("template.json", command.template(&tasks).into_bytes()));
    }
    let paths = out.write(&files)?;
    message!(
        "{} jobs in {} tasks, {} of them shared parts that come first; submit with {}",
        list.jobs.len(),
        tasks.count,
        tasks.shared,
        if kind == "slurm" { "`bash submit.sh`" } else { "`openjd run` or your farm" }
    );
    write::print_paths(&paths)?;
    Ok(Exit::Done)
}

impl Tasks {
    fn of(list: &List, most: usize) -> Tasks {
        let all: Vec<usize> = (0..list.jobs.len()).collect();
        let photos = list.photos(&all);
        let is_large = |photo: &&Vec<usize>| photo.len() > most;
        let shared = photos.iter().filter(is_large).count() as u32;
        let mut of = vec![0; list.jobs.len()];
        let (mut first, mut next, mut room) = (0, shared, 0);
        for photo in &photos {
            if photo.len() > most {
                of[photo[0]] = first;
                first += 1;
                for chunk in photo[1..].chunks(most) {
                    chunk.iter().for_each(|&job| of[job] = next);
                    next += 1;
                }
                room = 0;
            } else {
                if photo.len() > room {
                    (next, room) = (next + 1, most);
                }
                room -= photo.len();
                photo.iter().for_each(|&job| of[job] = next - 1);
            }
        }
        Tasks { shared, count: next, of }
    }
}

fn absolute(path: &Path) -> Result<PathBuf, Diagnostic> {
    std::path::absolute(path)
        .map_err(|e| Diagnostic::file(path, format!("its place cannot be determined: {e}")))
}

/// A path as text.
fn text(path: &Path) -> Result<String, Diagnostic> {
    let path = absolute(path)?;
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| Diagnostic::file(&path, "wanted a path in UTF-8"))
}

fn jobs_ron(list: &List) -> Result<String, Diagnostic> {
    let graph =
        if list.graph.is_file() { text(&list.graph)? } else { list.graph.display().to_string() };
    let out = text(&list.out)?;
    Ok(format!(
        "// A batch with its patterns looked up, by `relight batch --plan`.\nBatch(\n    version: 1,\n    graph: {graph:?},\n    table: \"jobs.csv\",\n    out: {out:?},\n)\n"
    ))
}

/// The table of all jobs, with settings in columns of their own.
fn jobs_csv(list: &List, tasks: &Tasks) -> Result<Vec<u8>, Diagnostic> {
    let setting = |text: &str| {
        text.split_once('=').map(|(name, value)| (name.trim().to_owned(), value.to_owned()))
    };
    let mut names: Vec<String> = list
        .jobs
        .iter()
        .flat_map(|job| &job.set)
        .filter_map(|text| Some(setting(text)?.0))
        .collect();
    names.sort();
    names.dedup();
    let mut table = csv::Writer::from_writer(Vec::new());
    let mut write = |row: Vec<String>| {
        table.write_record(row).expect("rows have equal lengths, and a vector takes all");
    };
    let columns = ["task", "scene", "edit", "first", "last", "out"].map(str::to_owned);
    write(columns.into_iter().chain(names.iter().cloned()).collect());
    for (job, task) in list.jobs.iter().zip(&tasks.of) {
        let Job { scene, edit, frames, out, set, .. } = job;
        let number = |n: Option<u32>| n.map_or(String::new(), |n| n.to_string());
        let edit = edit.as_ref().map_or(Ok(String::new()), |edit| text(edit))?;
        let mut row = vec![
            task.to_string(),
            text(scene)?,
            edit,
            number(frames.as_ref().map(|frames| frames.start)),
            number(frames.as_ref().map(|frames| frames.end - 1)),
            out.display().to_string(),
        ];
        row.extend(names.iter().map(|name| {
            let mut values = set.iter().filter_map(|text| setting(text));
            values.rfind(|(of, _)| of == name).map_or(String::new(), |(_, value)| value)
        }));
        write(row);
    }
    Ok(table.into_inner().expect("a vector takes all"))
}

/// The command of a task: program, list, and the options of this call that change results or name
/// the cache.
struct Command {
    program: String,
    list: String,
    options: Vec<String>,
}

impl Command {
    fn new(args: &BatchArgs, folder: &Path) -> Result<Command, Diagnostic> {
        let program =
            std::env::current_exe().ok().and_then(|path| path.to_str().map(str::to_owned));
        let mut options = Vec::new();
        let mut option = |name: &str, path: &Option<PathBuf>| {
            if let Some(path) = path {
                options.extend([name.to_owned(), text(path)?]);
            }
            Ok::<(), Diagnostic>(())
        };
        option("--cache", &args.cache.at.cache)?;
        option("--cache-key", &args.cache.at.cache_key)?;
        option("--models", &args.networks.models)?;
        option("--onnxruntime", &args.networks.onnxruntime)?;
        #[cfg(feature = "store")]
        if let Some(url) = &args.cache.cache_store {
            // Refused here and not in each task.
            crate::cli::store::check(url)?;
            options.extend(["--cache-store".to_owned(), url.clone()]);
        }
        match args.networks.backend {
            WhichBackend::Auto => {}
            WhichBackend::Ort => options.extend(["--backend".to_owned(), "ort".to_owned()]),
            WhichBackend::Rten => options.extend(["--backend".to_owned(), "rten".to_owned()]),
        }
        for (set, name) in
            [(args.cache.no_cache, "--no-cache"), (args.confined.confined, "--confined")]
        {
            if set {
                options.push(name.to_owned());
            }
        }
        if let Some(memory) = args.memory {
            options.extend(["--memory".to_owned(), memory.to_string()]);
        }
        let program = program.unwrap_or_else(|| "relight".to_owned());
        Ok(Command { program, list: text(&folder.join("jobs.ron"))?, options })
    }

    fn line(&self, more: &str) -> String {
        let options: Vec<String> = self.options.iter().map(|option| shell(option)).collect();
        format!("{} batch {} {more} {}", shell(&self.program), shell(&self.list), options.join(" "))
    }

    fn task_script(&self) -> String {
        let line = self.line(
            "--task $((FIRST + SLURM_ARRAY_TASK_ID)) --threads \"${SLURM_CPUS_PER_TASK:-1}\"",
        );
        format!(
            "#!/bin/bash\n#SBATCH --job-name=relight\n#SBATCH --requeue\nexec {}\n",
            line.trim_end()
        )
    }

    fn finish_script(&self) -> String {
        let list = shell(&self.list);
        let program = shell(&self.program);
        format!(
            "#!/bin/bash\n#SBATCH --job-name=relight-finish\n#SBATCH --requeue\nexec {program} batch {list} --finish\n"
        )
    }

    fn template(&self, tasks: &Tasks) -> String {
        let program = "{{Param.Program}}";
        let run = |more: &[&str], options: &[String]| {
            let mut args = vec!["batch".to_owned(), "{{Param.Jobs}}".to_owned()];
            args.extend(more.iter().map(|&text| text.to_owned()));
            args.extend(options.iter().cloned());
            json!({ "actions": { "onRun": { "command": program, "args": args } } })
        };
        let step = |name: &str, first: u32, last: u32, after: Option<&str>| {
            let mut step = json!({
                "name": name,
                "parameterSpace": {
                    "taskParameterDefinitions": [
                        { "name": "Task", "type": "INT", "range": format!("{first}-{last}") },
                    ],
                },
                "script": run(&["--task", "{{Task.Param.Task}}"], &self.options),
            });
            if let Some(after) = after {
                step["dependencies"] = json!([{ "dependsOn": after }]);
            }
            step
        };
        let mut steps = Vec::new();
        let mut last = None;
        if tasks.shared > 0 {
            steps.push(step("Shared", 0, tasks.shared - 1, None));
            last = Some("Shared");
        }
        if tasks.count > tasks.shared {
            steps.push(step("Edits", tasks.shared, tasks.count - 1, last));
            last = Some("Edits");
        }
        let mut finish = json!({ "name": "Finish", "script": run(&["--finish"], &[]) });
        if let Some(last) = last {
            finish["dependencies"] = json!([{ "dependsOn": last }]);
        }
        steps.push(finish);
        let template = json!({
            "specificationVersion": "jobtemplate-2023-09",
            "name": "relight",
            "parameterDefinitions": [
                { "name": "Program", "type": "STRING", "default": self.program,
                  "description": "The program relight on a worker." },
                { "name": "Jobs", "type": "STRING", "default": self.list,
                  "description": "The list of jobs, in a folder that workers share." },
            ],
            "steps": steps,
        });
        serde_json::to_string_pretty(&template).expect("a template holds text and numbers") + "\n"
    }
}

/// Submits the arrays; `sbatch` takes further options from the arguments.
fn submit_script(folder: &Path, tasks: &Tasks) -> String {
    let mut script = format!(
        "#!/bin/bash\n# Submits {} tasks; arguments go to sbatch: bash submit.sh --cpus-per-task=4 --mem=8G\nset -euo pipefail\ncd {}\n",
        tasks.count,
        shell(&folder.to_string_lossy())
    );
    script.push_str("sub() { sbatch --parsable --output=log/%A_%a.txt \"$@\"; }\n");
    let mut arrays = |variable: &str, tasks: std::ops::Range<u32>, after: &str| {
        script.push_str(&format!("{variable}=\n"));
        for first in tasks.clone().step_by(ARRAY as usize) {
            let last = (tasks.end - first).min(ARRAY) - 1;
            script.push_str(&format!(
                "id=$(sub \"$@\" --export=ALL,FIRST={first} --array=0-{last}{after} task.sbatch)\n{variable}=\"${variable}:$id\"\n"
            ));
        }
    };
    // `afterany`: a task that fails stops no other, which then computes the shared part itself.
    arrays("shared", 0..tasks.shared, "");
    let after = if tasks.shared > 0 { " --dependency=\"afterany$shared\"" } else { "" };
    arrays("edits", tasks.shared..tasks.count, after);
    let last = if tasks.count > tasks.shared { "$edits" } else { "$shared" };
    script.push_str(&format!(
        "finish=$(sub --output=log/finish.txt --dependency=\"afterany{last}\" finish.sbatch)\necho \"$finish\"\n"
    ));
    script
}

/// A word of the shell.
fn shell(text: &str) -> String {
    let is_plain =
        |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.' | '/' | ':' | '=' | ',');
    if !text.is_empty() && text.chars().all(is_plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list of photos with these numbers of jobs.
    fn list(photos: &[usize]) -> List {
        let jobs = photos.iter().enumerate().flat_map(|(photo, &jobs)| {
            (0..jobs).map(move |job| Job {
                scene: format!("photo{photo}").into(),
                edit: None,
                frames: None,
                set: Vec::new(),
                out: format!("{photo}/{job}").into(),
                task: None,
            })
        });
        List::of_jobs(jobs.collect())
    }

    #[test]
    fn a_task_has_whole_photos_or_follows_their_shared_part() {
        let tasks = Tasks::of(&list(&[2, 2, 7, 1, 3, 2]), 4);
        assert_eq!((tasks.shared, tasks.count), (1, 6));
        // Photos 0 and 1 in one task; photo 2 in a shared part and two chunks; the others packed.
        assert_eq!(tasks.of, [1, 1, 1, 1, 0, 2, 2, 2, 2, 3, 3, 4, 4, 4, 4, 5, 5]);
    }

    #[test]
    fn words_of_the_shell_are_quoted() {
        assert_eq!(shell("/a/b.ron"), "/a/b.ron");
        assert_eq!(shell("a b"), "'a b'");
        assert_eq!(shell("it's $(rm)"), r"'it'\''s $(rm)'");
    }
}
