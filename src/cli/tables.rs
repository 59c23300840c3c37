//! Tables in Markdown.

/// Rows under a head; nothing where there are no rows.
pub fn table(head: &[String], rows: Vec<Vec<String>>) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let rule = "| --- ".repeat(head.len()) + "|\n";
    if rows.is_empty() { String::new() } else { line(head) + &rule + &rows.iter().map(|r| line(r)).collect::<String>() }
}

/// Each value once, where it first stands.
pub fn distinct<T: PartialEq + Clone>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut all = Vec::new();
    for value in values {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}
