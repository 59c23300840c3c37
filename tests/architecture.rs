//! Rules of the architecture: dependencies between modules, items that the library must not use,
//! and agreement of pages and files.
//!
//! Each rule is a function from text to faults, shown by a test of its own to see a planted fault.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use needs::needs;

/// Room of `src` -> the modules that it may use.
const ARROWS: [(&str, &[&str]); 10] = [
    ("cli", &["files", "nodes", "graph", "net", "tuning", "geometry", "image"]),
    ("files", &["graph"]),
    ("nodes", &["graph", "formats", "image", "optics", "geometry", "net", "tuning"]),
    ("formats", &["image", "optics", "geometry"]),
    ("net", &["geometry", "image", "tuning"]),
    ("optics", &["geometry", "image", "tuning"]),
    ("geometry", &["image", "tuning"]),
    ("image", &["tuning"]),
    ("tuning", &[]),
    ("graph", &[]),
];

/// Modules of `src/optics`, each of which may use only those before it.
const LAYERS: [&str; 6] = ["sampling", "emitter", "daylight", "transport", "reflection", "inverse"];

/// Modules that all stages share.
const SHARED: [&str; 2] = ["artifacts", "neural"];

/// Words of code -> the folders or files of `src` that may contain them.
const WORDS: [(&str, &[&str]); 16] = [
    ("exr::", &["image/io/"]),
    ("ort::", &["net/"]),
    ("rten::", &["net/"]),
    ("print!", &["cli/", "main.rs"]),
    ("println!", &["cli/", "main.rs"]),
    ("eprint!", &["cli/", "main.rs"]),
    ("eprintln!", &["cli/", "main.rs"]),
    // The answers of a child process.
    ("stdout", &["cli/", "main.rs", "net/sandbox.rs"]),
    // A child process holds a network that does not ship.
    ("std::process", &["cli/", "main.rs", "net/sandbox.rs"]),
    ("std::env", &["cli/", "main.rs"]),
    // The child lists the files that it has inherited.
    ("std::fs", &["cli/", "main.rs", "graph/", "files/", "net/guest.rs"]),
    // Its time is limited.
    ("Instant", &["cli/", "main.rs", "graph/", "net/sandbox.rs"]),
    ("SystemTime", &["cli/", "main.rs", "graph/disk.rs"]),
    ("thread_local!", &[]),
    ("thread_rng", &[]),
    ("RandomState", &[]),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files below `folder`, relative to the project, in order.
fn files_below(folder: &str) -> Vec<String> {
    let mut files = Vec::new();
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).expect("the folder can be listed") {
            let path = folder.join(entry.expect("it can be listed").file_name());
            if root().join(&path).is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
        .iter()
        .map(|path| path.to_str().expect("our names are ASCII").replace('\\', "/"))
        .collect()
}

/// Files that git tracks or would add.
fn tracked() -> Vec<String> {
    let list = ["ls-files", "--cached", "--others", "--exclude-standard"];
    // Git lists a repository of another user only if that is called safe.
    let mut git = Command::new("git");
    let output = git
        .args(["-c", "safe.directory=*"])
        .args(list)
        .current_dir(root())
        .output()
        .expect("git starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("our names are ASCII");
    // A deleted file is listed until the deletion is staged.
    text.lines().filter(|path| root().join(path).exists()).map(str::to_owned).collect()
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

#[track_caller]
fn assert_none(faults: Vec<String>) {
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// Rust without comments and without the content of strings and characters; lines and columns are
/// kept.
fn code(text: &str) -> String {
    let mut rest = text;
    let mut out = String::new();
    while let Some(first) = rest.chars().next() {
        let inside_word = out.ends_with(|c: char| c.is_alphanumeric() || c == '_');
        let hashes =
            rest.strip_prefix('r').map_or(0, |r| r.len() - r.trim_start_matches('#').len());
        let end = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            let mut depth = 0;
            let at = rest.char_indices().find_map(|(i, _)| {
                depth += i32::from(rest[i..].starts_with("/*"))
                    - i32::from(i > 1 && rest[..i].ends_with("*/"));
                (i > 1 && depth == 0).then_some(i)
            });
            at.unwrap_or(rest.len())
        } else if first == 'r' && !inside_word && rest[1 + hashes..].starts_with('"') {
            let close = format!("\"{}", "#".repeat(hashes));
            let from = hashes + 2;
            rest[from..].find(&close).map_or(rest.len(), |i| from + i + close.len())
        } else if first == '"' {
            let mut escaped = false;
            let close = rest[1..].char_indices().find(|&(_, c)| {
                let closes = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                closes
            });
            close.map_or(rest.len(), |(i, _)| i + 2)
        } else if rest.starts_with("'\\") {
            rest[3..].find('\'').map_or(rest.len(), |i| i + 4)
        } else if first == '\'' && rest.chars().nth(2) == Some('\'') {
            rest.char_indices().nth(3).map_or(rest.len(), |(i, _)| i)
        } else {
            out.push(first);
            rest = &rest[first.len_utf8()..];
            continue;
        };
        out.extend(rest[..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        rest = &rest[end..];
    }
    out
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Line numbers of `word` in code; it is not part of a longer name.
fn lines_with(code: &str, word: &str) -> Vec<usize> {
    let alone = |at: usize| {
        let after = &code[at + word.len()..];
        let joined = word.ends_with(is_word) && after.starts_with(is_word);
        !joined && !code[..at].ends_with(is_word)
    };
    let places = code.match_indices(word).filter(|&(at, _)| alone(at));
    places.map(|(at, _)| 1 + code[..at].matches('\n').count()).collect()
}

/// The paths of code that begin with `crate`, `relight` or `super`, groups written out: `a::{b, c}`
/// is `a::b` and `a::c`.
fn paths(code: &str) -> Vec<(usize, Vec<String>)> {
    fn walk(mut rest: &str, mut path: Vec<String>, out: &mut Vec<Vec<String>>) -> usize {
        let all = rest.len();
        loop {
            rest = rest.trim_start();
            if let Some(inner) = rest.strip_prefix('{') {
                rest = inner;
                while !rest.is_empty() && !rest.starts_with('}') {
                    rest = &rest[walk(rest, path.clone(), out)..];
                    rest = rest.trim_start_matches(|c: char| c != ',' && c != '}');
                    rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
                }
                return all - rest.strip_prefix('}').unwrap_or(rest).len();
            }
            let name = &rest[..rest.find(|c| !is_word(c)).unwrap_or(rest.len())];
            rest = &rest[name.len()..];
            if !name.is_empty() {
                path.push(name.to_owned());
            }
            match rest.trim_start().strip_prefix("::") {
                Some(next) if !name.is_empty() => rest = next,
                _ => break,
            }
        }
        out.push(path);
        all - rest.len()
    }
    let mut found = Vec::new();
    for (at, word) in ["crate", "relight", "super"].iter().flat_map(|word| code.match_indices(word))
    {
        let before = &code[..at];
        if before.ends_with(is_word)
            || before.ends_with("::")
            || !code[at + word.len()..].trim_start().starts_with("::")
        {
            continue;
        }
        let mut out = Vec::new();
        walk(&code[at..], Vec::new(), &mut out);
        found.extend(out.into_iter().map(|path| (1 + before.matches('\n').count(), path)));
    }
    found
}

/// The module of a file, from its path below `src`: main.rs counts as `cli`, lib.rs as none.
fn module(file: &str) -> Option<&str> {
    let name = file.split('/').next()?.trim_end_matches(".rs");
    (name != "lib").then_some(if name == "main" { "cli" } else { name })
}

/// Arrows of one file that are not allowed.
fn wrong_arrows(file: &str, text: &str) -> Vec<String> {
    let Some(module) = module(file) else { return Vec::new() };
    let Some((_, allowed)) = ARROWS.iter().find(|(name, _)| *name == module) else {
        return vec![format!(
            "src/{file}:1: the module `{module}` is not in ARROWS of tests/architecture.rs"
        )];
    };
    let parts: Vec<&str> = file.trim_end_matches(".rs").split('/').collect();
    let stage = match parts[..] {
        ["nodes", folder, name] if name != "mod" => Some((folder, name)),
        _ => None,
    };
    let is_module = |name: &str| ARROWS.iter().any(|(module, _)| *module == name);
    let judge = |path: &[String]| -> Option<String> {
        let names: Vec<&str> = path.iter().map(String::as_str).collect();
        match names[..] {
            ["super", "super", ..] => {
                Some("a path that climbs two modules is written from `crate`".to_owned())
            }
            ["super", name, ..] if parts[..] == [module, "mod"] && is_module(name) => {
                Some(format!("`{name}` is written from `crate`"))
            }
            ["super", name, ..] => {
                let (folder, own) = stage?;
                let sibling = root().join(format!("src/nodes/{folder}/{name}.rs")).exists();
                (sibling && name != own).then(|| format!("a stage uses the stage `{name}`"))
            }
            ["crate" | "relight", "params" | "ports", ..] => {
                (!["nodes", "graph"].contains(&module)).then(|| format!("`{module}` uses `graph`"))
            }
            ["crate", "optics", "inverse", ..]
                if module == "optics" && !file.starts_with("optics/inverse/") =>
            {
                Some("rendering does not depend on estimation".to_owned())
            }
            ["crate", "nodes", name, ..]
                if module == "nodes" && file != "nodes/mod.rs" && !SHARED.contains(&name) =>
            {
                Some(format!("a stage uses `nodes::{name}`"))
            }
            ["crate" | "relight", used, ..]
                if used != module && is_module(used) && !allowed.contains(&used) =>
            {
                Some(format!("`{module}` uses `{used}`"))
            }
            ["crate" | "relight", used, ..] if !is_module(used) && module != "cli" => {
                Some(format!("`{used}` is not in ARROWS of tests/architecture.rs"))
            }
            _ => None,
        }
    };
    let faults = paths(&code(text)).into_iter().filter_map(|(line, path)| {
        let why = judge(&path)?;
        Some(format!("src/{file}:{line}: {}: {why}", path.join("::")))
    });
    faults.collect()
}

/// Uses of a higher module of `src/optics` in one file, tests apart; `index` is the text of its
/// `mod.rs`, which re-exports names.
fn wrong_layers(file: &str, text: &str, index: &str) -> Vec<String> {
    let layer = |module: &str| LAYERS.iter().position(|name| *name == module);
    let Some(level) = file.strip_prefix("optics/").and_then(|path| layer(path.split('/').next()?))
    else {
        return Vec::new();
    };
    let exports =
        index.split("pub use ").skip(1).filter_map(|part| part.split(';').next()?.split_once("::"));
    let origin: BTreeMap<&str, usize> = exports
        .filter_map(|(module, names)| Some((layer(module)?, names)))
        .flat_map(|(level, names)| names.split(|c| !is_word(c)).map(move |name| (name, level)))
        .collect();
    let code = code(text.split("#[cfg(test)]").next().unwrap_or(text));
    let faults = paths(&code).into_iter().filter_map(|(line, path)| {
        let ["crate", "optics", used, ..] = path.iter().map(String::as_str).collect::<Vec<_>>()[..]
        else {
            return None;
        };
        let higher =
            layer(used).or_else(|| origin.get(used).copied()).is_some_and(|other| other > level);
        higher.then(|| {
            format!(
                "src/{file}:{line}: {}: `{}` uses a higher module",
                path.join("::"),
                LAYERS[level]
            )
        })
    });
    faults.collect()
}

#[test]
fn optics_is_layered() {
    let index = read("src/optics/mod.rs");
    let files = files_below("src/optics");
    let wrong =
        |f: &String| wrong_layers(f.strip_prefix("src/").expect("below src"), &read(f), &index);
    assert_none(files.iter().flat_map(wrong).collect());

    let index = "pub use sampling::{Gaussian, Lobe};\npub use transport::direct;";
    let planted = [
        (
            "optics/sampling/gaussian.rs",
            "use crate::optics::emitter::Lobe;",
            "crate::optics::emitter::Lobe: `sampling`",
        ),
        (
            "optics/emitter/window.rs",
            "fn f() {}\nuse crate::optics::{Lobe, direct};",
            "window.rs:2: crate::optics::direct",
        ),
    ];
    for (file, text, wanted) in planted {
        let faults = wrong_layers(file, text, index);
        assert!(faults.len() == 1 && faults[0].contains(wanted), "{file}: {text}: got {faults:?}");
    }
    let sound = "use crate::optics::Lobe;\n#[cfg(test)]\nmod tests { use crate::optics::direct; }";
    assert_eq!(wrong_layers("optics/emitter/window.rs", sound, index), Vec::<String>::new());
}

/// Words of one file that its place forbids.
fn wrong_words(file: &str, text: &str) -> Vec<String> {
    let code = code(text);
    let mut faults = Vec::new();
    for (word, places) in
        WORDS.iter().filter(|(_, places)| !places.iter().any(|place| file.starts_with(place)))
    {
        let lines = lines_with(&code, word);
        let places = if places.is_empty() { "nowhere".to_owned() } else { places.join(", ") };
        faults.extend(
            lines
                .iter()
                .map(|line| format!("src/{file}:{line}: `{word}` (allowed in src: {places})")),
        );
    }
    if text.contains("training/") {
        faults.push(format!("src/{file}: names training/, which nothing in src may know"));
    }
    faults
}

#[test]
fn arrows_point_down() {
    let files = files_below("src");
    assert_none(
        files
            .iter()
            .flat_map(|f| wrong_arrows(f.strip_prefix("src/").expect("below src"), &read(f)))
            .collect(),
    );
}

#[test]
fn the_library_touches_nothing_outside() {
    let files = files_below("src");
    assert_none(
        files
            .iter()
            .flat_map(|f| wrong_words(f.strip_prefix("src/").expect("below src"), &read(f)))
            .collect(),
    );
}

#[test]
fn planted_arrows_are_seen() {
    let planted = [
        (
            "optics/sphere.rs",
            "fn f() {}\nuse crate::graph::Node;",
            "src/optics/sphere.rs:2: crate::graph::Node",
        ),
        (
            "optics/transport/direct.rs",
            "use crate::optics::inverse::Column;",
            "rendering does not depend on estimation",
        ),
        (
            "graph/key.rs",
            "use crate::{\n  image::Plane};",
            "src/graph/key.rs:1: crate::image::Plane",
        ),
        (
            "graph/key.rs",
            "fn f(p: crate::optics::Shape) {}",
            "src/graph/key.rs:1: crate::optics::Shape",
        ),
        ("image/mod.rs", "use super::graph::Digest;", "src/image/mod.rs:1: super::graph::Digest"),
        ("image/plane.rs", "use super::super::graph;", "src/image/plane.rs:1: super::super::graph"),
        ("image/plane.rs", "use crate::params;", "src/image/plane.rs:1: crate::params"),
        (
            "geometry/mesh.rs",
            "use crate::image::{Mask}; use crate::optics::direct;",
            "crate::optics::direct",
        ),
        ("files/edit.rs", "use crate::nodes;", "src/files/edit.rs:1: crate::nodes"),
        ("cli/run.rs", "relight::optics::direct()", "src/cli/run.rs:1: relight::optics::direct"),
        ("main.rs", "use relight::{graph, optics::Lobe};", "src/main.rs:1: relight::optics::Lobe"),
        (
            "nodes/render/direct.rs",
            "use super::shadow::Shadow;",
            "src/nodes/render/direct.rs:1: super::shadow",
        ),
        (
            "nodes/render/direct.rs",
            "use crate::nodes::{artifacts::A, scene::mesh::Mesh};",
            "nodes::scene::mesh::Mesh",
        ),
        ("sound/mod.rs", "", "`sound` is not in ARROWS"),
        ("nodes/render/direct.rs", "use crate::sound::run;", "`sound` is not in ARROWS"),
    ];
    for (file, text, wanted) in planted {
        let faults = wrong_arrows(file, text);
        assert!(faults.len() == 1 && faults[0].contains(wanted), "{file}: {text}: got {faults:?}");
    }
    let sound = [
        (
            "nodes/render/direct.rs",
            "use crate::{params, ports}; use crate::optics::{self, Shape}; use super::same_size;",
        ),
        (
            "nodes/render/direct.rs",
            "// crate::cli\n/* crate::cli /* */ crate::cli */ let s = \"crate::cli\"; mod t { use super::*; }",
        ),
        (
            "optics/light.rs",
            "let c = '\"'; let l: &'static str = r#\"\" crate::graph\"#; let d = '\\''; // crate::graph",
        ),
    ];
    for (file, text) in sound {
        assert_eq!(wrong_arrows(file, text), Vec::<String>::new(), "{file}: {text}");
    }
}

#[test]
fn planted_words_are_seen() {
    let planted = [
        ("optics/light.rs", "\nprintln!(\"x\");", "src/optics/light.rs:2: `println!`"),
        ("nodes/output/write.rs", "use exr::prelude;", "src/nodes/output/write.rs:1: `exr::`"),
        ("nodes/output/write.rs", "std::io::stdout()", "`stdout`"),
        ("graph/run.rs", "std::env::var(\"X\")", "`std::env`"),
        ("nodes/output/write.rs", "std::fs::write(path, bytes)", "`std::fs`"),
        ("net/rten.rs", "use std::process::Command;", "`std::process`"),
        ("image/read.rs", "let t = Instant::now();", "`Instant`"),
        ("graph/run.rs", "SystemTime::now()", "`SystemTime`"),
        ("optics/random.rs", "thread_local! {}", "`thread_local!`"),
        ("optics/random.rs", "rand::thread_rng()", "`thread_rng`"),
        ("nodes/mod.rs", "const PATH: &str = \"training/x\";", "training/"),
    ];
    for (file, text, wanted) in planted {
        let faults = wrong_words(file, text);
        assert!(faults.len() == 1 && faults[0].contains(wanted), "{file}: {text}: got {faults:?}");
    }
    let sound = [
        ("image/io/exr_read.rs", "use ::exr::meta::MetaData;"),
        ("nodes/output/write.rs", "use super::write_exr::x; // println! goes nowhere"),
        ("graph/run.rs", "let began = Instant::now();"),
    ];
    for (file, text) in sound {
        assert_eq!(wrong_words(file, text), Vec::<String>::new(), "{file}: {text}");
    }
}

/// Files that are too large: (path, bytes) -> faults. 5 MB a file outside models/; scenes/ 6 MB and
/// models/ 20 MB together.
fn too_large(files: &[(String, u64)]) -> Vec<String> {
    const MB: u64 = 1_000_000;
    let large = |(path, bytes): &&(String, u64)| *bytes > 5 * MB && !path.starts_with("models/");
    let mut faults: Vec<String> = files
        .iter()
        .filter(large)
        .map(|(path, bytes)| format!("{path}: {bytes} bytes, wanted at most 5 MB"))
        .collect();
    for (folder, limit) in [("scenes/", 6), ("models/", 20)] {
        let sum: u64 =
            files.iter().filter(|(path, _)| path.starts_with(folder)).map(|(_, bytes)| bytes).sum();
        if sum > limit * MB {
            faults.push(format!("{folder}: {sum} bytes together, wanted at most {limit} MB"));
        }
    }
    faults
}

#[needs(".git")]
#[test]
fn the_repository_is_small() {
    let bytes = |path: String| {
        let bytes = std::fs::symlink_metadata(root().join(&path))
            .expect("git lists files that are there")
            .len();
        (path, bytes)
    };
    assert_none(too_large(&tracked().into_iter().map(bytes).collect::<Vec<_>>()));

    let planted = [
        ("docs/a.png", 5_000_001),
        ("scenes/a", 4_000_000),
        ("scenes/b", 2_000_001),
        ("models/a.onnx", 9_000_000),
    ];
    let planted: Vec<(String, u64)> =
        planted.iter().map(|&(path, bytes)| (path.to_owned(), bytes)).collect();
    assert_eq!(too_large(&planted).len(), 2, "the picture, and the scenes together");
}

/// Heading -> anchor, as GitHub makes it.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars()
        .filter(|c| is_word(*c) || [' ', '-'].contains(c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

fn anchors(page: &str) -> BTreeSet<String> {
    page.lines().filter(|l| l.starts_with('#')).map(|l| anchor(l.trim_start_matches('#'))).collect()
}

/// Links of a page that lead nowhere, and paths of `src` and `docs` that it names but that are
/// gone.
fn dead_links(page: &str, text: &str, pages: &BTreeMap<String, String>) -> Vec<String> {
    let folder = page.rsplit_once('/').map_or("", |(folder, _)| folder);
    let mut faults = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let at = format!("{page}:{}", index + 1);
        for target in line.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if target.starts_with("http") {
                continue;
            }
            let (path, fragment) = target.split_once('#').unwrap_or((target, ""));
            let mut parts: Vec<&str> =
                if folder.is_empty() { Vec::new() } else { folder.split('/').collect() };
            for part in path.split('/') {
                match part {
                    "" | "." => {}
                    ".." => drop(parts.pop()),
                    name => parts.push(name),
                }
            }
            let path = if path.is_empty() { page.to_owned() } else { parts.join("/") };
            if !root().join(&path).exists() && !pages.contains_key(&path) {
                faults.push(format!("{at}: {target} is not there"));
            } else if !fragment.is_empty()
                && !pages.get(&path).is_some_and(|page| anchors(page).contains(fragment))
            {
                faults.push(format!("{at}: {path} has no heading #{fragment}"));
            }
        }
        for path in line.split('`').skip(1).step_by(2).filter(|word| {
            ["src/", "docs/", "tests/", "benches/", "training/", "scenes/", "graphs/", "edits/"]
                .iter()
                .any(|f| word.starts_with(f))
                && word.chars().all(|c| is_word(c) || "/.-".contains(c))
        }) {
            if !root().join(path).exists() {
                faults.push(format!("{at}: `{path}` is not there"));
            }
        }
    }
    faults
}

#[needs(".git")]
#[test]
fn links_lead_somewhere() {
    let pages: BTreeMap<String, String> = tracked()
        .into_iter()
        .filter(|f| f.ends_with(".md"))
        .map(|f| (f.clone(), read(&f)))
        .collect();
    assert!(pages.len() > 10, "{} pages", pages.len());
    assert_none(pages.iter().flat_map(|(page, text)| dead_links(page, text, &pages)).collect());

    let text = "[a](../README.md) [b](gone.md)\n[c](#a-heading) [d](#none) [e](https://x)\n# A `heading`\n`src/gone/` `src/graph`";
    let planted = BTreeMap::from([("docs/page.md".to_owned(), text.to_owned())]);
    let wanted = [
        "docs/page.md:1: gone.md is not there",
        "docs/page.md:2: docs/page.md has no heading #none",
        "docs/page.md:4: `src/gone/` is not there",
    ];
    assert_eq!(dead_links("docs/page.md", text, &planted), wanted);
}

/// Folders that a page does not name.
fn unnamed_folders(page: &str, folders: &BTreeSet<String>) -> Vec<String> {
    let named = |folder: &&String| page.contains(&format!("`{folder}`"));
    folders
        .iter()
        .filter(|folder| !named(folder))
        .map(|f| format!("ARCHITECTURE.md does not name `{f}`"))
        .collect()
}

#[test]
fn the_map_names_every_room() {
    let folder = |file: String| file.rsplit_once('/').expect("below src").0.to_owned();
    let mut folders: BTreeSet<String> = files_below("src").into_iter().map(folder).collect();
    folders.remove("src");
    assert_none(unnamed_folders(&read("ARCHITECTURE.md"), &folders));

    let planted = BTreeSet::from(["src/graph".to_owned(), "src/attic".to_owned()]);
    assert_eq!(
        unnamed_folders("`src/graph`", &planted),
        ["ARCHITECTURE.md does not name `src/attic`"]
    );
}

/// A folder of results that is added by mistake is seen.
#[needs(".git")]
#[test]
fn the_map_names_every_folder_at_the_top() {
    let files = tracked();
    let tops = files.iter().filter_map(|file| Some(file.split_once('/')?.0.to_owned()));
    let mut tops: BTreeSet<String> = tops.filter(|top| !top.starts_with('.')).collect();
    assert!(tops.len() > 10, "{tops:?}");
    // The map names their parts.
    tops.retain(|top| top != "src" && top != "crates");
    // It names some folders with a slash at the end.
    let page = read("ARCHITECTURE.md").replace("/`", "`");
    assert_none(unnamed_folders(&page, &tops));
}

/// Scenes without a section with a license in scenes/README.md.
fn unlicensed(scenes: &BTreeSet<&str>, page: &str) -> Vec<String> {
    let licensed = |name: &&&str| {
        let section =
            page.split("\n## ").find(|s| s.lines().next().is_some_and(|title| title == **name));
        section.is_some_and(|section| section.contains("\nLicense: "))
    };
    scenes
        .iter()
        .filter(|name| !licensed(name))
        .map(|name| format!("scenes/README.md names no license of {name}"))
        .collect()
}

#[test]
fn every_scene_has_its_license() {
    let files = files_below("scenes");
    let scenes = files
        .iter()
        .filter_map(|f| f.strip_prefix("scenes/")?.split_once('/'))
        .map(|(name, _)| name);
    assert_none(unlicensed(&scenes.collect(), &read("scenes/README.md")));

    let page = "# Scenes\n\n## a\n\nLicense: CC0.\n\n## b\n\nA room.\n";
    assert_eq!(
        unlicensed(&BTreeSet::from(["a", "b"]), page),
        ["scenes/README.md names no license of b"]
    );
}

/// Code without its unit tests, which stand at the end of a file.
fn without_tests(code: &str) -> &str {
    code.split("\nmod tests {").next().expect("a split has a first part")
}

/// The file of a module, from its path below `src`: `a/b.rs` or `a/b/mod.rs`.
fn module_file(module: &[&str], files: &BTreeMap<String, String>) -> Option<String> {
    let path = module.join("/");
    let all = [format!("{path}.rs"), format!("{path}/mod.rs")];
    all.into_iter().find(|file| files.contains_key(file))
}

/// The file that defines what a path names; follows the `pub use` of module files.
fn defined_in(path: &[&str], files: &BTreeMap<String, String>) -> Option<String> {
    let depth = (1..=path.len()).rev().find(|&n| module_file(&path[..n], files).is_some())?;
    let (module, file) = (&path[..depth], module_file(&path[..depth], files)?);
    let Some(item) = path.get(depth) else { return Some(file) };
    for part in files[&file].split("pub use ").skip(1) {
        let (from, names) = part.split(';').next()?.rsplit_once("::")?;
        if names.split(|c| !is_word(c)).any(|name| name == *item) {
            let from: Vec<&str> = from.split("::").filter(|name| *name != "self").collect();
            return defined_in(&[module, &from, &[*item]].concat(), files);
        }
    }
    Some(file)
}

/// Files of `src` that use each other in a circle. A module file and its children count as one.
fn circles(files: &BTreeMap<String, String>) -> Vec<Vec<String>> {
    let files: BTreeMap<String, String> = files
        .iter()
        .map(|(file, text)| (file.clone(), without_tests(&code(text)).to_owned()))
        .collect();
    let is_parent = |file: &str| {
        let folder = format!("{}/", file.trim_end_matches(".rs"));
        file.ends_with("mod.rs") || files.keys().any(|other| other.starts_with(&folder))
    };
    let mut uses = petgraph::graphmap::DiGraphMap::<&str, ()>::new();
    for (file, text) in files.iter().filter(|(file, _)| !is_parent(file)) {
        let own: Vec<&str> = file.trim_end_matches(".rs").split('/').collect();
        for (_, path) in paths(text) {
            let names: Vec<&str> = path.iter().map(String::as_str).collect();
            let full = match names[0] {
                "super" => [&own[..own.len() - 1], &names[1..]].concat(),
                _ => names[1..].to_vec(),
            };
            let target =
                defined_in(&full, &files).filter(|target| target != file && !is_parent(target));
            if let Some(target) = target {
                let (target, _) = files.get_key_value(&target).expect("it is one of them");
                uses.add_edge(file, target, ());
            }
        }
    }
    let together = petgraph::algo::tarjan_scc(&uses).into_iter().filter(|files| files.len() > 1);
    let mut circles: Vec<Vec<String>> = together
        .map(|mut files| {
            files.sort_unstable();
            files.into_iter().map(str::to_owned).collect()
        })
        .collect();
    circles.sort();
    circles
}

fn sources() -> BTreeMap<String, String> {
    files_below("src")
        .into_iter()
        .filter(|file| file.ends_with(".rs"))
        .map(|file| (file.strip_prefix("src/").expect("below src").to_owned(), read(&file)))
        .collect()
}

#[test]
fn no_files_use_each_other_in_a_circle() {
    let found = circles(&sources());
    assert_none(
        found.iter().map(|files| format!("these use each other: {}", files.join(", "))).collect(),
    );

    let text = [
        ("a/mod.rs", "mod one; mod two; mod three; pub use two::{Two};"),
        ("a/one.rs", "use crate::a::Two; pub struct One;"),
        ("a/two.rs", "use super::one::One; pub struct Two;"),
        ("a/three.rs", "use super::one::One; mod tests_of_nothing;"),
    ];
    let planted = text.map(|(file, text)| (file.to_owned(), text.to_owned())).into();
    assert_eq!(circles(&planted), [["a/one.rs", "a/two.rs"]]);
}

/// Most files that lie beside each other in one folder of `src`.
const MOST_FILES: usize = 25;

#[test]
fn no_folder_is_flat() {
    let mut folders = BTreeMap::<String, usize>::new();
    for file in sources().into_keys() {
        *folders
            .entry(file.rsplit_once('/').map_or("", |(folder, _)| folder).to_owned())
            .or_default() += 1;
    }
    let flat = folders.iter().filter(|(_, files)| **files > MOST_FILES);
    assert_none(
        flat.map(|(folder, n)| format!("src/{folder}: {n} files, wanted at most {MOST_FILES}"))
            .collect(),
    );
}

/// Columns of a comment.
const COMMENT_COLUMNS: usize = 100;
/// Words that a documentation comment does not open with: a first sentence has a noun as its
/// subject.
const OPENINGS: [&str; 3] = ["What", "Of", "Where"];

/// Comments of one file that break a rule of CONTRIBUTING.md.
fn prose_faults(file: &str, text: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let code = code(text);
    let (mut in_block, mut in_code) = (false, false);
    for (number, (line, code)) in text.lines().zip(code.lines()).enumerate() {
        let at = format!("{file}:{}", number + 1);
        let trimmed = line.trim_start();
        let comment = trimmed.strip_prefix("//").filter(|_| code.trim().is_empty());
        let documents = comment.is_some_and(|comment| comment.starts_with(['/', '!']));
        if let Some(comment) = comment {
            // Tables and code are not wrapped.
            let is_text = !comment.trim_start_matches(['/', '!', ' ']).starts_with('|')
                && !comment.trim_start_matches(['/', '!']).starts_with("   ")
                && !in_code;
            if is_text && line.chars().count() > COMMENT_COLUMNS {
                faults.push(format!("{at}: a comment of more than {COMMENT_COLUMNS} columns"));
            }
            in_code ^= comment.contains("```");
            if comment.replace("there is no ", "").contains(" is no ") {
                faults.push(format!("{at}: \"is no\", wanted \"is not a\""));
            }
            let first =
                comment.trim_start_matches(['/', '!', ' ']).split(' ').next().unwrap_or_default();
            if documents && !in_block && OPENINGS.contains(&first) {
                faults
                    .push(format!("{at}: a first sentence opens with \"{first}\", wanted a noun"));
            }
        }
        in_block = documents;
    }
    faults
}

#[test]
fn comments_keep_the_rules() {
    let files =
        ["src", "tests", "benches", "examples"].iter().flat_map(|folder| files_below(folder));
    let files = files.filter(|file| file.ends_with(".rs"));
    assert_none(files.flat_map(|file| prose_faults(&file, &read(&file))).collect());

    let long = format!("// {}", "a ".repeat(50));
    let planted = ["/// What it does.", "    //! Of a plane.", "// A hole is no pixel.", &long];
    for text in planted {
        assert_eq!(prose_faults("a.rs", text).len(), 1, "{text}");
    }
    let sound = "/// A plane.\n/// Of no consequence is the second line.\nlet s = \"// this is no comment\";";
    assert_eq!(prose_faults("a.rs", sound), Vec::<String>::new());
}

/// Names of the tables that a file declares with `tuning!`.
fn tables(text: &str) -> Vec<&str> {
    let declared =
        text.split("\ntuning! {").skip(1).filter_map(|table| table.split("pub const ").nth(1));
    declared.filter_map(|rest| rest.split([':', '{']).nth(1)).map(str::trim).collect()
}

#[test]
fn every_table_of_constants_is_on_its_page() {
    let page = read("docs/tuning.md");
    let missing = |file: &str, text: &str, page: &str| -> Vec<String> {
        let names =
            tables(text).into_iter().filter(|name| !page.contains(&format!("\n### {name}\n")));
        names
            .map(|name| {
                format!("src/{file}: docs/tuning.md has no {name}: list it in a function `tuning`")
            })
            .collect()
    };
    let files: Vec<(String, String)> =
        sources().into_iter().filter(|(file, _)| file != "tuning.rs").collect();
    assert!(
        files.iter().map(|(_, text)| tables(text).len()).sum::<usize>() > 50,
        "the form of tables is known"
    );
    assert_none(files.iter().flat_map(|(file, text)| missing(file, text, &page)).collect());

    let planted =
        "use x;\n\ntuning! {\n    /// A constant.\n    pub const TUNING: AtticTuning {\n    }\n}\n";
    assert_eq!(tables(planted), ["AtticTuning"]);
    assert_eq!(missing("a.rs", planted, "\n### AtticTuning\n"), Vec::<String>::new());
    assert_eq!(missing("a.rs", planted, "\n### CellarTuning\n").len(), 1);
}

/// Folders of `src` whose numbers stand in tables.
const TUNED: [&str; 6] =
    ["optics/", "nodes/", "geometry/scene/", "geometry/grid", "image/ops/", "image/material/"];

/// Numbers in constants of their own where a table belongs.
fn loose_constants(file: &str, text: &str) -> Vec<String> {
    let text = code(text);
    let lines = without_tests(&text).lines().enumerate();
    let loose = lines.filter(|(_, line)| {
        let value = line
            .split_once("const ")
            .filter(|(before, _)| before.is_empty() || before.starts_with("pub"));
        let value = value.and_then(|(_, rest)| {
            rest.split_once(": f32 = ").or_else(|| rest.split_once(": f64 = "))
        });
        value.is_some_and(|(_, value)| value.starts_with(|c: char| c.is_ascii_digit() || c == '-'))
    });
    let fault = |(number, line): (usize, &str)| {
        format!("src/{file}:{}: `{line}` outside of `tuning!`", number + 1)
    };
    loose.map(fault).collect()
}

#[test]
fn constants_stand_in_tables() {
    let files = sources()
        .into_iter()
        .filter(|(file, _)| TUNED.iter().any(|folder| file.starts_with(folder)));
    assert_none(files.flat_map(|(file, text)| loose_constants(&file, &text)).collect());

    for planted in [
        "const LEAST: f32 = 0.1;",
        "pub const MOST: f64 = -1e3;",
        "pub(super) const A: f64 = 2.0 - 1e-6;",
    ] {
        assert_eq!(loose_constants("optics/a.rs", planted).len(), 1, "{planted}");
    }
    for sound in [
        "const LEAST: f32 = TUNING.least;",
        "const A: usize = 3;",
        "mod tests {\nconst A: f32 = 1.0;\n}",
    ] {
        assert_eq!(
            loose_constants("optics/a.rs", &format!("\n{sound}")),
            Vec::<String>::new(),
            "{sound}"
        );
    }
}
