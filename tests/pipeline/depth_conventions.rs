//! Depth networks by the conventions of published ones: tiny networks with the same names and
//! shapes, whose depth is a closed form of the photo.

use relight::geometry::Camera;
use relight::image::{NamedBytes, Plane, read_depth};

use crate::adapters::{SIZE, photo, stored};
use crate::onnx::{OPEN, Onnx};
use crate::project::*;

const LINE: &str = r#"run GRAPHS/depth.ron EDITS/none.ron --scene . --no-cache --out found --set depth.model="net.onnx""#;

fn depth(place: &Place) -> Plane<f32> {
    let bytes = std::fs::read(place.path("found/depth.exr")).expect("it is written");
    read_depth(NamedBytes::new("depth.exr", &bytes)).expect("a scene can name it").0
}

/// Runs the network under a convention; its depth and the report, which has the notes.
fn found(network: Vec<u8>, options: &str) -> (Plane<f32>, String) {
    let place = photo(network);
    place.check(&format!("{LINE} {options}"), 0);
    let report = std::fs::read_to_string(place.path("found/report.json"));
    (depth(&place), report.expect("it is written"))
}

/// The largest relative error, two pixels from the photo's edges, where enlarging is linear.
fn worst(got: &Plane<f32>, columns: usize, wanted: impl Fn(usize, usize) -> f32) -> f32 {
    assert_eq!(got.size(), SIZE);
    let inner = (2..columns).flat_map(|x| (2..SIZE.1 - 2).map(move |y| (x, y)));
    inner.map(|(x, y)| (got.get(x, y) / wanted(x, y) - 1.0).abs()).fold(0.0, f32::max)
}

/// 1 + 4 red + 2 green of the stored numbers.
fn ramp(x: usize, y: usize) -> f32 {
    1.0 + 4.0 * stored(x, y).x + 2.0 * stored(x, y).y
}

/// A network that undoes a normalization and returns `ramp`, [1, height, width].
fn ramp_network(mean: [f32; 2], deviation: [f32; 2]) -> Vec<u8> {
    let network = Onnx::default()
        .input("pixel_values", &[1, 3, OPEN, OPEN])
        .output("predicted_depth", &[1, OPEN, OPEN]);
    let weights = [[4.0 * deviation[0], 2.0 * deviation[1], 0.0]];
    let bias = [1.0 + 4.0 * mean[0] + 2.0 * mean[1]];
    let network = network.mix("pixel_values", "four", &weights, &bias);
    network.numbers("one", &[1]).node("Squeeze", &["four", "one"], &["predicted_depth"]).file()
}

const IMAGE_NET: ([f32; 2], [f32; 2]) = ([0.485, 0.456], [0.229, 0.224]);

#[test]
fn depth_anything_for_meters() {
    let network = ramp_network(IMAGE_NET.0, IMAGE_NET.1);
    let (got, message) = found(network, "--set depth.convention=DepthAnythingMetric");
    assert!(message.contains("Depth Anything, metric, in meters, seen at 686 x 518"), "{message}");
    assert!(worst(&got, SIZE.0 - 2, ramp) < 1e-3, "{}", worst(&got, SIZE.0 - 2, ramp));
}

/// 1 / z is the network's ramp up to a factor and an offset.
#[test]
fn relative_conventions() {
    for (name, [mean, deviation], side) in [
        ("DepthAnything", [IMAGE_NET.0, IMAGE_NET.1], "686 x 518"),
        ("Midas", [IMAGE_NET.0, IMAGE_NET.1], "512 x 384"),
        ("Dpt", [[0.5; 2]; 2], "512 x 384"),
    ] {
        let options = format!(
            "--set depth.convention={name} --known-length 5,3,34.5,28=2 --set depth.span=3"
        );
        let (got, message) = found(ramp_network(mean, deviation), &options);
        assert!(message.contains(&format!("relative, seen at {side}")), "{message}");
        let slope = |x: usize, y: usize| {
            let inverse = |x, y| 1.0 / got.get(x, y);
            (inverse(x + 9, y) - inverse(x, y)) / (ramp(x + 9, y) - ramp(x, y))
        };
        let middle = slope(15, 15);
        assert!(middle > 0.0, "{name}: larger is nearer");
        for (x, y) in [(3, 4), (28, 4), (3, 26), (28, 26)] {
            assert!((slope(x, y) / middle - 1.0).abs() < 5e-3, "{name}: {} {middle}", slope(x, y));
        }
    }
}

/// 1 + 4 red + 2 green, and the mean red of the frame, of the numbers 0 to 255 in 1064 x 616.
fn metric3d() -> Vec<u8> {
    let shape = [1, 1, 616, 1064];
    let network = Onnx::default().input("image", &[1, 3, 616, 1064]).output("pred_depth", &shape);
    let per_pixel = network.mix("image", "ramp", &[[4.0 / 255.0, 2.0 / 255.0, 0.0]], &[1.0]);
    let mean = per_pixel.node("GlobalAveragePool", &["image"], &["mean"]);
    let red = mean.mix("mean", "red", &[[1.0 / 255.0, 0.0, 0.0]], &[0.0]);
    red.node("Add", &["ramp", "red"], &["pred_depth"]).file()
}

/// 40 x 30 pixels become 821 x 616 between columns of the mean color.
#[test]
fn metric3d_is_scaled_by_the_focal_length() {
    let share = 821.0 / 1064.0;
    let red = share * (60.0 + 4.0 * 19.5) / 255.0 + (1.0 - share) * 0.485;
    let focal = 20.0 / 30.0f32.to_radians().tan() * 821.0 / 40.0;
    let wanted = |x, y| (ramp(x, y) + red) * focal / 1000.0;
    for options in ["", "--set depth.convention=Metric3d"] {
        let (got, message) = found(metric3d(), options);
        assert!(message.contains("Metric3D, in meters, seen at 1064 x 616"), "{message}");
        let worst = worst(&got, SIZE.0 - 2, wanted);
        assert!(worst < 2e-3, "{worst}");
    }
}

/// Points of depth 1 + red for the photo's camera, moved by -0.7 along z, in half the meters; the
/// mask leaves out the right eighth.
fn moge() -> Vec<u8> {
    let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 60.0).resized(518, 389);
    let (size, top) = (518usize, (518 - 389) / 2);
    let mut tangents = vec![0.0f32; 3 * size * size];
    let mut mask = vec![0.0f32; size * size];
    for i in 0..size * size {
        let (x, y) = ((i % size) as f32 + 0.5, (i / size) as f32 + 0.5 - top as f32);
        let ray = camera.unproject(x, y, 1.0);
        tangents[i] = ray.x;
        tangents[size * size + i] = -ray.y;
        tangents[2 * size * size + i] = 1.0;
        mask[i] = f32::from(i % size < 453);
    }
    let n = size as i64;
    let network = Onnx::default()
        .input("image", &[1, 3, n, n])
        .output("points", &[1, n, n, 3])
        .output("mask", &[1, n, n])
        .output("metric_scale", &[1]);
    let red = [1.0, 0.0, 0.0];
    network
        .mix("image", "z", &[red; 3], &[1.0; 3])
        .floats("tangents", &[1, 3, n, n], &tangents)
        .node("Mul", &["z", "tangents"], &["seen"])
        .floats("back", &[1, 3, 1, 1], &[0.0, 0.0, -0.7])
        .node("Add", &["seen", "back"], &["moved"])
        .node_with("Transpose", &["moved"], &["points"], &[("perm", &[0, 2, 3, 1])])
        .floats("kept", &[1, n, n], &mask)
        .node("Identity", &["kept"], &["mask"])
        .node("GlobalAveragePool", &["image"], &["mean"])
        .mix("mean", "two", &[[0.0; 3]], &[2.0])
        .numbers("all_but_one", &[1, 2, 3])
        .node("Squeeze", &["two", "all_but_one"], &["metric_scale"])
        .file()
}

#[test]
fn moge_gets_its_shift_from_the_camera() {
    for options in ["", "--set depth.convention=Moge"] {
        let (got, message) = found(moge(), options);
        assert!(message.contains("MoGe, in meters, seen at 518 x 518"), "{message}");
        let worst = worst(&got, 34, |x, y| 2.0 * (1.0 + stored(x, y).x));
        assert!(worst < 2e-3, "{worst}");
        assert!(got.pixels().iter().all(|z| *z > 2.0 && *z < 4.0), "the hole is filled");
    }
}

#[test]
fn one_number_everywhere_is_no_depth() {
    let even = |value: f32| {
        let shape = [1, 1, OPEN, OPEN];
        let network = Onnx::default().input("x", &[1, 3, OPEN, OPEN]).output("z", &shape);
        network.mix("x", "z", &[[0.0; 3]], &[value]).file()
    };
    let metric3d = || {
        let network = Onnx::default().input("image", &[1, 3, 616, 1064]);
        let network = network.output("pred_depth", &[1, 1, 616, 1064]);
        network.mix("image", "pred_depth", &[[0.0; 3]], &[3.0]).file()
    };
    for (network, options) in [
        (even(0.0), ""),
        (even(2.5), "--known-length 5,3,34.5,28=2"),
        (even(0.0), "--set depth.convention=DepthAnythingMetric"),
        (even(2.5), "--set depth.convention=Dpt --known-length 5,3,34.5,28=2"),
        (metric3d(), ""),
    ] {
        let message = photo(network).check(&format!("{LINE} {options}"), 2);
        assert!(
            message
                .contains("net.onnx: the network returned no depth: wanted numbers that vary, got"),
            "{message}"
        );
        assert!(
            message.contains("is its `convention` or `normalization` another one?"),
            "{message}"
        );
    }
}

#[test]
fn a_convention_states_its_parameters() {
    let place = photo(ramp_network(IMAGE_NET.0, IMAGE_NET.1));
    let options = "--set depth.convention=Dpt --set depth.kind=Metric";
    let message = place.check(&format!("{LINE} {options}"), 2);
    assert!(
        message.contains("convention: Dpt states `side`, `multiple`, `normalization` and `kind`"),
        "{message}"
    );
    let message = place.check(&format!("{LINE} --set depth.convention=ZoeDepth"), 2);
    assert!(message.contains("Metric3d"), "{message}");
}
