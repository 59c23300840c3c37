//! `EditLights`: lights switched, dimmed, coloured, moved, and new ones.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::{Ground, Place, level};
use crate::geometry::{Camera, PlaneFit, world_up};
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Depth, Normal, luminance};
use crate::nodes::artifacts::Encoding;
use crate::optics::{Lamp, Lobe, Radiance, Shape, Window, black_body};
use crate::{params, ports};

params! {
    /// Changes lights and adds new ones; lights that the edit does not name pass through unchanged.
    pub struct EditLights {
        /// What happens to each named light: `Off`, `Scale(0.4)`, `Temperature(2700)`, `Color(1, 0.8, 0.6)`, `Lamp(..)`, `Window(..)`.
        lights: BTreeMap<String, LightEdit> = BTreeMap::new(),
        /// Illuminance in lux at which a white surface shows 1.0, for fluxes in lumens, when the scene does not say.
        assumed_lux: f32 = 300.0,
    }
}

/// One entry of an edit's `lights`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LightEdit {
    /// No light.
    Off,
    /// Radiance times a factor >= 0.
    Scale(f32),
    /// The colour of a black body, 1000..=40000 K, at unchanged luminance.
    Temperature(f32),
    /// This linear RGB colour, at unchanged luminance.
    Color(f32, f32, f32),
    /// A lamp of known shape, new or in the place of another light.
    Lamp {
        shape: LampShape,
        at: Place,
        /// Lumens; needs the scene's exposure. Either this or `radiance`.
        #[serde(default)]
        flux: Option<f32>,
        /// Linear RGB in units of the photo: what the lamp itself would show.
        #[serde(default)]
        radiance: Option<[f32; 3]>,
        /// Kelvin; the colour of `flux`, 2700 when not given.
        #[serde(default)]
        temperature: Option<f32>,
    },
    /// A window on a seen wall.
    Window {
        /// Its four corners in photo pixels, in order around it.
        corners: Vec<[f32; 2]>,
        /// What it shows: the same everywhere when `ground` is not given, else the upper part.
        #[serde(default)]
        sky: Half,
        /// The lower part of what it shows.
        #[serde(default)]
        ground: Option<Half>,
        #[serde(default)]
        sun: Option<Sun>,
    },
}

/// The form of an inserted lamp, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LampShape {
    Sphere {
        radius: f32,
    },
    /// Emits to the side of `normal`; `half` edges.
    Rect {
        half: [f32; 2],
        normal: [f32; 3],
    },
    /// Upright; `half` edges along x, y, z, turned about y by `yaw` degrees.
    Box {
        half: [f32; 3],
        #[serde(default)]
        yaw: f32,
    },
}

/// Half of a window's surrounding: above or below the horizon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Half {
    /// Linear RGB in units of the photo.
    Radiance(f32, f32, f32),
}

impl Default for Half {
    /// An overcast sky.
    fn default() -> Half {
        Half::Radiance(4.0, 4.4, 5.0)
    }
}

impl Half {
    fn rgb(&self) -> Vec3 {
        let Half::Radiance(r, g, b) = *self;
        Vec3::new(r, g, b)
    }
}

/// The sun in a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Sun {
    /// Degrees: azimuth from the view direction towards the right, elevation above the horizon.
    Direction {
        azimuth: f32,
        elevation: f32,
        /// Peak radiance; when not given, such that a white surface facing the sun shows 3.
        #[serde(default)]
        radiance: Option<[f32; 3]>,
        /// 1e4 is a sun of about one degree.
        #[serde(default = "Sun::bandwidth")]
        bandwidth: f32,
    },
}

impl Sun {
    fn bandwidth() -> f32 {
        1e4
    }
}

ports! {
    pub input EditLightsIn {
        /// The estimated lights.
        shapes: Gather<Shape>,
        /// Their radiances.
        radiances: Gather<Radiance>,
        /// The camera of the photo.
        camera: Arc<Camera>,
        /// Planar z at the photo's size, for places given as pixels.
        depth: Arc<Depth>,
        /// Normals, at any size.
        normal: Arc<Normal>,
        /// The scene's exposure.
        encoding: Arc<Encoding>,
    }
}

ports! {
    pub output EditLightsOut {
        /// Place, extent and direction of every light after the edit.
        shape: Scatter<Shape>,
        /// Radiance of every light after the edit.
        radiance: Scatter<Radiance>,
        /// Radiance after over radiance before, per lobe and channel: what a visible light's own pixels change by.
        gain: Scatter<Radiance>,
    }
}

impl Node for EditLights {
    const KIND: &'static str = "EditLights";
    const VERSION: u32 = 3;
    type In = EditLightsIn;
    type Out = EditLightsOut;

    fn check(&self) -> Result<(), String> {
        if !(self.assumed_lux > 0.0 && self.assumed_lux.is_finite()) {
            return Err(format!("assumed_lux: wanted a positive number, got {}", self.assumed_lux));
        }
        self.lights.iter().try_for_each(|(id, edit)| edit.check().map_err(|e| format!("lights: {id:?}: {e}")))
    }

    fn run(&self, inputs: EditLightsIn, ctx: &Context) -> Result<EditLightsOut, NodeError> {
        let up = world_up(&inputs.normal);
        let mut out = EditLightsOut { shape: Scatter(vec![]), radiance: Scatter(vec![]), gain: Scatter(vec![]) };
        let mut push = |id: &str, shape: Arc<Shape>, radiance: Radiance, gain: Radiance| {
            let within = |lobe: &&Vec3| lobe.cmple(Vec3::splat(MOST_RADIANCE)).all();
            if let Some(lobe) = radiance.0.iter().find(|lobe| !within(lobe)) {
                let told =
                    format!("lights: {id:?}: wanted a radiance up to {MOST_RADIANCE:e}, got {:e}", lobe.max_element());
                return Err(NodeError::BadParameter(told));
            }
            out.shape.0.push((id.into(), shape));
            out.radiance.0.push((id.into(), Arc::new(radiance)));
            out.gain.0.push((id.into(), Arc::new(gain)));
            Ok(())
        };
        for (id, shape) in inputs.shapes.iter() {
            let old = inputs.radiances.get(id).map(|r| r.0.clone()).unwrap_or_else(|| vec![Vec3::ZERO; shape.lobes()]);
            let edit = self.lights.get(id);
            if let Some((shape, radiance)) = edit.and_then(|e| self.made(id, e, &inputs, up, ctx)).transpose()? {
                // The old light is gone; the new one is drawn as what it is.
                let gain = vec![Vec3::ZERO; radiance.0.len()];
                push(id, Arc::new(shape), radiance, Radiance(gain))?;
                continue;
            }
            let new: Vec<Vec3> = old.iter().map(|&w| edit.map_or(w, |e| e.applied(w))).collect();
            let gain = old.iter().zip(&new).map(|(&old, &new)| {
                // A light that the fit gave nothing still shows in its own pixels: there its colour is taken as grey.
                let (old, new) = if old.max_element() > 0.0 {
                    (old, new)
                } else {
                    (Vec3::ONE, edit.map_or(Vec3::ONE, |e| e.applied(Vec3::ONE)))
                };
                Vec3::from_array([0, 1, 2].map(|c| {
                    if new[c] == old[c] {
                        1.0
                    } else if old[c] > 0.0 {
                        new[c] / old[c]
                    } else {
                        0.0
                    }
                }))
            });
            let gain = Radiance(gain.collect());
            push(id, shape.clone(), Radiance(new), gain)?;
        }
        for (id, edit) in &self.lights {
            if inputs.shapes.get(id).is_some() {
                continue;
            }
            let Some(made) = self.made(id, edit, &inputs, up, ctx) else {
                return Err(NodeError::BadParameter(format!("lights: {id:?}: there is no such light to change")));
            };
            let (shape, radiance) = made?;
            let gain = vec![Vec3::ZERO; radiance.0.len()];
            push(id, Arc::new(shape), radiance, Radiance(gain))?;
        }
        Ok(out)
    }
}

/// Brightest light that leaves room in single precision for sums of many.
const MOST_RADIANCE: f32 = 1e30;

impl LightEdit {
    fn check(&self) -> Result<(), String> {
        let not_negative = |name: &str, values: &[f32]| match values.iter().find(|v| !(**v >= 0.0 && v.is_finite())) {
            Some(v) => Err(format!("{name}: wanted numbers >= 0, got {v}")),
            None => Ok(()),
        };
        let positive = |name: &str, values: &[f32]| match values.iter().find(|v| !(**v > 0.0 && v.is_finite())) {
            Some(v) => Err(format!("{name}: wanted numbers > 0, got {v}")),
            None => Ok(()),
        };
        let kelvin = |t: f32| match (1000.0..=40000.0).contains(&t) {
            true => Ok(()),
            false => Err(format!("temperature: wanted 1000..=40000 K, got {t}")),
        };
        match self {
            LightEdit::Off => Ok(()),
            LightEdit::Scale(s) => not_negative("Scale", &[*s]),
            LightEdit::Temperature(t) => kelvin(*t),
            LightEdit::Color(r, g, b) => {
                not_negative("Color", &[*r, *g, *b])?;
                if r + g + b > 0.0 { Ok(()) } else { Err("Color: wanted a colour, got black; use Off".into()) }
            }
            LightEdit::Lamp { shape, at: _, flux, radiance, temperature } => {
                match shape {
                    LampShape::Sphere { radius } => positive("radius", &[*radius])?,
                    LampShape::Rect { half, normal } => {
                        positive("half", half)?;
                        if Vec3::from_array(*normal).try_normalize().is_none() {
                            return Err(format!("normal: wanted a direction, got {normal:?}"));
                        }
                    }
                    LampShape::Box { half, .. } => positive("half", half)?,
                }
                temperature.map_or(Ok(()), kelvin)?;
                match (flux, radiance) {
                    (Some(flux), None) => not_negative("flux", &[*flux]),
                    (None, Some(radiance)) if temperature.is_none() => not_negative("radiance", radiance),
                    (None, Some(_)) => Err("temperature goes with flux; radiance has its own colour".into()),
                    (None, None) => Err("wanted flux (lumens) or radiance (r, g, b)".into()),
                    (Some(_), Some(_)) => Err("flux and radiance exclude each other".into()),
                }
            }
            LightEdit::Window { corners, sky, ground, sun } => {
                convex(corners)?;
                not_negative("sky", &sky.rgb().to_array())?;
                not_negative("ground", &ground.as_ref().map_or(Vec3::ZERO, Half::rgb).to_array())?;
                if let Some(Sun::Direction { elevation, radiance, bandwidth, .. }) = sun {
                    not_negative("sun radiance", &radiance.unwrap_or_default())?;
                    not_negative("sun bandwidth", &[*bandwidth])?;
                    if !(-90.0..=90.0).contains(elevation) {
                        return Err(format!("sun elevation: wanted -90..=90 degrees, got {elevation}"));
                    }
                }
                Ok(())
            }
        }
    }

    /// The radiance of an existing light after this edit.
    fn applied(&self, radiance: Vec3) -> Vec3 {
        match *self {
            LightEdit::Off => Vec3::ZERO,
            LightEdit::Scale(factor) => radiance * factor,
            LightEdit::Temperature(kelvin) => black_body(kelvin) * luminance(radiance),
            LightEdit::Color(r, g, b) => {
                let colour = Vec3::new(r, g, b);
                colour / luminance(colour) * luminance(radiance)
            }
            LightEdit::Lamp { .. } | LightEdit::Window { .. } => radiance,
        }
    }
}

impl EditLights {
    /// The light that an edit makes, or `None` when it only changes one.
    fn made(
        &self,
        id: &str,
        edit: &LightEdit,
        inputs: &EditLightsIn,
        up: Vec3,
        ctx: &Context,
    ) -> Option<Result<(Shape, Radiance), NodeError>> {
        let failed = |message: String| NodeError::BadParameter(format!("lights: {id:?}: {message}"));
        match edit {
            LightEdit::Lamp { shape, at, flux, radiance, temperature } => Some(
                lamp(shape, at, inputs, up)
                    .and_then(|lamp| {
                        let radiance = match radiance {
                            Some(rgb) => Vec3::from_array(*rgb),
                            None => {
                                let lux = inputs.encoding.lux.unwrap_or_else(|| {
                                    ctx.warn(format!(
                                        "light {id:?}: the scene gives no exposure; white is taken to show 1.0 at {} lux",
                                        self.assumed_lux
                                    ));
                                    self.assumed_lux
                                });
                                // Flux = pi x area x luminance for a Lambertian surface; a white surface under `lux` has
                                // luminance lux / pi and shows 1.
                                let level = flux.unwrap_or(0.0) / (lamp.area() * lux);
                                black_body(temperature.unwrap_or(2700.0)) * level
                            }
                        };
                        if !radiance.is_finite() {
                            return Err(format!("wanted a body with room for its flux, got a radiance of {radiance}"));
                        }
                        Ok((Shape::Lamp(lamp), Radiance(vec![radiance])))
                    })
                    .map_err(failed),
            ),
            LightEdit::Window { corners, sky, ground, sun } => Some(
                window(corners, inputs, up)
                    .map(|window| surrounded(window, up, sky, ground.as_ref(), sun.as_ref()))
                    .map_err(failed),
            ),
            _ => None,
        }
    }
}

impl EditLightsIn {
    fn ground(&self, up: Vec3) -> Ground<'_> {
        Ground { camera: &self.camera, depth: &self.depth, normal: &self.normal, up }
    }
}

fn lamp(shape: &LampShape, at: &Place, inputs: &EditLightsIn, up: Vec3) -> Result<Lamp, String> {
    let reach = match shape {
        LampShape::Sphere { radius } => *radius,
        LampShape::Rect { .. } => 0.0,
        LampShape::Box { half, .. } => half[1],
    };
    let center = match *at {
        Place::Point(x, y, z) => Vec3::new(x, y, z),
        Place::Pixel { x, y, lift } => {
            let (point, normal) = inputs.ground(up).foot(x, y)?;
            point + normal * lift.max(reach)
        }
    };
    Ok(match shape {
        LampShape::Sphere { radius } => Lamp::Sphere { center, radius: *radius },
        LampShape::Rect { half, normal } => {
            let normal = Vec3::from_array(*normal).normalize();
            // `x` level, so that the first half edge runs along the floor.
            let x = up.cross(normal).try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
            Lamp::Rect { center, x: x * half[0], y: normal.cross(x) * half[1] }
        }
        LampShape::Box { half, yaw } => {
            let (right, ahead) = level(up);
            let (sin, cos) = yaw.to_radians().sin_cos();
            let (x, z) = (right * cos + ahead * sin, right * sin - ahead * cos);
            Lamp::Box { center, axes: [x * half[0], up * half[1], z * half[2]] }
        }
    })
}

/// The four corners of a window in the picture.
fn convex(corners: &[[f32; 2]]) -> Result<[Vec2; 4], String> {
    let four: [[f32; 2]; 4] =
        corners.try_into().map_err(|_| format!("corners: wanted 4 pixels, got {}", corners.len()))?;
    let corner = four.map(Vec2::from_array);
    let side = |i: usize| corner[(i + 1) % 4] - corner[i % 4];
    let turns = [0, 1, 2, 3].map(|i| side(i).perp_dot(side(i + 1)));
    let around = turns.iter().all(|&t| t >= 0.0) || turns.iter().all(|&t| t <= 0.0);
    let area = (corner[2] - corner[0]).perp_dot(corner[3] - corner[1]).abs() / 2.0;
    // A window of less than a pixel shows nothing of its wall.
    if around && area >= 1.0 && area.is_finite() {
        Ok(corner)
    } else {
        Err(format!(
            "corners: wanted the four corners in order around a convex window of at least a pixel, got {four:?}"
        ))
    }
}

/// `window` before a surrounding, and the radiances of its lobes. A sky alone is even, without horizon; sky and ground are broad
/// lobes above and below what lies straight outside.
fn surrounded(mut window: Window, up: Vec3, sky: &Half, ground: Option<&Half>, sun: Option<&Sun>) -> (Shape, Radiance) {
    let outside = window.y.cross(window.x).normalize();
    let towards = |up: Vec3| (up + outside).try_normalize().unwrap_or(outside);
    let bandwidth = if ground.is_some() { 1.5 } else { 0.0 };
    window.lobes = [(towards(up), Sun::bandwidth()), (towards(up), bandwidth), (towards(-up), bandwidth)]
        .map(|(direction, bandwidth)| Lobe { direction, bandwidth });
    let mut radiance = vec![Vec3::ZERO, sky.rgb(), ground.map_or(Vec3::ZERO, Half::rgb)];
    if let Some(Sun::Direction { azimuth, elevation, radiance: given, bandwidth }) = sun {
        let (right, ahead) = level(up);
        let (sin_a, cos_a) = azimuth.to_radians().sin_cos();
        let (sin_e, cos_e) = elevation.to_radians().sin_cos();
        let direction = (right * sin_a + ahead * cos_a) * cos_e + up * sin_e;
        window.lobes[0] = Lobe { direction, bandwidth: *bandwidth };
        // A lobe of bandwidth b and weight w gives a facing white surface 2 w / b.
        let usual = Vec3::new(1.5, 1.41, 1.23) * bandwidth.max(1.0);
        radiance[0] = given.map_or(usual, Vec3::from_array);
    }
    (Shape::Window(window), Radiance(radiance))
}

/// The rectangle on the wall seen between four pixel corners. A wall within 12 degrees of upright is upright,
/// and a window in it whose sides are drawn within 20 degrees of upright stands upright.
fn window(corners: &[[f32; 2]], inputs: &EditLightsIn, up: Vec3) -> Result<Window, String> {
    let camera = &inputs.camera;
    let corner = convex(corners)?;
    let ground = inputs.ground(up);
    let (low, high) = corner.iter().fold((corner[0], corner[0]), |(l, h), &c| (l.min(c), h.max(c)));
    let inside = |p: Vec2| {
        let sides = [0, 1, 2, 3].map(|i| (corner[(i + 1) % 4] - corner[i]).perp_dot(p - corner[i]));
        sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0)
    };
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    let clamp = |v: f32, end: usize| (v.max(0.0) as usize).min(end);
    // About 1,000 places are plenty for a plane.
    let step = (((high - low).max_element() / 32.0) as usize).max(1);
    for y in (clamp(low.y, camera.height)..clamp(high.y + 1.0, camera.height)).step_by(step) {
        for x in (clamp(low.x, camera.width)..clamp(high.x + 1.0, camera.width)).step_by(step) {
            let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            if inside(at) {
                let (point, normal) = ground.seen(at.x, at.y)?;
                points.push(point);
                normals.push(normal);
            }
        }
    }
    let plane = PlaneFit::through(&points, &normals, 0.03)
        .ok_or_else(|| format!("corners: there is no wall to see between {corners:?}"))?;
    // In front of the unevenness of the wall, so that the wall itself does not shade its window.
    let plane = PlaneFit { offset: plane.offset + 2.0 * plane.spread + 0.01, ..plane };
    let middle = corner.iter().sum::<Vec2>() / 4.0;
    let plane = upright(plane, up, camera.unproject(middle.x, middle.y, 1.0));
    let met = corner.map(|c| plane.meet(camera.unproject(c.x, c.y, 1.0)));
    let [Some(a), Some(b), Some(c), Some(d)] = met else {
        return Err(format!("corners: the wall's plane is not seen at each of {corners:?}"));
    };
    let center = (a + b + c + d) / 4.0;
    let x = ((b - a) + (c - d)) / 4.0;
    let y = ((d - a) + (c - b)) / 4.0;
    let y = y - x * (x.dot(y) / x.length_squared().max(1e-12));
    let (x, y) = if x.cross(y).dot(plane.normal) < 0.0 { (-x, y) } else { (x, y) };
    let area = x.cross(y).length();
    if area.is_nan() || area <= 1e-6 {
        return Err(format!("corners: wanted a window with area, got {corners:?}"));
    }
    let turned = (up - plane.normal * plane.normal.dot(up)).try_normalize().and_then(|upright| {
        let sides = [upright, -upright, upright.cross(plane.normal), plane.normal.cross(upright)];
        sides.into_iter().find(|side| side.dot(y.normalize()) > 0.94)
    });
    let (x, y) = match turned {
        Some(side) => (side.cross(plane.normal) * x.length(), side * y.length()),
        None => (x, y),
    };
    Ok(Window { center, x, y, lobes: Window::daylight(plane.normal) })
}

/// The plane turned upright about its point along `ray`, if it nearly is.
fn upright(plane: PlaneFit, up: Vec3, ray: Vec3) -> PlaneFit {
    let normal = (plane.normal - up * plane.normal.dot(up)).normalize_or_zero();
    match plane.meet(ray) {
        Some(point) if normal.dot(plane.normal) > 0.98 => PlaneFit { normal, offset: normal.dot(point), ..plane },
        _ => plane,
    }
}
