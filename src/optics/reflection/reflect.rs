//! Reflections of shiny surfaces: the weights of the picture's pixels, of each light, and of the
//! unseen part of the room.
//!
//! Each place sends rays distributed like its lobe. A ray that meets the seen room shows the
//! picture's pixel there, edited or not; one that meets a body shows the body's pixel, if the
//! camera sees it; one that leaves the cuboid of the room at a hidden cell shows the cell; all
//! others look into the unseen part of the room. Lights are kept apart, per
//! lobe of unit radiance. Their reflection is estimated twice, by those rays (good for a sharp lobe
//! and a large light) and by rays to samples of the light (good for a broad lobe and a small
//! light). Each direction counts in both, with weights p^2 and q^2 over their sum (the power
//! heuristic of Veach and Guibas, SIGGRAPH 1995): p is the density of the lobe's rays, q one over
//! the solid angle of the light.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ggx::Ggx;
use crate::geometry::{
    Camera, CellGrid, Hit, MAX_CELLS, Objects, RoomLayout, SceneMesh, clearance,
};
use crate::image::{Gloss, Mask, Normal, Plane, Points, rule};
use crate::tuning::tuning;
use {
    crate::optics::Emitter, crate::optics::Lighting, crate::optics::Points2, crate::optics::Shape,
    crate::optics::Silhouette, crate::optics::local_frame,
};

/// Reflections at shading points: the pixels of [`Objects`], or those of a painted surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reflections {
    /// End of each ray, one row per place.
    pub hits: Plane<RayEnd>,
    /// Throughput of each ray: the fraction of the radiance at its end that the place reflects.
    pub weight: Plane<Vec3>,
    /// Radiance from the unseen part of the room, estimated by a network; zero without one.
    pub far: Plane<Vec3>,
    /// The cells of the room's hidden sides that rays may meet; empty without a cuboid.
    pub cells: CellGrid,
    /// Per light, per lobe of unit radiance.
    pub lights: Vec<(String, Vec<Plane<Vec3>>)>,
}

/// End of a reflected ray, packed into four bytes: millions of them are kept.
///
/// A pixel is its index, below 2^31. A cell has the highest bit, then 15 bits of its index and 8 of
/// each coordinate within the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct RayEnd(u32);

/// Meaning of a [`RayEnd`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReflectedHit {
    /// A ray that counts elsewhere: it meets a light, or goes below the surface.
    Nothing,
    /// The unseen part of the room.
    Unseen,
    /// A pixel of the photo, or, from the photo's number of pixels on, one of the objects.
    Pixel(usize),
    /// A position on the hidden sides of the room: the index of the cell, and the coordinates
    /// within it in 1/256 of its edges.
    Cell(usize, [u8; 2]),
}

/// The bit of cells.
const CELL: u32 = 1 << 31;

// No cell has the packed form of another end.
const _: () = assert!(6 * MAX_CELLS * MAX_CELLS < (1 << 15) - 1);

impl RayEnd {
    /// The packed form of [`ReflectedHit::Unseen`].
    pub const UNSEEN: RayEnd = RayEnd(u32::MAX);
    /// The packed form of [`ReflectedHit::Nothing`].
    pub const NOTHING: RayEnd = RayEnd(u32::MAX - 1);

    /// The packed form of [`ReflectedHit::Pixel`]; photos have fewer than 2^31 pixels.
    pub fn pixel(index: usize) -> RayEnd {
        RayEnd(index as u32)
    }

    /// The packed form of [`ReflectedHit::Cell`]; a layout has fewer than 2^15 - 1 cells.
    pub fn cell(index: usize, [u, v]: [u8; 2]) -> RayEnd {
        RayEnd(CELL | ((index as u32) << 16) | (u32::from(u) << 8) | u32::from(v))
    }

    /// The end of the ray.
    pub fn hit(self) -> ReflectedHit {
        match self {
            RayEnd::UNSEEN => ReflectedHit::Unseen,
            RayEnd::NOTHING => ReflectedHit::Nothing,
            RayEnd(index) if index < CELL => ReflectedHit::Pixel(index as usize),
            RayEnd(cell) => {
                let [v, u, ..] = cell.to_le_bytes();
                ReflectedHit::Cell(((cell & !CELL) >> 16) as usize, [u, v])
            }
        }
    }
}

impl Reflections {
    /// Whether all planes have their number of rows, and all cells that rays meet exist. The pixels
    /// that rays meet are held against the photo's size where they are used.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        rule(self.hits.size() == self.weight.size(), "a weight for each ray")?;
        rule(self.far.len() == self.hits.height(), "light from afar for each place")?;
        let mut lobes = self.lights.iter().flat_map(|(_, lobes)| lobes);
        rule(lobes.all(|lobe| lobe.len() == self.far.len()), "light of each lobe for each place")?;
        self.cells.check()?;
        let exists = |end: &RayEnd| match end.hit() {
            ReflectedHit::Cell(cell, _) => cell < self.cells.len(),
            _ => true,
        };
        rule(self.hits.pixels().iter().all(exists), "ends of rays on cells that exist")
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        let lights =
            self.lights.iter().flat_map(|(_, lobes)| lobes).map(Plane::bytes).sum::<usize>();
        self.hits.bytes() + self.weight.bytes() + self.far.bytes() + self.cells.bytes() + lights
    }
}

/// A surface point at which the reflection is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadingPoint {
    /// Slightly above the surface.
    pub point: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// The color in which a metal reflects.
    pub albedo: Vec3,
    /// Roughness, specular level, metallic.
    pub gloss: Gloss,
    /// Index of its plane in [`ReflectionScene::planes`], where it is part of the seen room.
    pub plane: Option<usize>,
    /// The ray differential, where the surface is curved within the pixel.
    pub differential: Option<RayDifferential>,
}

/// By how much the place and the normal of a shading point change from one side of its pixel to the
/// other: to the right, and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayDifferential {
    /// Position of the shading point in the pixel, 0..1 along each side.
    pub at: [f32; 2],
    pub point: [Vec3; 2],
    pub normal: [Vec3; 2],
}

impl ShadingPoint {
    /// The surface at a place of its pixel, 0..1 along each side; `None` where it reflects nothing.
    fn surface(&self, [u, v]: [f64; 2]) -> Option<Ggx> {
        let (mut point, mut normal) = (self.point, self.normal);
        if let Some(differential) = &self.differential {
            let (u, v) = (u as f32 - differential.at[0], v as f32 - differential.at[1]);
            point += u * differential.point[0] + v * differential.point[1];
            normal = (normal + u * differential.normal[0] + v * differential.normal[1])
                .normalize_or(normal);
        }
        Ggx::new(normal, -point.normalize_or(Vec3::NEG_Z), self.albedo, self.gloss)
    }
}

tuning! {
    /// Constants of traced reflections.
    pub const TUNING: ReflectTuning {
        /// Largest number of rays of a mirror that bends within a pixel: one ray would show a
        /// jagged boundary.
        mirror_rays: usize = 16,
            unit "rays", source Taste, effect "a larger value smooths reflections in curved mirrors and takes longer";
        /// Least number of samples of each lobe of a light.
        min_light_samples: usize = 8,
            unit "samples", source Taste,
            effect "a larger value lowers the noise of the reflections of lights and takes longer";
        /// Largest number of times that a ray may meet its own plane; one that meets it more often
        /// runs along it.
        max_skipped: usize = 16,
            unit "hits", source Taste, effect "a larger value follows more grazing rays";
        /// Least reflection of a light of unit radiance for which a shadow ray is traced.
        min_reflection: f32 = 1e-6,
            unit "radiance", source Taste, effect "a larger value drops faint reflections of lights";
        /// Largest number of rays of all pixels together.
        max_rays: usize = 4_000_000,
            unit "rays", source Measured("run time; no page records it"),
            effect "a smaller value gives large edited regions fewer rays per place";
        /// Distance of a light over that of the hit, up to which it counts as before the hit where
        /// the hit is a light's own pixel.
        own_slack: f32 = 1.2,
            unit "1", source Taste, effect "a larger value shows more lights whose depth is wrong";
        /// Distance of a light over that of the hit, up to which it counts as before any other hit.
        slack: f32 = 1.01,
            unit "1", source Taste, effect "a larger value shows more lights behind uneven surfaces";
        /// Least bandwidth by which the solid angle of a window's lobe is divided.
        min_bandwidth: f32 = 0.1,
            unit "1", source Taste, effect "none for windows smaller than a hemisphere";
        /// Expected number of hits above which the rays alone estimate a light, since the square
        /// would overflow.
        max_density: f32 = 1e6,
            unit "hits", source Derived("single precision"),
            effect "a smaller value drops samples of lights in mirrors";
        /// End of a shadow ray before the light that it samples.
        shadow_end: f32 = 0.999,
            unit "the ray's length", source Derived("single precision"),
            effect "a larger value may let a light shadow itself";
        /// Relative difference of depth up to which neighboring pixels of an object show one
        /// surface.
        same_depth: f32 = 0.05,
            unit "1", source Taste, effect "a larger value bends reflections across steps";
        /// Least cosine between the normals of neighboring pixels of one surface of an object.
        same_normal: f32 = 0.5,
            unit "1", source Taste, effect "a smaller value bends reflections across edges";
        /// Depth of a hit over that of the visible surface of the object, up to which the camera
        /// sees the hit.
        same_side: f32 = 1.02,
            unit "1", source Taste, effect "a larger value shows the front for hits behind it";
        /// Cosine between a direction and the normal of a cell of estimated lighting that must be
        /// exceeded.
        min_probe_cosine: f32 = 0.1,
            unit "1", source Taste, effect "a larger value asks cells farther away";
    }
}

/// The room around the places.
pub struct ReflectionScene<'a> {
    /// With the bodies in it.
    pub mesh: &'a SceneMesh,
    /// The bodies as they are seen.
    pub objects: &'a Objects,
    /// The camera of the photo.
    pub camera: &'a Camera,
    /// Points of the seen surface, working size.
    pub points: &'a Points,
    /// Unit normals of the seen surface, working size.
    pub normal: &'a Normal,
    /// Pixels of each visible light, working size: they show themselves, as lights.
    pub masks: &'a [&'a Mask],
    /// Incident radiance at each place, estimated by a network; it takes the place of `layout`.
    pub lighting: Option<&'a Lighting>,
    /// The cuboid of the room, whose cells are met where the seen room is not.
    pub layout: Option<&'a RoomLayout>,
    /// Working pixels of each plane that faces lie in: depth is uneven, and a plane does not
    /// occlude its own reflection.
    pub planes: &'a [Plane<bool>],
}

impl ReflectionScene<'_> {
    /// The nearest surface along a ray of unit length from a shading point.
    fn closest(&self, shading: &ShadingPoint, direction: Vec3) -> Option<Hit> {
        let plane = shading.plane.map(|plane| self.planes[plane].pixels());
        let mut way = 0.0;
        for _ in 0..TUNING.max_skipped {
            let hit = self.mesh.closest(shading.point + direction * way, direction)?;
            let distance = way + hit.distance;
            if !plane.and_then(|own| own.get(hit.pixel as usize)).is_some_and(|own| *own) {
                return Some(Hit { distance, ..hit });
            }
            way = distance + clearance(shading.point + direction * distance);
        }
        None
    }

    /// The cuboid of the room, where no network takes its place.
    fn cuboid(&self) -> Option<&RoomLayout> {
        self.layout.filter(|_| self.lighting.is_none())
    }

    /// The position on the hidden sides of the room at which a ray leaves it; `None` where there is
    /// no cell, or where it lies beyond `end`.
    fn cell(&self, point: Vec3, direction: Vec3, end: f32) -> Option<RayEnd> {
        let (distance, place) = self.cuboid()?.exit_place(point, direction)?;
        let (cell, within) = place.filter(|_| distance < end)?;
        Some(RayEnd::cell(cell, CellGrid::steps(within)))
    }
}

/// The stream of places within a pixel, beyond those of lights.
const WITHIN: u32 = u32::MAX;

/// Reflections of the places of a plane of this size, with `rays` per place and as many samples per
/// lobe of a light; and the number of rays that were traced.
pub fn reflections(
    (w, h): (usize, usize),
    shading: impl Fn(usize) -> Option<ShadingPoint> + Sync,
    scene: &ReflectionScene,
    lights: &[(&str, &Shape)],
    rays: usize,
    seed: u64,
) -> (Reflections, u64) {
    let tracer = Tracer {
        scene,
        lights: lights.iter().map(|(_, shape)| TracedLight::new(shape)).collect(),
        cells: LightProbeGrid::new(scene),
        rays: rays.min(TUNING.max_rays / (w * h).max(1)).max(1),
        seed,
    };
    let pixel = |i: usize| tracer.pixel(i, shading(i));
    let pixels: Vec<Pixel> = (0..w * h).into_par_iter().with_min_len(16).map(pixel).collect();
    let mut first = 0;
    let planes = lights.iter().zip(&tracer.lights).map(|((id, _), light)| {
        let range = first..first + light.emitter.lobes();
        first = range.end;
        let lobe = |lobe: usize| Plane::new(w, h, pixels.iter().map(|p| p.lights[lobe]).collect());
        (id.to_string(), range.map(lobe).collect())
    });
    let planes = planes.collect();
    let rays = tracer.rays;
    let reflections = Reflections {
        hits: Plane::new(
            rays,
            pixels.len(),
            pixels.iter().flat_map(|p| p.hits.iter().copied()).collect(),
        ),
        weight: Plane::new(
            rays,
            pixels.len(),
            pixels.iter().flat_map(|p| p.weight.iter().copied()).collect(),
        ),
        far: Plane::new(w, h, pixels.iter().map(|p| p.far).collect()),
        cells: scene.cuboid().map_or_else(CellGrid::default, RoomLayout::grid),
        lights: planes,
    };
    (reflections, pixels.iter().map(|p| p.traced).sum())
}

/// A light that reflected rays may meet and that is sampled.
struct TracedLight<'a> {
    shape: &'a Shape,
    emitter: Emitter,
    body: Silhouette<'a>,
}

impl TracedLight<'_> {
    fn new(shape: &Shape) -> TracedLight<'_> {
        TracedLight { shape, emitter: Emitter::new(shape), body: Silhouette::new(shape) }
    }
}

/// The reflections of one pixel at a time.
struct Tracer<'a> {
    scene: &'a ReflectionScene<'a>,
    lights: Vec<TracedLight<'a>>,
    cells: Option<LightProbeGrid<'a>>,
    /// Rays per pixel.
    rays: usize,
    seed: u64,
}

impl Tracer<'_> {
    fn pixel(&self, i: usize, shading: Option<ShadingPoint>) -> Pixel {
        let lobes: usize = self.lights.iter().map(|light| light.emitter.lobes()).sum();
        let mut out = Pixel {
            hits: vec![RayEnd::NOTHING; self.rays],
            weight: vec![Vec3::ZERO; self.rays],
            far: Vec3::ZERO,
            lights: vec![Vec3::ZERO; lobes],
            traced: 0,
        };
        let Some(shading) = shading else { return out };
        let Some(middle) = shading.surface([0.5; 2]) else { return out };
        let count = match (middle.is_mirror(), shading.differential) {
            (true, None) => 1,
            (true, Some(_)) => self.rays.min(TUNING.mirror_rays),
            (false, _) => self.rays,
        };
        // Each ray from a place of its own within the pixel; one that is turned away counts as the
        // middle.
        let surfaces: Vec<Ggx> = if shading.differential.is_some() {
            let within = Points2::new(self.seed, i as u32, WITHIN);
            (0..count).map(|ray| shading.surface(within.get(ray)).unwrap_or(middle)).collect()
        } else {
            vec![middle]
        };
        let points = Points2::new(self.seed, i as u32, 0);
        for ray in 0..count {
            let surface = &surfaces[ray % surfaces.len()];
            let Some((direction, weight)) = surface.sample(points.get(ray)) else { continue };
            self.trace(
                &mut out,
                ray,
                &shading,
                surface,
                (direction, weight * (1.0 / count as f32)),
            );
        }
        self.sample_lights(&mut out, i, &shading, &surfaces, count.max(TUNING.min_light_samples));
        out
    }

    fn is_own(&self, pixel: usize) -> bool {
        self.scene.masks.iter().any(|mask| mask.0.pixels()[pixel] > 0.5)
    }

    /// Follows one ray of a pixel, whose direction has `weight`.
    fn trace(
        &self,
        out: &mut Pixel,
        ray: usize,
        shading: &ShadingPoint,
        surface: &Ggx,
        (direction, weight): (Vec3, Vec3),
    ) {
        let point = shading.point;
        let hit = self.scene.closest(shading, direction);
        out.traced += 1;
        let in_room = |hit: &Hit| (hit.pixel as usize) < self.scene.points.0.len();
        let is_own = hit.is_some_and(|hit| in_room(&hit) && self.is_own(hit.pixel as usize));
        let end = hit.map_or(f32::INFINITY, |hit| {
            hit.distance * if is_own { TUNING.own_slack } else { TUNING.slack }
        });
        // Lights come first: they occlude surfaces behind them. A light without a closed surface
        // shows in a mirror as in the photo.
        let mut light_hit = is_own && !surface.is_mirror();
        let mut first = 0;
        for TracedLight { shape, emitter, body } in &self.lights {
            if body.intersect(point, direction).is_some_and(|t| t < end) {
                light_hit = true;
                for lobe in 0..emitter.lobes() {
                    let s = by_rays(shape, lobe, point, surface)(direction);
                    out.lights[first + lobe] += weight * shape.emission(lobe, direction) * s;
                }
            }
            first += emitter.lobes();
        }
        if light_hit {
            return;
        }
        out.weight[ray] = weight;
        let seen = hit.and_then(|hit| {
            pixel_of_hit(self.scene, (point + direction * hit.distance, direction), hit.pixel)
        });
        let end = hit.map_or(f32::INFINITY, |hit| hit.distance);
        let cell = || self.scene.cell(point, direction, end);
        out.hits[ray] = seen.or_else(cell).unwrap_or(RayEnd::UNSEEN);
        if out.hits[ray] == RayEnd::UNSEEN
            && let Some(cells) = &self.cells
        {
            out.far += weight * cells.radiance(point, direction);
        }
    }

    /// Adds the samples of each light, weighted against the rays by the power heuristic.
    fn sample_lights(
        &self,
        out: &mut Pixel,
        i: usize,
        shading: &ShadingPoint,
        surfaces: &[Ggx],
        samples: usize,
    ) {
        let point = shading.point;
        let mut first = 0;
        for (light, TracedLight { shape, emitter, .. }) in self.lights.iter().enumerate() {
            for lobe in 0..emitter.lobes() {
                let by_rays: Vec<_> =
                    surfaces.iter().map(|surface| by_rays(shape, lobe, point, surface)).collect();
                let Some(sampler) = emitter.sampler_at(lobe, point, shading.normal) else {
                    continue;
                };
                let points = Points2::new(self.seed, i as u32, 1 + (3 * light + lobe) as u32);
                let sampled = |k: usize| Some((k % surfaces.len(), sampler.sample(&points, k)?));
                for (k, sample) in (0..samples).filter_map(sampled) {
                    let direction = (sample.position - point).normalize_or_zero();
                    let part =
                        (1.0 - by_rays[k](direction)) * std::f32::consts::PI * sample.contribution;
                    let value = surfaces[k].value(direction) * part;
                    if value.max_element() < TUNING.min_reflection {
                        continue;
                    }
                    out.traced += 1;
                    if !blocked(self.scene, shading, sample.position, &|pixel| self.is_own(pixel)) {
                        out.lights[first + lobe] += value / samples as f32;
                    }
                }
            }
            first += emitter.lobes();
        }
    }
}

struct Pixel {
    hits: Vec<RayEnd>,
    weight: Vec<Vec3>,
    far: Vec3,
    lights: Vec<Vec3>,
    /// Number of rays.
    traced: u64,
}

/// By direction, the share that the rays of the lobe have in the estimate of a light's reflection.
fn by_rays<'a>(
    shape: &Shape,
    lobe: usize,
    point: Vec3,
    surface: &'a Ggx,
) -> impl Fn(Vec3) -> f32 + 'a {
    // Surfels have gaps, so that rays do not meet them.
    let surfels = matches!(shape, Shape::Lamp(crate::optics::Lamp::Surfels(_)));
    let ball = if surfels { None } else { shape.bounding_sphere() };
    let size = ball.map(|(center, radius)| {
        let size = std::f32::consts::PI * radius * radius
            / center.distance_squared(point).max(radius * radius);
        match shape {
            Shape::Window(window) => size.min(
                2.0 * std::f32::consts::PI / window.lobes[lobe].bandwidth.max(TUNING.min_bandwidth),
            ),
            _ => size,
        }
    });
    let all = surfels && surface.is_mirror();
    move |direction| {
        let Some(size) = size else { return if all { 1.0 } else { 0.0 } };
        let p = surface.density(direction) * size;
        // A sharp lobe's density does not fit into the square of a float.
        if p > TUNING.max_density { 1.0 } else { p * p / (p * p + 1.0) }
    }
}

/// Whether something stands between a place and a light that is not the light itself.
fn blocked(
    scene: &ReflectionScene,
    shading: &ShadingPoint,
    light: Vec3,
    own: &impl Fn(usize) -> bool,
) -> bool {
    let way = light - shading.point;
    let length = way.length();
    let hit = scene.closest(shading, way / length);
    let near = hit.filter(|hit| hit.distance < TUNING.shadow_end * length);
    near.is_some_and(|hit| (hit.pixel as usize) >= scene.points.0.len() || !own(hit.pixel as usize))
}

/// The shading point at pixel `i` of objects, where they cover it.
pub fn object_shading_point(objects: &Objects, camera: &Camera, i: usize) -> Option<ShadingPoint> {
    let (x, y) = (i % objects.coverage.width(), i / objects.coverage.width());
    if objects.coverage.get(x, y) <= 0.0 {
        return None;
    }
    let normal = objects.normal.get(x, y);
    let point = if objects.step == 1 {
        objects.points.get(x, y)
    } else {
        let z = objects.depth.get(x, y);
        // Half a pixel's footprint above the surface, which is flat between pixels here only.
        camera.pixel_point(objects.left + x, objects.top + y, z) + normal * (0.5 * z / camera.fx)
    };
    Some(ShadingPoint {
        point,
        normal,
        albedo: objects.albedo.get(x, y),
        gloss: objects.gloss.get(x, y),
        plane: None,
        differential: Some(differential(objects, camera, (x, y))),
    })
}

/// Derivatives of position and normal across a covered pixel: by the camera, and by the pixels
/// beside it that show the same surface.
fn differential(objects: &Objects, camera: &Camera, (x, y): (usize, usize)) -> RayDifferential {
    let (w, h) = objects.coverage.size();
    let (z, normal) = (objects.depth.get(x, y), objects.normal.get(x, y));
    let beside = |dx: isize, dy: isize| {
        let (x, y) = (
            x.checked_add_signed(dx).filter(|x| *x < w)?,
            y.checked_add_signed(dy).filter(|y| *y < h)?,
        );
        let other = objects.normal.get(x, y);
        let alike = objects.coverage.get(x, y) > 0.0
            && (objects.depth.get(x, y) - z).abs() < TUNING.same_depth * z
            && other.dot(normal) > TUNING.same_normal;
        alike.then_some(other)
    };
    let change = |dx: isize, dy: isize| match (beside(-dx, -dy), beside(dx, dy)) {
        (Some(before), Some(after)) => 0.5 * (after - before),
        (Some(before), None) => normal - before,
        (None, Some(after)) => after - normal,
        (None, None) => Vec3::ZERO,
    };
    // The ray that met it nearest to the middle of the pixel is seldom in the middle.
    let own = (objects.step == 1).then(|| camera.project(objects.points.get(x, y))).flatten();
    let at =
        own.map_or([0.5; 2], |p| [p.x - (objects.left + x) as f32, p.y - (objects.top + y) as f32]);
    let at = at.map(|at| at.clamp(0.0, 1.0));
    RayDifferential {
        at,
        point: [Vec3::X * (z / camera.fx), Vec3::NEG_Y * (z / camera.fy)],
        normal: [change(1, 0), change(0, 1)],
    }
}

/// The pixel that shows the point that a ray meets: of the photo, or after all of them of the
/// objects.
fn pixel_of_hit(
    scene: &ReflectionScene,
    (at, direction): (Vec3, Vec3),
    pixel: u32,
) -> Option<RayEnd> {
    let (camera, objects) = (scene.camera, scene.objects);
    let place = camera.project(at).filter(|p| camera.contains(*p))?;
    let (x, y) = (place.x as usize, place.y as usize);
    if let Some(normal) = scene.normal.0.pixels().get(pixel as usize) {
        // From behind, nobody has seen it.
        return (normal.dot(direction) < 0.0).then_some(RayEnd::pixel(y * camera.width + x));
    }
    let (u, v) = (x.checked_sub(objects.left)?, y.checked_sub(objects.top)?);
    let (w, h) = objects.coverage.size();
    // For a side that the camera does not see, the pixel of the side before it.
    let shown = u < w
        && v < h
        && objects.coverage.get(u, v) > 0.5
        && objects.depth.get(u, v) < TUNING.same_side * -at.z;
    shown.then(|| RayEnd::pixel(camera.width * camera.height + v * w + u))
}

/// A network's lighting, sampled at points in the room.
struct LightProbeGrid<'a> {
    lighting: &'a Lighting,
    /// Point and normal at the middle of each cell.
    places: Vec<(Vec3, Vec3)>,
}

impl LightProbeGrid<'_> {
    fn new<'a>(scene: &'a ReflectionScene) -> Option<LightProbeGrid<'a>> {
        let lighting = scene.lighting?;
        let (w, h) = scene.points.0.size();
        let middle =
            |i: usize, cells: usize, size: usize| ((2 * i + 1) * size / (2 * cells)).min(size - 1);
        let place = |i: usize| {
            let (x, y) = (
                middle(i % lighting.columns, lighting.columns, w),
                middle(i / lighting.columns, lighting.rows, h),
            );
            (scene.points.0.get(x, y), scene.normal.0.get(x, y))
        };
        Some(LightProbeGrid {
            lighting,
            places: (0..lighting.columns * lighting.rows).map(place).collect(),
        })
    }

    /// Incident radiance at `point` from `direction`: that of the nearest cell whose surface faces
    /// it.
    fn radiance(&self, point: Vec3, direction: Vec3) -> Vec3 {
        let sees =
            |(_, (_, n)): &(usize, &(Vec3, Vec3))| n.dot(direction) > TUNING.min_probe_cosine;
        let near = self.places.iter().enumerate().filter(sees);
        let near = near
            .min_by(|a, b| a.1.0.distance_squared(point).total_cmp(&b.1.0.distance_squared(point)));
        let Some((i, (_, normal))) = near else { return Vec3::ZERO };
        let way = local_frame(*normal).transpose() * direction;
        self.lighting
            .radiance(i % self.lighting.columns, i / self.lighting.columns, way)
            .max(Vec3::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Quat};

    use super::*;
    use crate::geometry::{Bodies, Body, Drawing, Material, Model, SideSource, draw};
    use crate::image::Depth;
    use crate::optics::{Around, Lamp, Mirror, MirroredLight, SphereLamp};

    const SIZE: (usize, usize) = (80, 60);

    /// A ball of this roughness, of white metal, before a wall at 4 m; with its reflection under a
    /// lamp.
    fn ball(roughness: f32, lamp: Shape) -> (Objects, Reflections) {
        seen_ball(SIZE, roughness, lamp, true)
    }

    /// The same in a picture of this size; each pixel with its differential or without.
    fn seen_ball(
        size: (usize, usize),
        roughness: f32,
        lamp: Shape,
        curved: bool,
    ) -> (Objects, Reflections) {
        let (objects, reflected, _) = ball_in_room(size, roughness, lamp, curved, None);
        (objects, reflected)
    }

    /// The same in a cuboid with these corners, if any.
    fn ball_in_room(
        size: (usize, usize),
        roughness: f32,
        lamp: Shape,
        curved: bool,
        cuboid: Option<(Vec3, Vec3)>,
    ) -> (Objects, Reflections, Option<RoomLayout>) {
        let camera = Camera::from_fov_x(size.0, size.1, 60.0);
        let points = Points(Plane::from_fn(size.0, size.1, |x, y| camera.pixel_point(x, y, 4.0)));
        let normal = Normal(Plane::filled(size.0, size.1, Vec3::Z));
        let material = Material { albedo: Vec3::ONE, roughness, specular: 0.5, metallic: 1.0 };
        let center = Vec3::new(0.0, 0.0, -2.0);
        let bodies = [Body::placed(
            Model::sphere(),
            Some(material),
            Mat3::IDENTITY,
            0.5,
            Vec3::ZERO,
            center,
        )];
        let (solid, materials) = Bodies::new(&bodies, 100);
        let depth = Depth(Plane::filled(size.0, size.1, 4.0));
        let drawing = Drawing { supersampling: 2, most: 100_000 };
        let objects = draw(&bodies, (&solid, &materials), &camera, &depth, |_| 0.0, drawing);
        let mesh = SceneMesh::new(&points, camera.fx, 0.0, &Plane::filled(size.0, size.1, false))
            .with_bodies(solid);
        let layout = cuboid.map(|(low, high)| {
            let seen = Plane::filled(size.0, size.1, 0);
            let sides = [SideSource::Guessed; 6];
            RoomLayout::new((Quat::IDENTITY, low, high), sides, (&camera, &points), seen, 8)
        });
        let scene = ReflectionScene {
            mesh: &mesh,
            objects: &objects,
            camera: &camera,
            points: &points,
            normal: &normal,
            masks: &[],
            lighting: None,
            layout: layout.as_ref(),
            planes: &[],
        };
        let shading = |i: usize| {
            let shading = object_shading_point(&objects, &camera, i)?;
            Some(ShadingPoint { differential: shading.differential.filter(|_| curved), ..shading })
        };
        let (reflected, _) =
            reflections(objects.coverage.size(), shading, &scene, &[("lamp", &lamp)], 64, 1);
        (objects, reflected, layout)
    }

    /// Radiance of the pixel at the center of the ball where the room has the radiance `room` and
    /// the lamp this one.
    fn middle((objects, of): &(Objects, Reflections), room: Vec3, radiance: f32) -> Vec3 {
        let planes = [vec![room; SIZE.0 * SIZE.1], vec![Vec3::ZERO; SIZE.0 * SIZE.1]];
        let all: Vec<usize> = (0..SIZE.0 * SIZE.1).collect();
        let weights = [Vec3::splat(radiance)];
        let lamp = MirroredLight { id: "lamp", radiance: &weights, cells: &[] };
        let mirror =
            Mirror::new(of, Around::new(&planes, &all, 1.0), &[lamp]).expect("the lamp is there");
        let (w, h) = objects.coverage.size();
        mirror.shows(h / 2 * w + w / 2, 0, &planes[0], |_| Vec3::ZERO)
    }

    #[test]
    fn a_white_mirror_in_an_even_room_shows_the_room() {
        for roughness in [0.0, 0.3] {
            let shown = middle(&ball(roughness, Shape::Absent), Vec3::new(0.5, 0.2, 0.1), 1.0);
            assert!(
                (shown / Vec3::new(0.5, 0.2, 0.1) - 1.0).abs().max_element() < 0.03,
                "{roughness}: {shown}"
            );
        }
    }

    #[test]
    fn a_lamp_behind_the_camera_is_seen_in_a_mirror_and_blurred_in_a_rough_ball() {
        let lamp = |radius: f32| {
            Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(0.0, 0.0, 2.0), radius }))
        };
        let mirror = middle(&ball(0.0, lamp(0.8)), Vec3::ZERO, 7.0);
        assert!((mirror - 7.0).abs().max_element() < 0.2, "{mirror}");
        // Head on: f = D(1) F G / 4 with D(1) = 1 / (pi a^2), G = F = 1, times the irradiance L
        // (r / d)^2 pi.
        let alpha = 0.6f32 * 0.6;
        let want = 7.0 * (0.1f32 / 3.5).powi(2) / (4.0 * alpha * alpha);
        let rough = middle(&ball(0.6, lamp(0.1)), Vec3::ZERO, 7.0);
        assert!((rough / want - 1.0).abs().max_element() < 0.1, "{rough} against {want}");
    }

    /// Lamps in a mirror ball of 20 pixels, against a picture of eight times the size with one ray
    /// to a pixel, pixels inside the ball.
    #[test]
    fn a_mirror_ball_is_smooth() {
        let lamp = || {
            Shape::Lamp(Lamp::Sphere(SphereLamp { center: Vec3::new(3.0, 2.0, -1.0), radius: 0.7 }))
        };
        let fine = seen_ball((8 * SIZE.0, 8 * SIZE.1), 0.0, lamp(), false);
        let shown = |(objects, of): &(Objects, Reflections), x: usize, y: usize| {
            let at = |v: usize, first: usize| v.checked_sub(first);
            let (u, v) = (at(x, objects.left)?, at(y, objects.top)?);
            let (w, h) = objects.coverage.size();
            let inside = u < w && v < h && objects.coverage.get(u, v) >= 1.0;
            inside.then(|| of.lights[0].1[0].get(u, v).x)
        };
        let error = |curved: bool| {
            let ball = seen_ball(SIZE, 0.0, lamp(), curved);
            let (mut off, mut all) = (0.0, 0.0);
            for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
                let within = (0..64).map(|i| shown(&fine, 8 * x + i % 8, 8 * y + i / 8));
                let Some((got, wanted)) = shown(&ball, x, y).zip(within.sum::<Option<f32>>())
                else {
                    continue;
                };
                off += (got - wanted / 64.0).abs();
                all += wanted / 64.0;
            }
            assert!(all > 2.0, "the lamp is seen in the ball: {all}");
            off / all
        };
        let [jagged, smooth] = [false, true].map(error);
        assert!(
            smooth < 0.5 * jagged && smooth < 0.15,
            "{smooth} of the lamp's light is off, {jagged} with one ray"
        );
    }

    #[test]
    fn each_end_of_a_ray_is_unpacked_as_it_was_packed() {
        let last = 6 * MAX_CELLS * MAX_CELLS - 1;
        for (cell, at) in [(0, [0, 0]), (383, [7, 200]), (last, [255, 255]), (last, [255, 254])] {
            assert_eq!(RayEnd::cell(cell, at).hit(), ReflectedHit::Cell(cell, at));
        }
        for pixel in [0, 640 * 480, (1 << 31) - 1] {
            assert_eq!(RayEnd::pixel(pixel).hit(), ReflectedHit::Pixel(pixel));
        }
        assert_eq!(RayEnd::UNSEEN.hit(), ReflectedHit::Unseen);
        assert_eq!(RayEnd::NOTHING.hit(), ReflectedHit::Nothing);
    }

    /// The corners of a room around the camera and a ball at 2 m, whose front side is behind the
    /// wall at 4 m.
    const CUBOID: (Vec3, Vec3) = (Vec3::new(-3.0, -2.0, -4.2), Vec3::new(2.6, 1.8, 2.0));

    /// Radiance of the sides of the cuboid, linear in the position.
    fn of_side(at: Vec3) -> Vec3 {
        Vec3::new(5.0 + at.x, 5.0 + at.y, 5.0 + at.z)
    }

    /// A mirror shows each light's own radiance of the side that its ray meets: the slabs in closed
    /// form, linear between the middles of the cells, so exact up to 1/256 of a cell.
    #[test]
    fn a_mirror_ball_shows_the_light_of_each_layer_on_the_hidden_sides() {
        let (objects, of, layout) = ball_in_room(SIZE, 0.0, Shape::Absent, false, Some(CUBOID));
        let (layout, camera) =
            (layout.expect("a cuboid"), Camera::from_fov_x(SIZE.0, SIZE.1, 60.0));
        assert_eq!((of.check(), of.cells.len()), (Ok(()), 384));
        let cells: Vec<Vec3> = layout.cells().iter().map(|cell| of_side(cell.center)).collect();
        let other: Vec<Vec3> = cells.iter().map(|cell| Vec3::splat(20.0) - *cell).collect();
        let of = Reflections {
            lights: vec![("a".to_string(), vec![]), ("b".to_string(), vec![])],
            ..of
        };
        let planes = vec![vec![Vec3::splat(0.5); SIZE.0 * SIZE.1]; 3];
        let lights = [("a", &cells), ("b", &other)];
        let lights = lights.map(|(id, cells)| MirroredLight { id, radiance: &[], cells });
        let around = Around::new(&planes, &[0], 0.5);
        let mirror = Mirror::new(&of, around, &lights).expect("both lights are there");
        let (low, high) = CUBOID;
        let cell = (high - low) / 8.0;
        let (mut met, mut worst) = ([0; 6], 0.0f32);
        for i in (0..objects.coverage.len()).filter(|&i| objects.coverage.pixels()[i] == 1.0) {
            let Some(ReflectedHit::Cell(index, _)) =
                of.hits.pixels()[i * of.hits.width()..].first().map(|end| end.hit())
            else {
                continue;
            };
            let shading = object_shading_point(&objects, &camera, i).expect("it is covered");
            let view = shading.point.normalize();
            let direction = view - 2.0 * view.dot(shading.normal) * shading.normal;
            let ends = Vec3::select(direction.cmpgt(Vec3::ZERO), high, low);
            let distance = ((ends - shading.point) / direction).min_element();
            let at = shading.point + distance * direction;
            // Beyond the outermost middles the radiance is level.
            let side = usize::from(layout.cells()[index].side);
            let mut level = at.clamp(low + 0.5 * cell, high - 0.5 * cell);
            level[side / 2] = at[side / 2];
            let weight = of.weight.pixels()[i * of.hits.width()];
            let shown =
                [0, 1, 2].map(|layer| mirror.shows(i, layer, &planes[0], |_| Vec3::ZERO) / weight);
            worst = worst.max((shown[0] - of_side(level)).abs().max_element());
            let both = shown[0] + shown[1];
            assert!((both / 20.0 - 1.0).abs().max_element() < 1e-4, "{both} by both lights");
            assert!((shown[2] / 0.25 - 1.0).abs().max_element() < 1e-4, "{} by none", shown[2]);
            met[side] += 1;
        }
        // The front side is seen, and the ball hides the middle of it.
        assert!(met[..4].iter().all(|&met| met > 20) && met[5] > 20, "{met:?} rays by side");
        assert!(worst < 0.01, "{worst} off");
    }

    #[test]
    fn another_number_of_cells_is_an_error_and_a_wrong_cell_does_not_pass_the_check() {
        let (_, mut of, _) = ball_in_room(SIZE, 0.0, Shape::Absent, false, Some(CUBOID));
        let planes = vec![vec![Vec3::ONE; SIZE.0 * SIZE.1]; 2];
        let lamp = MirroredLight { id: "lamp", radiance: &[], cells: &[Vec3::ONE; 3] };
        let message = Mirror::new(&of, Around::new(&planes, &[0], 0.5), &[lamp]).err();
        let wanted = format!(
            "light \"lamp\" lights 3 cells of the room, wanted {} as reflected",
            of.cells.len()
        );
        assert_eq!(message, Some(wanted));
        of.hits.pixels_mut()[5] = RayEnd::cell(of.cells.len(), [0, 0]);
        let message = of.check().expect_err("the cell does not exist");
        assert!(message.contains("ends of rays on cells that exist"), "{message}");
    }
}
