//! `EditLights`: radiances and places after each edit are exact.

use std::collections::BTreeMap;
use std::f32::consts::PI;
use std::sync::Arc;

use glam::Vec3;
use relight::graph::{Context, Node, NodeError, Params};
use relight::image::{Transfer, luminance};
use relight::nodes::artifacts::Encoding;
use relight::nodes::edit::edit_lights::{EditLights, EditLightsIn};
use relight::optics::{Shape, black_body};

use super::*;

/// Illuminance at which white shows 1.
const LUX: f32 = 400.0;

/// Shape, radiance and gain of each light after the edit.
type Edited = BTreeMap<String, (Arc<Shape>, Vec<Vec3>, Vec<Vec3>)>;

/// Shape, radiance and gain of each light after an edit as a person writes it.
fn edited(lights: &str) -> Result<Edited, NodeError> {
    let scene = scene();
    let mut stage = EditLights::default();
    stage
        .set("lights", lights)
        .expect("there is such a parameter")
        .unwrap_or_else(|e| panic!("{lights}: {e}"));
    stage.check().unwrap_or_else(|e| panic!("{lights}: {e}"));
    let inputs = EditLightsIn {
        shapes: scene.each(|light| light.shape.clone()),
        radiances: scene.each(|light| light.radiance.clone()),
        camera: scene.camera.clone(),
        depth: scene.depth.clone(),
        normal: scene.normal.clone(),
        encoding: Arc::new(Encoding {
            transfer: Transfer::Srgb,
            lux: Some(LUX),
            sixteen_bit: false,
        }),
    };
    let out = stage.run(inputs, &Context::default())?;
    let each = out.shape.0.into_iter().zip(out.radiance.0).zip(out.gain.0);
    Ok(each
        .map(|(((id, shape), (_, w)), (_, gain))| (id, (shape, w.0.clone(), gain.0.clone())))
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
