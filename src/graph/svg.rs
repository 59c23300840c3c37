//! A graph as a drawing: nodes and wires, row by row, colored by final state.

use std::fmt::Write;

use super::escape::escape_markup;
use super::report::Status;

/// One instance of a node, as the drawing shows it.
pub struct Drawn {
    /// `direct[lamp_0]`; members of one node share a box.
    pub name: String,
    /// Kind of the node's stage.
    pub kind: String,
    /// Final state, if the graph was run.
    pub status: Option<Status>,
    /// Wall time of the stage.
    pub seconds: f64,
    /// Names of the instances that it takes from.
    pub from: Vec<String>,
}

const WIDTH: usize = 168;
const HEIGHT: usize = 38;
const PITCH: (usize, usize) = (WIDTH + 20, HEIGHT + 24);
/// Side of the square of a member.
const CHIP: usize = 8;

/// Members of one node.
struct Group<'a> {
    name: &'a str,
    kind: &'a str,
    members: Vec<&'a Drawn>,
    /// Groups it takes from, ascending; none of them that another one takes from in turn, as those
    /// wires only hide the others.
    from: Vec<usize>,
    /// Wires to run from above: the longest way from where nothing is taken.
    row: usize,
    /// Left edge.
    x: usize,
}

/// The drawing; classes `hit`, `ran`, `failed`, `blocked`, `cancelled` and `plain` may be styled by
/// the page that contains it.
pub fn draw(nodes: &[Drawn]) -> String {
    let groups = placed(nodes);
    let columns = groups.iter().map(|group| group.x + WIDTH).max().unwrap_or(WIDTH);
    let rows = groups.iter().map(|group| group.row + 1).max().unwrap_or(1);
    let (width, height) = (columns + 2, rows * PITCH.1 - (PITCH.1 - HEIGHT) + 2);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"graph\" viewBox=\"-1 -1 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"system-ui, sans-serif\" font-size=\"12\">\n<style>{STYLE}</style>\n"
    );
    let mut line = |line: String| writeln!(text, "{line}").expect("writing to a string");
    for group in &groups {
        let (x, y) = (group.x + WIDTH / 2, group.row * PITCH.1);
        for from in group.from.iter().map(|&from| &groups[from]) {
            let (fx, fy) = (from.x + WIDTH / 2, from.row * PITCH.1 + HEIGHT);
            let bend = (y - fy) / 2;
            line(format!(
                "<path class=\"wire\" d=\"M{fx} {fy}C{fx} {},{x} {},{x} {y}\"/>",
                fy + bend,
                y - bend
            ));
        }
    }
    let most = groups.iter().map(Group::seconds).fold(0.0, f64::max);
    for group in &groups {
        let (x, y) = (group.x, group.row * PITCH.1);
        line(format!(
            "<g transform=\"translate({x} {y})\"><title>{}</title>",
            escape_markup(&group.tooltip())
        ));
        line(format!(
            "<rect class=\"box {}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" rx=\"5\"/>",
            class(group.status())
        ));
        line(format!("<text class=\"name\" x=\"8\" y=\"16\">{}</text>", escape_markup(group.name)));
        let seconds = group.seconds();
        if seconds > 0.0 {
            line(format!(
                "<text class=\"time\" x=\"{}\" y=\"31\" text-anchor=\"end\">{}</text>",
                WIDTH - 8,
                time(seconds)
            ));
            let bar = ((WIDTH - 8) as f64 * seconds / most).max(1.0);
            line(format!(
                "<rect class=\"bar\" x=\"4\" y=\"{}\" width=\"{bar:.1}\" height=\"2\" rx=\"1\"/>",
                HEIGHT - 4
            ));
        }
        if group.members.len() > 1 {
            // As many as fit before the time.
            for (k, member) in group.members.iter().take(10).enumerate() {
                let (at, class) = (8 + k * (CHIP + 2), class(member.status));
                line(format!(
                    "<rect class=\"chip {class}\" x=\"{at}\" y=\"22\" width=\"{CHIP}\" height=\"{CHIP}\" rx=\"2\"><title>{}</title></rect>",
                    escape_markup(&tooltip(member))
                ));
            }
        } else {
            line(format!(
                "<text class=\"kind\" x=\"8\" y=\"31\">{}</text>",
                escape_markup(group.kind)
            ));
        }
        line("</g>".into());
    }
    text.push_str("</svg>\n");
    text
}

const STYLE: &str = ".wire{fill:none;stroke:#8a8f98;stroke-width:1.2;opacity:.6}.box,.chip{stroke:#8a8f98;stroke-width:1}.name{font-weight:600;fill:#15171a}\
.kind,.time{font-size:10.5px;fill:#4a4f57}.bar{fill:#15171a;opacity:.55}.plain{fill:#fff}.hit{fill:#e9ebee}.ran{fill:#bfe3c0}.failed{fill:#f2a39b}.blocked{fill:#f6cf9c}\
.cancelled{fill:#f5efb8}";

impl Group<'_> {
    fn seconds(&self) -> f64 {
        self.members.iter().map(|member| member.seconds).sum()
    }

    /// The gravest of its members'.
    fn status(&self) -> Option<Status> {
        let order = [Status::Failed, Status::Blocked, Status::Cancelled, Status::Ran, Status::Hit];
        order
            .into_iter()
            .find(|&status| self.members.iter().any(|member| member.status == Some(status)))
    }

    fn tooltip(&self) -> String {
        let members: Vec<String> = self.members.iter().map(|member| tooltip(member)).collect();
        format!("{} ({})\n{}", self.name, self.kind, members.join("\n"))
    }
}

fn tooltip(node: &Drawn) -> String {
    match node.status {
        None => node.name.clone(),
        Some(status) if node.seconds > 0.0 => {
            format!("{}: {status}, {}", node.name, time(node.seconds))
        }
        Some(status) => format!("{}: {status}", node.name),
    }
}

fn time(seconds: f64) -> String {
    if seconds < 0.9995 { format!("{:.0} ms", 1e3 * seconds) } else { format!("{seconds:.2} s") }
}

fn class(status: Option<Status>) -> String {
    status.map_or("plain".into(), |status| status.to_string())
}

/// The groups, each with its row, and side by side in it.
fn placed(nodes: &[Drawn]) -> Vec<Group<'_>> {
    let base = |name: &str| name.find('[').map_or(name.len(), |at| at);
    let mut groups: Vec<Group> = Vec::new();
    for node in nodes {
        let name = &node.name[..base(&node.name)];
        match groups.iter_mut().find(|group| group.name == name) {
            Some(group) => group.members.push(node),
            None => groups.push(Group {
                name,
                kind: &node.kind,
                members: vec![node],
                from: Vec::new(),
                row: 0,
                x: 0,
            }),
        }
    }
    let of = |groups: &[Group], at: usize| -> Vec<usize> {
        let names = groups[at].members.iter().flat_map(|member| &member.from);
        let found = names
            .filter_map(|name| groups.iter().position(|group| group.name == &name[..base(name)]));
        let mut from: Vec<usize> = found.filter(|&from| from != at).collect();
        from.sort_unstable();
        from.dedup();
        from
    };
    let wires: Vec<Vec<usize>> = (0..groups.len()).map(|at| of(&groups, at)).collect();
    // As many rounds as the longest way has wires; bounded, as a list of names from a file may hold
    // a loop.
    for _ in 0..groups.len() {
        let rows: Vec<usize> = wires
            .iter()
            .map(|from| from.iter().map(|&f| groups[f].row + 1).max().unwrap_or(0))
            .collect();
        if groups.iter().zip(&rows).all(|(group, &row)| group.row == row) {
            break;
        }
        groups.iter_mut().zip(rows).for_each(|(group, row)| group.row = row.min(wires.len()));
    }
    for (at, from) in wires.iter().enumerate() {
        let implied =
            |&one: &usize| from.iter().any(|&other| other != one && leads(&wires, one, other));
        groups[at].from = from
            .iter()
            .copied()
            .filter(|one| !implied(one) && groups[*one].row < groups[at].row)
            .collect();
    }
    let widest = (0..=groups.len())
        .map(|row| groups.iter().filter(|group| group.row == row).count())
        .max()
        .unwrap_or(1);
    for row in 0..=groups.len() {
        let mut here: Vec<usize> = (0..groups.len()).filter(|&at| groups[at].row == row).collect();
        // Below the middle of its sources, so that wires run straight.
        let middle = |at: usize| {
            let above = &groups[at].from;
            above.iter().map(|&from| groups[from].x as f64).sum::<f64>() / above.len().max(1) as f64
        };
        here.sort_by(|&a, &b| middle(a).total_cmp(&middle(b)).then(a.cmp(&b)));
        let left = (widest - here.len()) * PITCH.0 / 2;
        for (place, &at) in here.iter().enumerate() {
            groups[at].x = left + place * PITCH.0;
        }
    }
    groups
}

/// Whether `to` takes from `from`, over others or not.
fn leads(wires: &[Vec<usize>], from: usize, to: usize) -> bool {
    let (mut seen, mut stack) = (vec![false; wires.len()], vec![to]);
    while let Some(at) = stack.pop() {
        for &next in &wires[at] {
            if next == from {
                return true;
            }
            if !std::mem::replace(&mut seen[next], true) {
                stack.push(next);
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(name: &str, from: &[&str]) -> Drawn {
        let from = from.iter().map(|name| name.to_string()).collect();
        Drawn {
            name: name.into(),
            kind: "Kind".into(),
            status: Some(Status::Ran),
            seconds: 0.5,
            from,
        }
    }

    #[test]
    fn members_share_a_box_and_wires_run_down() {
        let nodes = [
            node("scene", &[]),
            node("direct[a]", &["scene"]),
            node("direct[b]", &["scene"]),
            node("mix", &["direct[a]", "direct[b]", "scene"]),
            node("other", &["scene"]),
        ];
        let groups = placed(&nodes);
        assert_eq!(
            groups.iter().map(|group| (group.name, group.row)).collect::<Vec<_>>(),
            [("scene", 0), ("direct", 1), ("mix", 2), ("other", 1)]
        );
        assert_eq!(groups[2].from, [1], "that mix takes from scene is decided by direct");
        assert!(groups[1].x.abs_diff(groups[3].x) >= WIDTH, "boxes of a row stand side by side");
        let text = draw(&nodes);
        assert_eq!(text.matches("class=\"box ran\"").count(), 4);
        assert_eq!(text.matches("class=\"wire\"").count(), 3);
        assert_eq!(text.matches("class=\"chip ran\"").count(), 2);
    }

    #[test]
    fn loops_and_strange_names_do_no_harm() {
        let text = draw(&[node("<a>&\"", &["b"]), node("b", &["<a>&\"", "b", "gone"])]);
        assert!(text.contains("&lt;a&gt;&amp;&quot;") && !text.contains("<a>"), "{text}");
        assert!(draw(&[]).contains("<svg"));
    }
}
