//! The graphs of `tests/old`, in old names, mean the graphs that ship.

use std::fmt::Write as _;

use relight::geometry::KnownLength;

use crate::project::*;

#[test]
fn old_graphs_compute_nothing_that_the_new_ones_have_not_computed() {
    for name in ["physics.ron", "indoor.ron", "networks.ron"] {
        let edit = edits().join("polish.ron");
        let [new, old] = ["graphs", "tests/old"].map(|folder| {
            load(&root().join(folder).join(name), &demo(), &edit)
                .unwrap_or_else(|faults| panic!("{}", faults[0]))
        });
        assert!(new.warnings().is_empty(), "{name}: {}", new.warnings()[0]);
        run(shared_engine(), &new, &[]);
        assert_eq!(ran(&run(shared_engine(), &old, &[])), [""; 0], "{name}");
        let warnings = old.warnings().iter().fold(String::new(), |mut text, warning| {
            let _ = writeln!(text, "{warning}");
            text
        });
        for word in [
            "Paint",
            "OccludeRest",
            "edited_rest",
            "zone",
            "fit.rest",
            "compose.rest",
            "repaint.polished",
        ] {
            assert!(
                warnings.contains(&format!("`{word}` is an old name")),
                "{name}: {word}\n{warnings}"
            );
        }
    }
}

#[test]
fn old_parameters_and_values_mean_the_new_ones() {
    let with = |nodes: &str| {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("graph.ron");
        let parent = root().join("graphs/refined.ron");
        let text = format!("Graph(version: 1, extends: {parent:?}, nodes: {{ {nodes} }})");
        std::fs::write(&path, text).expect("it can be written");
        load(&path, &demo(), &edits().join("none.ron"))
            .unwrap_or_else(|faults| panic!("{}", faults[0]))
    };
    let old = with(
        r#""init": (op: InitLights(worth: 0.1, turns: 7, ambient_cost: 0.02, plates: 100, lamps: Plates,
            outlook: Likeliest(10, 1, 1))),
        "refine": (op: RefineLights(worth: 0.1, places: 500, rest_cost: 0.1, invisible_cost: 0.2, sun_cost: 0.3)),
        "fit": (op: FitLights(turns: 100, prior: 0.1, rest_cost: 0.1, invisible_cost: 0.2, sun_cost: 0.3)),"#,
    );
    let new = with(
        r#""init": (op: InitLights(min_gain: 0.1, iterations: 7, ambient_weight: 0.02, surfels: 100, lamps: Surfels,
            window_emission: Best(10, 1, 1))),
        "refine": (op: RefineLights(min_gain: 0.1, receivers: 500, ambient_weight: 0.1, out_of_view_weight: 0.2,
            sun_weight: 0.3)),
        "fit": (op: FitLights(iterations: 100, tikhonov_weight: 0.1, ambient_weight: 0.1, out_of_view_weight: 0.2,
            sun_weight: 0.3)),"#,
    );
    assert_eq!((old.warnings().len(), new.warnings().len()), (15, 0));
    run(shared_engine(), &new, &["fit.radiance"]);
    assert_eq!(ran(&run(shared_engine(), &old, &["fit.radiance"])), [""; 0]);
    let length = |unit: &str| {
        ron::from_str::<KnownLength>(&format!("(from: (0, 0), to: (9, 0), {unit}: 2.5)"))
    };
    assert_eq!(length("metres").expect("the old name"), length("meters").expect("the new name"));
}
