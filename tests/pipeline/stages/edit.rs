//! `EditLights`: radiances and places after each edit are exact.

use std::collections::BTreeMap;
use std::f32::consts::PI;
use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, Gather, Node, NodeError, Params};
use relight::image::{Transfer, luminance};
use relight::nodes::artifacts::{EmitterChange, Encoding};
use relight::nodes::edit::edit_lights::{EditLights, EditLightsIn};
use relight::optics::{Radiance, Shape, black_body};

use super::*;

/// Illuminance at which white shows 1.
const LUX: f32 = 400.0;

/// Shape, radiance and gain of each light after the edit.
type Edited = BTreeMap<String, (Arc<Shape>, Vec<Vec3>, Vec<Vec3>)>;

/// The stage with an edit as a person writes it.
fn stage(lights: &str) -> EditLights {
    let mut stage = EditLights::default();
    stage
        .set("lights", lights)
        .expect("there is such a parameter")
        .unwrap_or_else(|e| panic!("{lights}: {e}"));
    stage
}

/// The lights of the scene, with these radiances.
fn lights(radiances: Gather<Radiance>) -> EditLightsIn {
    let scene = scene();
    EditLightsIn {
        shapes: scene.each(|light| light.shape.clone()),
        radiances,
        camera: scene.camera.clone(),
        depth: scene.depth.clone(),
        normal: scene.normal.clone(),
        encoding: Arc::new(Encoding {
            transfer: Transfer::Srgb,
            lux: Some(LUX),
            sixteen_bit: false,
            exif: Vec::new(),
        }),
    }
}

/// Shape, radiance and gain of each light after an edit as a person writes it.
fn edited(edit: &str) -> Result<Edited, NodeError> {
    let stage = stage(edit);
    stage.check().unwrap_or_else(|e| panic!("{edit}: {e}"));
    let inputs = lights(scene().each(|light| light.radiance.clone()));
    let out = stage.run(inputs, &Context::default())?;
    let each = out.shape.0.into_iter().zip(out.radiance.0).zip(out.gain.0);
    Ok(each
        .map(|(((id, shape), (_, w)), (_, gain))| (id, (shape, w.0.clone(), gain.gain.clone())))
        .collect())
}

/// One light after an edit; asserts that all others pass through to the bit.
fn only(id: &str, edit: &str) -> (Arc<Shape>, Vec<Vec3>, Vec<Vec3>) {
    let mut all =
        edited(&format!("{{ {id:?}: {edit} }}")).unwrap_or_else(|e| panic!("{edit}: {e}"));
    let light = all.remove(id).expect("the edited light is a member");
    for light in scene().lights.iter().filter(|light| light.id != id) {
        let (shape, radiance, gain) = &all[light.id];
        assert!(Arc::ptr_eq(shape, &light.shape), "{edit}: {} keeps its shape", light.id);
        assert_eq!(radiance, &light.radiance.0, "{edit}: {}", light.id);
        assert_eq!(gain, &vec![Vec3::ONE; radiance.len()], "{edit}: {}", light.id);
    }
    light
}

#[test]
fn radiances_after_an_edit_are_exact() {
    let sphere = || Arc::new(sphere(LAMP));
    assert_eq!(only("lamp", "Off"), (sphere(), vec![Vec3::ZERO], vec![Vec3::ZERO]));
    // A power of two, so that the product is exact in floating point.
    assert_eq!(only("lamp", "Scale(0.25)"), (sphere(), vec![0.25 * WARM], vec![Vec3::splat(0.25)]));
    let (shape, radiance, gain) = only("window", "Scale(2)");
    assert_eq!(
        (shape, radiance),
        (Arc::new(Shape::Window(window())), DAY.map(|w| 2.0 * w).to_vec())
    );
    // The sun gave nothing and so keeps its color, gray, times two.
    assert_eq!(gain, vec![Vec3::splat(2.0); 3]);

    // A color replaces the chromaticity and keeps the luminance; each is a few roundings of 6e-8.
    let color = Vec3::new(0.2, 0.5, 1.0);
    for (edit, wanted) in [("Color(0.2, 0.5, 1)", color), ("Temperature(2700)", black_body(2700.0))]
    {
        let (_, radiance, gain) = only("lamp", edit);
        assert!(
            (luminance(radiance[0]) / luminance(WARM) - 1.0).abs() < 1e-6,
            "{edit}: {radiance:?}"
        );
        let (got, wanted) = (radiance[0] / luminance(radiance[0]), wanted / luminance(wanted));
        assert!((got - wanted).abs().max_element() < 1e-6, "{edit}: {got} against {wanted}");
        assert!((gain[0] * WARM - radiance[0]).abs().max_element() < 1e-5, "{edit}: {gain:?}");
    }
}

#[test]
fn a_moved_lamp_keeps_its_form_and_its_radiance() {
    let by = Vec3::new(0.5, -0.25, 0.125);
    let (shape, radiance, gain) = only("lamp", "Move(by: (0.5, -0.25, 0.125))");
    assert_eq!(*shape, sphere((LAMP.0 + by, LAMP.1)));
    assert_eq!((radiance, gain), (vec![WARM], vec![Vec3::ZERO]));
    let (shape, ..) = only("lamp", "Move(to: Point(0, 0.5, -2))");
    assert_eq!(*shape, sphere((Vec3::new(0.0, 0.5, -2.0), LAMP.1)));
    // Onto the floor at the bottom of the picture, where it stands and does not sink in: 2 mm are
    // the rounding of the plane fit.
    let (shape, ..) = only("lamp", "Move(to: Pixel(x: 50.5, y: 90.5))");
    let (camera, at) = (&scene().camera, center(&shape));
    let floor = camera.unproject(50.5, 90.5, 1.0) * (1.2 / -camera.unproject(50.5, 90.5, 1.0).y);
    assert!(at.distance(floor + Vec3::Y * LAMP.1) < 0.002, "{at} over {floor}");
    for (id, wanted) in [
        ("window", "wanted a lamp, got a window"),
        ("nowhere", "the light to change does not exist"),
    ] {
        let message = edited(&format!("{{ {id:?}: Move(by: (1, 0, 0)) }}"))
            .map(drop)
            .expect_err("it cannot be moved");
        assert!(matches!(&message, NodeError::BadParameter(m) if m.contains(wanted)), "{message}");
    }
}

/// A Lambertian body of area A and radiance L sends pi A L; white under E lux shows 1 and so has a
/// luminance of E / pi.
#[test]
fn an_inserted_lamp_has_the_flux_that_it_is_given() {
    let [a, b, c] = [0.3f32, 0.2, 0.1];
    for (form, area) in [
        ("Sphere(radius: 0.2)", 4.0 * PI * 0.2 * 0.2),
        ("Rect(half: (0.3, 0.2), normal: (0, -1, 0))", 4.0 * a * b),
        ("Box(half: (0.3, 0.2, 0.1), yaw: 30)", 8.0 * (a * b + b * c + c * a)),
    ] {
        let edit =
            format!("Lamp(shape: {form}, at: Point(0, 0, -2), flux: 800, temperature: 3000)");
        let (shape, radiance, gain) = only("desk", &edit);
        assert_eq!(gain, [Vec3::ZERO], "no photo pixel shows it");
        let lumens = PI * area * luminance(radiance[0]) * LUX / PI;
        assert!((lumens / 800.0 - 1.0).abs() < 1e-5, "{form}: {lumens} lumens");
        assert!((shape.flux(0) / (PI * area) - 1.0).abs() < 1e-5, "{form}: {}", shape.flux(0));
        let color = radiance[0] / luminance(radiance[0]);
        assert!((color - black_body(3000.0)).abs().max_element() < 1e-5, "{form}: {color}");
    }
}

/// Radiance and change of the lamp in view, of radiance `estimated`, after `edit`.
fn lamp_after(edit: &str, estimated: Vec3) -> (Vec3, EmitterChange) {
    let stage = stage(&format!("{{ \"lamp\": {edit} }}"));
    stage.check().unwrap_or_else(|e| panic!("{edit}: {e}"));
    let radiances = scene().each(|light| match light.id {
        "lamp" => Arc::new(Radiance(vec![estimated])),
        _ => light.radiance.clone(),
    });
    let out =
        stage.run(lights(radiances), &Context::default()).unwrap_or_else(|e| panic!("{edit}: {e}"));
    let of = |(id, _): &&(String, Arc<Radiance>)| id == "lamp";
    let radiance = out.radiance.0.iter().find(of).expect("the lamp is a member").1.0[0];
    let change = out.gain.0.iter().find(|(id, _)| id == "lamp").expect("the lamp is a member");
    (radiance, (*change.1).clone())
}

/// Lumens of the lamp in view at this radiance.
fn lumens(radiance: Vec3) -> f32 {
    4.0 * PI * LAMP.1 * LAMP.1 * luminance(radiance) * LUX
}

#[test]
fn a_lamp_switched_on_with_its_own_flux_is_as_it_was() {
    // A lamp that shines, one that is dim, one that counts as off.
    for radiance in [WARM, Vec3::new(0.16, 0.15, 0.12), Vec3::splat(0.02)] {
        for edit in [format!("On(flux: {})", lumens(radiance)), "Scale(1)".to_owned()] {
            let (got, change) = lamp_after(&edit, radiance);
            assert!(off(got, radiance) < 1e-6, "{edit}: {got}");
            assert!(off(change.gain[0], Vec3::ONE) < 1e-6, "{edit}: {change:?}");
            assert!(change.added.abs().max_element() < 1e-7, "{edit}: {change:?}");
        }
    }
    let (got, change) = lamp_after("On()", WARM);
    assert!(off(got, WARM) < 1e-6 && off(change.gain[0], Vec3::ONE) < 1e-6, "{got} {change:?}");
}

#[test]
fn switching_a_lamp_that_shines_on_with_twice_its_flux_is_a_scale_of_two() {
    let on = lamp_after(&format!("On(flux: {})", 2.0 * lumens(WARM)), WARM);
    let scaled = lamp_after("Scale(2)", WARM);
    assert!(off(on.0, scaled.0) < 1e-6, "{} against {}", on.0, scaled.0);
    assert!(off(on.1.gain[0], scaled.1.gain[0]) < 1e-6, "{:?}", on.1);
    assert_eq!((on.1.added, scaled.1.added), (Vec3::ZERO, Vec3::ZERO));
}

#[test]
fn a_dark_lamp_that_is_switched_on_shows_its_new_radiance() {
    let (got, change) = lamp_after("On(flux: 800, temperature: 3000)", Vec3::ZERO);
    assert!((lumens(got) / 800.0 - 1.0).abs() < 1e-5, "{} lumens", lumens(got));
    assert!(off(got / luminance(got), black_body(3000.0)) < 1e-5, "{got}");
    assert_eq!(change, EmitterChange { gain: vec![Vec3::ONE], added: got, dark: 1.0 });
    // Without flux and temperature: white, with the flux of the other lamp, which is out of view.
    let (got, change) = lamp_after("On()", Vec3::ZERO);
    let wanted = Vec3::splat(luminance(WHITE) * (UNSEEN.1 / LAMP.1).powi(2));
    assert!(off(got, wanted) < 1e-5, "{got} against {wanted}");
    assert_eq!(change.added, got);
    // A factor cannot do that.
    assert_eq!(lamp_after("Scale(5)", Vec3::ZERO).0, Vec3::ZERO);
}

#[test]
fn changes_apply_in_their_order() {
    let warm = |level: f32| black_body(2700.0) * level;
    let (got, _) = lamp_after("Changes([Scale(0.5), Temperature(2700)])", WARM);
    assert!(off(got, warm(0.5 * luminance(WARM))) < 1e-6, "{got}");
    let (got, _) = lamp_after("Changes([On(flux: 800), Scale(0.25), Temperature(2700)])", WARM);
    assert!((lumens(got) / 200.0 - 1.0).abs() < 1e-5, "{} lumens", lumens(got));
    assert!(off(got / luminance(got), warm(1.0)) < 1e-5, "{got}");
    let by = Vec3::new(0.5, -0.25, 0.125);
    for edit in
        ["Move(by: (0.5, -0.25, 0.125)), Scale(0.5)", "Scale(0.5), Move(by: (0.5, -0.25, 0.125))"]
    {
        let (shape, radiance, gain) = only("lamp", &format!("Changes([{edit}])"));
        assert_eq!(*shape, sphere((LAMP.0 + by, LAMP.1)), "{edit}");
        assert_eq!((radiance, gain), (vec![0.5 * WARM], vec![Vec3::ZERO]), "{edit}");
    }
    assert_eq!(only("lamp", "Changes([Off])"), only("lamp", "Off"));
    let (_, radiance, _) = only("window", "Changes([Scale(2), Color(1, 1, 1)])");
    assert!((luminance(radiance[1]) / luminance(2.0 * DAY[1]) - 1.0).abs() < 1e-6, "{radiance:?}");
}

#[test]
fn changes_that_contradict_each_other_are_refused() {
    for (changes, wanted) in [
        ("", "wanted at least one change, got none"),
        ("Off, Scale(2)", "item 2: Scale contradicts Off"),
        ("Scale(2), Off", "item 2: Off contradicts Scale"),
        ("Scale(2), Temperature(3000), Scale(1)", "item 3: Scale is given twice"),
        ("Temperature(3000), Color(1, 1, 1)", "item 2: Color contradicts Temperature"),
        (
            "On(temperature: 3000), Temperature(4000)",
            "item 2: Temperature contradicts the temperature of On",
        ),
        ("Scale(2), On(flux: 1)", "item 2: On replaces the radiance that Scale changed"),
        (
            "Scale(2), Lamp(shape: Sphere(radius: 1), at: Point(0, 0, -1), flux: 1)",
            "item 2: Lamp makes a light",
        ),
        ("Changes([Off])", "item 1: a list of changes contains no other list"),
        ("Scale(1), Temperature(10)", "item 2: temperature (K): wanted"),
        ("On(flux: -1)", "item 1: On: flux (lumens): wanted"),
    ] {
        let text = format!("{{ \"lamp\": Changes([{changes}]) }}");
        let message = stage(&text).check().expect_err(changes);
        let start = format!("lights: \"lamp\": {wanted}");
        assert!(message.starts_with(&start), "{changes}: {message}");
    }
    for id in ["window", "nowhere"] {
        let message =
            edited(&format!("{{ {id:?}: On() }}")).map(drop).expect_err("it is not a lamp");
        let wanted = if id == "window" { "got a window" } else { "does not exist" };
        assert!(matches!(&message, NodeError::BadParameter(m) if m.contains(wanted)), "{message}");
    }
}
