//! graphs/refined.ron: lights where they explain the photo best.

use std::collections::BTreeMap;

use relight::graph::EngineOptions;
use relight::optics::Shape;

use crate::project::*;

#[test]
fn refined_lights_explain_the_photo_better_and_keep_what_is_seen() {
    let graph = load(&root().join("graphs/refined.ron"), &demo(), &edits().join("none.ron"));
    let graph = graph.unwrap_or_else(|faults| panic!("{}", faults[0]));
    let report = run(shared_engine(), &graph, &["init.shape", "refine.shape", "write.files"]);
    let [start, refined] = ["init.shape", "refine.shape"]
        .map(|name| many::<Shape>(&report, name).into_iter().collect::<BTreeMap<_, _>>());
    assert_eq!(start.keys().collect::<Vec<_>>(), refined.keys().collect::<Vec<_>>());
    for (id, (before, after)) in start.iter().map(|(id, shape)| (id, (&**shape, &*refined[id]))) {
        match (before, after) {
            (Shape::Window(a), Shape::Window(b)) if id == "window_0" => {
                assert_eq!((a.center, a.x, a.y), (b.center, b.x, b.y), "its frame is seen");
            }
            (Shape::Lamp(_), Shape::Lamp(_)) if id == "lamp_0" => {
                let [(a, r), (b, s)] =
                    [before, after].map(|shape| shape.bounding_sphere().expect("a lamp"));
                assert!(a.normalize().distance(b.normalize()) < 1e-5, "its direction is seen");
                assert!((r / a.length() - s / b.length()).abs() < 1e-5, "its outline is seen");
            }
            _ => assert_eq!(before.lobes(), after.lobes(), "{id}"),
        }
    }
    let node = report.nodes.iter().find(|node| node.name == "refine").expect("it ran");
    let note = node.notes.first().expect("it tells how it went");
    let words: Vec<f64> = note.split([' ', ',']).filter_map(|word| word.parse().ok()).collect();
    assert!(note.starts_with("misfit ") && words[1] <= words[0], "{note}");

    // The same bits on one thread.
    let alone =
        relight::graph::Engine::new(EngineOptions { threads: Some(1), ..EngineOptions::default() });
    let report = run(&alone.expect("a thread can be started"), &graph, &["refine.shape"]);
    assert_eq!(
        many::<Shape>(&report, "refine.shape").into_iter().collect::<BTreeMap<_, _>>(),
        refined
    );
}
