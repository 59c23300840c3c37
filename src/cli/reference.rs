//! The reference of the stages, from their declarations: plain text and Markdown in one.

use relight::graph::{Arity, KindSpec, PortSpec, Registry};
use relight::tuning::Table;

/// One line per stage.
pub fn list(registry: &Registry) -> String {
    let width = registry.kinds().map(|spec| spec.kind.len()).max().unwrap_or(0);
    registry
        .kinds()
        .map(|spec| format!("{:width$}  {}\n", spec.kind, first_sentence(spec.doc)))
        .collect()
}

/// docs/nodes.md.
pub fn page(registry: &Registry) -> String {
    let mut text = String::from(
        "# The stages\n\nMade by `relight nodes --markdown` from the code; do not edit.\n",
    );
    text.push_str("A range `a..=b` includes `b`, `a..b` does not; NaN and infinity lie in none.\n");
    for spec in registry.kinds() {
        text.push('\n');
        text.push_str(&section(spec));
    }
    text
}

/// docs/tuning.md: the tables of each folder of the code below a heading of its own.
pub fn tuning(tables: &[Table]) -> String {
    let mut text = String::from(
        "# The constants\n\nMade by `relight nodes --tuning` from the code; do not edit.\n",
    );
    text.push_str("These numbers decide an algorithm and are not parameters of a stage. A source is a paper, a ");
    text.push_str(
        "measurement,\na derivation, or taste: a choice by eye, which nothing has measured.\n",
    );
    let mut last = String::new();
    for table in tables {
        let file = table.file.replace('\\', "/");
        let folder = file.rsplit_once('/').map_or("", |(folder, _)| folder);
        if folder != last {
            text.push_str(&format!("\n## `{folder}`\n"));
            last = folder.to_owned();
        }
        text.push_str(&format!(
            "\n### {}\n\n{}\nDeclared in `{file}`.\n\n",
            table.name,
            lines(table.doc).join("\n")
        ));
        for constant in &table.constants {
            let head =
                format!("`{}` = `{}`, unit: {}", constant.name, constant.value, constant.unit);
            text.push_str(&item(&head, constant.doc));
            text.push_str(&format!(
                "  Source: {}. Effect: {}.\n",
                constant.source, constant.effect
            ));
        }
    }
    text
}

/// All of one stage.
pub fn section(spec: &KindSpec) -> String {
    let mut text = format!("## {}\n\n{}\n", spec.kind, lines(spec.doc).join("\n"));
    let params = spec.params.iter().map(|param| {
        let range = param.range.as_ref().map_or(String::new(), |range| format!(", range {range}"));
        let head = format!("`{}`: {}{range}, default `{}`", param.name, param.form, param.default);
        item(&head, param.doc)
    });
    let inputs = spec
        .inputs
        .iter()
        .map(|port| item(&port_head(port, "every member's", "may be missing"), port.doc));
    let outputs = spec
        .outputs
        .iter()
        .map(|port| item(&port_head(port, "one per member", "may be missing"), port.doc));
    part(&mut text, "Parameters", params.collect());
    part(&mut text, "Inputs", inputs.collect());
    part(&mut text, "Outputs", outputs.collect());
    text.push_str(&format!("\nVersion {}.\n", spec.version));
    text
}

fn part(text: &mut String, title: &str, items: Vec<String>) {
    if !items.is_empty() {
        text.push_str(&format!("\n{title}:\n\n{}", items.concat()));
    }
}

fn port_head(port: &PortSpec, many: &str, optional: &str) -> String {
    match port.arity {
        Arity::One => format!("`{}`: {}", port.name, port.type_name),
        Arity::Optional => format!("`{}`: {}, {optional}", port.name, port.type_name),
        Arity::Many => format!("`{}`: {}, {many}", port.name, port.type_name),
    }
}

fn item(head: &str, doc: &str) -> String {
    format!("- {head}\n{}", lines(doc).iter().map(|line| format!("  {line}\n")).collect::<String>())
}

/// A documentation comment without the blank that follows each `///`.
fn lines(doc: &str) -> Vec<&str> {
    doc.trim_end().lines().map(|line| line.strip_prefix(' ').unwrap_or(line).trim_end()).collect()
}

fn first_sentence(doc: &str) -> String {
    let paragraph: Vec<&str> = lines(doc).into_iter().take_while(|line| !line.is_empty()).collect();
    let paragraph = paragraph.join(" ");
    paragraph.split_once(". ").map_or(paragraph.clone(), |(first, _)| format!("{first}."))
}
