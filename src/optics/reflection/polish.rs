//! Specular edits: a new finish on part of the photo replaces the reflections of the old one.
//!
//! The photo holds the reflection of the surface as it was. So a layer L of a pixel of which a
//! share s has a new finish becomes `L + s (R - R0)`, and no less than zero, with R the reflection
//! of the edited room in the new finish and R0 that of the room without inserted bodies in the old
//! one. R0 is zero for an inserted or moved light, which the photo does not show.
//!
//! A lobe wider than a working pixel is known at working pixels, or every second one, and brought
//! to the photo's along its edges; a narrower one at photo pixels. Depth from photos is uneven, and
//! a mirror along it would break the picture, so pixels in a plane are treated as flat.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, PlaneFit, SceneMesh};
use crate::image::{
    DEPTH_PLANE, Depth, Gloss, Normal, Picture, Plane, Points, SpecularEdit, Upsampler, neighbors,
    resize, resize_depth, rule,
};
use crate::optics::{Mirror, Reflections, ShadingPoint};
use crate::tuning::tuning;

/// The change of a photo by new specular parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecularChange(pub Vec<SpecularPart>);

/// Reflections of one kind: of the new finish or the old, known at pixels of one size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecularPart {
    /// Whether it is taken away.
    pub old: bool,
    /// Part of each photo pixel.
    pub share: Plane<f32>,
    /// The row of `of` that each pixel of the part's own size has, or [`NO_ROW`].
    pub rows: Plane<u32>,
    /// Reflections, one row per place.
    pub of: Reflections,
}

/// The row of a pixel without a reflection.
pub const NO_ROW: u32 = u32::MAX;

impl SpecularChange {
    /// Whether every row that is named is there.
    ///
    /// # Errors
    /// The rule that is not kept.
    pub fn check(&self) -> Result<(), String> {
        self.0.iter().try_for_each(|part| {
            let count = part.of.hits.height();
            let known = |&row: &u32| row == NO_ROW || (row as usize) < count;
            rule(part.rows.pixels().iter().all(known), "reflections that are there")?;
            part.of.check()
        })
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.0.iter().map(|part| part.share.bytes() + part.rows.bytes() + part.of.bytes()).sum()
    }
}

impl SpecularPart {
    /// The weights with which a photo's pixels take those of the part, which have this photo and
    /// depth.
    pub fn reduced(&self, photo: &Picture, depth: &Depth) -> (Picture, Depth) {
        let (w, h) = self.rows.size();
        (Picture(resize(&photo.0, w, h)), resize_depth(depth, w, h))
    }

    /// Radiance that the part adds to each photo pixel of a `layer`, whose room is `plane` and
    /// whose bodies are `object`. Nothing to the layer of a light that an old finish had no
    /// reflection of.
    pub fn adds(
        &self,
        mirror: &Mirror,
        upsampler: &Upsampler,
        layer: usize,
        plane: &[Vec3],
        object: impl Fn(usize) -> Vec3 + Sync,
    ) -> Vec<(u32, Vec3)> {
        if self.old && self.of.lights.get(layer).is_some_and(|(_, lobes)| lobes.is_empty()) {
            return Vec::new();
        }
        let count = self.of.hits.height();
        let shown: Vec<Vec3> = (0..count)
            .into_par_iter()
            .with_min_len(256)
            .map(|row| mirror.shows(row, layer, plane, &object))
            .collect();
        let sign = if self.old { -1.0 } else { 1.0 };
        let width = self.share.width();
        let pixel = |(i, &share): (usize, &f32)| {
            if share <= 0.0 {
                return None;
            }
            let taps = upsampler.taps(i % width, i / width);
            let rows = taps
                .iter()
                .map(|(at, weight)| (self.rows.pixels()[at], weight))
                .filter(|tap| tap.0 != NO_ROW);
            let (sum, all) = rows.fold((Vec3::ZERO, 0.0), |(sum, all), (row, weight)| {
                (sum + shown[row as usize] * weight, all + weight)
            });
            (all > 0.0).then(|| (i as u32, sum * (sign * share / all)))
        };
        self.share.pixels().par_iter().enumerate().with_min_len(1024).filter_map(pixel).collect()
    }
}

/// The seen room, at the photo's size and at working size.
pub struct SeenSurface<'a> {
    /// The camera of the photo.
    pub camera: &'a Camera,
    /// Planar z at the photo's size.
    pub full_depth: &'a Depth,
    /// Working size.
    pub points: &'a Points,
    /// Unit normals of the seen surface, working size.
    pub normal: &'a Normal,
    /// The seen surface as a mesh.
    pub mesh: &'a SceneMesh,
}

/// The places of one part, and which photo and part pixels take them.
pub struct ReflectingPoints {
    /// Whether the reflections of these places are taken away.
    pub old: bool,
    /// Part of each photo pixel, 0..=1.
    pub share: Plane<f32>,
    /// Index into `points` of each part pixel, or [`NO_ROW`].
    pub rows: Plane<u32>,
    /// The places.
    pub points: Vec<ShadingPoint>,
}

tuning! {
    /// Constants of the places at which the reflections of an edited finish are computed.
    pub const TUNING: PolishTuning {
        /// Largest number of places at which narrow lobes are computed; with more photo pixels, one
        /// stands for several.
        max_narrow: usize = 1_000_000,
            unit "places", source Measured("run time; no page records it"),
            effect "a smaller value blurs mirrors in large photos";
        /// Roughness squared from which every second working pixel suffices.
        half_pitch: f32 = 24.0,
            unit "working pixels, as an angle", source Taste,
            effect "a larger value computes broad lobes at more places";
        /// Roughness squared from which every working pixel suffices.
        working_pitch: f32 = 2.5,
            unit "working pixels, as an angle", source Taste,
            effect "a larger value computes lobes at the size of the photo more often";
        /// Largest distance of a pixel from its plane.
        off_plane: f32 = 0.03,
            unit "fraction of the distance from the camera", source Taste,
            effect "a larger value makes uneven surfaces flat";
        /// Least cosine between a normal and that of its plane.
        along: f32 = 0.85,
            unit "1", source Taste, effect "a larger value leaves more pixels outside of planes";
        /// Largest number of planes of a region.
        max_planes: usize = 4,
            unit "planes", source Taste, effect "a larger value makes more of a region flat";
        /// Largest number of pixels through which a plane is fitted; of more, every nth is taken.
        max_points: usize = 1500,
            unit "pixels", source Measured("run time; no page records it"),
            effect "a larger value is slower and more exact";
        /// Least fraction of the remaining region that makes another plane.
        min_support: f32 = 0.3,
            unit "1", source Taste, effect "a smaller value makes more planes";
        /// Least number of pixels that make another plane.
        min_pixels: usize = 30,
            unit "working pixels", source Taste, effect "a smaller value makes more planes";
        /// Fraction of a region outside of its planes up to which these pixels count as noise.
        uneven: f32 = 0.1,
            unit "1", source Taste, effect "a larger value makes more of a region flat";
        /// Radius around a pixel without a plane within which normals are averaged.
        reach: usize = 3,
            unit "working pixels", source Taste, effect "a larger value smooths reflections in curved surfaces";
    }
}

/// The places at which the reflections of a finish are computed, and the working pixels of the
/// planes that they lie in.
pub fn places(
    finish: &SpecularEdit,
    seen: &SeenSurface,
) -> (Vec<ReflectingPoints>, Vec<Plane<bool>>) {
    let (full, small) = (finish.share.size(), seen.points.0.size());
    if finish.share.is_empty() {
        return (Vec::new(), Vec::new());
    }
    let parts: Vec<(RequestedKind, (usize, usize))> = [false, true]
        .into_iter()
        .flat_map(|old| [Pitch::Photo, Pitch::Working, Pitch::Half].map(|pitch| (old, pitch)))
        .filter_map(|(old, pitch)| {
            let wanted =
                RequestedKind::new(finish, old, |gloss| Pitch::of(gloss[0], seen, full) == pitch)?;
            let step = (1..)
                .find(|step| wanted.count.div_ceil(step * step) <= TUNING.max_narrow)
                .unwrap_or(1);
            let size = match pitch {
                Pitch::Photo => {
                    (full.0.div_ceil(step).max(small.0), full.1.div_ceil(step).max(small.1))
                }
                Pitch::Working => small,
                Pitch::Half => (small.0.div_ceil(2), small.1.div_ceil(2)),
            };
            Some((wanted, size))
        })
        .collect();
    let mut region = Plane::filled(small.0, small.1, false);
    for (wanted, (w, h)) in &parts {
        for i in (0..wanted.share.len()).filter(|&i| wanted.share.pixels()[i] > 0.0) {
            let taken = neighbors((i % full.0, i / full.0), full, (*w, *h));
            taken.for_each(|(x, y)| region.set(x * small.0 / w, y * small.1 / h, true));
        }
    }
    let flat = Flat::new(&region, seen);
    (parts.into_iter().map(|(wanted, size)| wanted.places(size, seen, &flat)).collect(), flat.own)
}

/// Distance between the pixels at which reflections are known.
#[derive(Clone, Copy, PartialEq)]
enum Pitch {
    Photo,
    Working,
    /// Every second working pixel.
    Half,
}

impl Pitch {
    /// The coarsest sampling that resolves a lobe. Half vectors spread by about a = roughness^2
    /// radians, and on a surface seen at a slant that a light is near to they turn by some three
    /// pixels a pixel.
    fn of(roughness: f32, seen: &SeenSurface, full: (usize, usize)) -> Pitch {
        let (w, h) = seen.points.0.size();
        let pixel = full.0 as f32 / (w as f32 * seen.camera.fx);
        match roughness * roughness {
            a if a >= TUNING.half_pitch * pixel => Pitch::Half,
            a if a >= TUNING.working_pitch * pixel || full == (w, h) => Pitch::Working,
            _ => Pitch::Photo,
        }
    }
}

/// One kind of reflection at the photo's pixels.
struct RequestedKind {
    old: bool,
    share: Plane<f32>,
    gloss: Plane<[f32; 2]>,
    count: usize,
}

impl RequestedKind {
    /// The photo pixels whose specular parameters change and whose gloss, old or new, is `chosen`;
    /// `None` without any.
    fn new(
        finish: &SpecularEdit,
        old: bool,
        chosen: impl Fn([f32; 2]) -> bool,
    ) -> Option<RequestedKind> {
        let (w, h) = finish.share.size();
        let gloss =
            Plane::from_fn(
                w,
                h,
                |x, y| if old { finish.before(x, y) } else { finish.gloss.get(x, y) },
            );
        let share = Plane::from_fn(w, h, |x, y| {
            if finish.changes(x, y) && chosen(gloss.get(x, y)) {
                finish.share.get(x, y)
            } else {
                0.0
            }
        });
        let count = share.pixels().iter().filter(|&&share| share > 0.0).count();
        (count > 0).then_some(RequestedKind { old, share, gloss, count })
    }

    /// The places, at pixels of a plane of this size.
    fn places(self, (w, h): (usize, usize), seen: &SeenSurface, flat: &Flat) -> ReflectingPoints {
        let full = self.share.size();
        let mut sums = vec![([0.0f32; 2], 0.0f32); w * h];
        for i in (0..self.share.len()).filter(|&i| self.share.pixels()[i] > 0.0) {
            let (share, gloss) = (self.share.pixels()[i], self.gloss.pixels()[i]);
            for (x, y) in neighbors((i % full.0, i / full.0), full, (w, h)) {
                let (sum, all) = &mut sums[y * w + x];
                sum.iter_mut().zip(gloss).for_each(|(sum, value)| *sum += share * value);
                *all += share;
            }
        }
        let camera = seen.camera.resized(w, h);
        let depth = (self.share.size() == (w, h)).then(|| seen.full_depth.clone());
        let depth = depth.unwrap_or_else(|| resize_depth(seen.full_depth, w, h));
        let (mut rows, mut points) = (Plane::filled(w, h, NO_ROW), Vec::new());
        for (i, (sum, all)) in sums.into_iter().enumerate().filter(|(_, (_, all))| *all > 0.0) {
            let at = (i % w, i / w);
            let seen_at = camera.pixel_point(at.0, at.1, depth.0.pixels()[i]);
            rows.pixels_mut()[i] = points.len() as u32;
            let gloss = Gloss { roughness: sum[0] / all, specular: sum[1] / all, metallic: 0.0 };
            points.push(flat.shading_point((at, (w, h)), seen_at, gloss, seen));
        }
        ReflectingPoints { old: self.old, share: self.share, rows, points }
    }
}

/// Pixels that share no triangle with others: a crease hides its reflections.
fn inner(own: &Plane<bool>, points: &Points) -> Plane<bool> {
    let (w, h) = own.size();
    Plane::from_fn(w, h, |x, y| {
        let joined = |u: usize, v: usize| {
            (points.0.get(u, v).z / points.0.get(x, y).z - 1.0).abs() < DEPTH_PLANE.step
        };
        let mut around = (y.saturating_sub(1)..(y + 2).min(h))
            .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(w)).map(move |u| (u, v)));
        own.get(x, y) && around.all(|(u, v)| own.get(u, v) || !joined(u, v))
    })
}

/// The planes of a region.
struct Flat {
    planes: Vec<PlaneFit>,
    /// Which of them a working pixel lies in.
    label: Plane<Option<u8>>,
    /// The working pixels of the whole room that lie in each.
    own: Vec<Plane<bool>>,
    /// Normals of pixels outside all planes, smoothed.
    normal: Plane<Vec3>,
}

impl Flat {
    fn new(region: &Plane<bool>, seen: &SeenSurface) -> Flat {
        let (w, h) = region.size();
        let (points, normals) = (seen.points.0.pixels(), seen.normal.0.pixels());
        let lies_in = |plane: &PlaneFit, i: usize| {
            plane.contains(points[i], TUNING.off_plane)
                && plane.normal.dot(normals[i]) > TUNING.along
        };
        let mut left: Vec<usize> = (0..w * h).filter(|&i| region.pixels()[i]).collect();
        let mut flat = Flat {
            planes: Vec::new(),
            label: Plane::filled(w, h, None),
            own: Vec::new(),
            normal: Plane::filled(w, h, Vec3::Z),
        };
        while flat.planes.len() < TUNING.max_planes {
            let plane =
                PlaneFit::of_pixels(&left, (points, normals), TUNING.max_points, TUNING.off_plane);
            let Some(plane) = plane.filter(|p| p.support > TUNING.min_support) else {
                break;
            };
            let (own, others): (Vec<usize>, Vec<usize>) =
                left.iter().partition(|&&i| lies_in(&plane, i));
            if own.len() < TUNING.min_pixels {
                break;
            }
            own.iter().for_each(|&i| flat.label.pixels_mut()[i] = Some(flat.planes.len() as u8));
            flat.own.push(inner(
                &Plane::new(w, h, (0..w * h).map(|i| lies_in(&plane, i)).collect()),
                seen.points,
            ));
            flat.planes.push(plane);
            left = others;
        }
        let size = region.pixels().iter().filter(|inside| **inside).count();
        if !flat.planes.is_empty() && left.len() as f32 <= TUNING.uneven * size as f32 {
            let off = |plane: &PlaneFit, i: usize| plane.distance(points[i]);
            for i in left.drain(..) {
                let nearest = (0..flat.planes.len())
                    .min_by(|&a, &b| off(&flat.planes[a], i).total_cmp(&off(&flat.planes[b], i)));
                flat.label.pixels_mut()[i] = nearest.map(|plane| plane as u8);
            }
        }
        for i in left {
            let (x, y) = (i % w, i / w);
            let around =
                (y.saturating_sub(TUNING.reach)..(y + TUNING.reach + 1).min(h)).flat_map(|y| {
                    (x.saturating_sub(TUNING.reach)..(x + TUNING.reach + 1).min(w))
                        .map(move |x| y * w + x)
                });
            let alike = around.filter(|&j| {
                region.pixels()[j] && (points[j].z / points[i].z - 1.0).abs() < TUNING.off_plane
            });
            flat.normal.pixels_mut()[i] =
                alike.map(|j| normals[j]).sum::<Vec3>().normalize_or(normals[i]);
        }
        flat
    }

    /// The shading point at pixel `at` of a plane of this size, of a surface seen at `point`.
    fn shading_point(
        &self,
        (at, size): ((usize, usize), (usize, usize)),
        point: Vec3,
        gloss: Gloss,
        seen: &SeenSurface,
    ) -> ShadingPoint {
        let (w, h) = self.label.size();
        let i = (at.1 * h / size.1) * w + at.0 * w / size.0;
        let label = self.label.pixels()[i].map(usize::from);
        let on_plane = label.and_then(|label| Some((label, self.planes[label].intersect(point)?)));
        match on_plane {
            Some((label, point)) => ShadingPoint {
                point,
                normal: self.planes[label].normal,
                albedo: Vec3::ZERO,
                gloss,
                plane: Some(label),
                differential: None,
            },
            None => {
                let normal = self.normal.pixels()[i];
                let point = point + normal * seen.mesh.offset(point);
                ShadingPoint {
                    point,
                    normal,
                    albedo: Vec3::ZERO,
                    gloss,
                    plane: None,
                    differential: None,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Objects;
    use crate::image::Roughness;
    use crate::optics::{
        Around, Ggx, Lamp, MirroredLight, ReflectionScene, Shape, SphereLamp, reflections,
    };

    const SIZE: (usize, usize) = (80, 60);
    const FLOOR: f32 = -1.0;
    const WALL: f32 = -4.0;

    /// A floor and a wall, whose depth is wrong by up to this share.
    struct MirrorRoom {
        camera: Camera,
        depth: Depth,
        points: Points,
        normal: Normal,
        mesh: SceneMesh,
    }

    fn room(error: f32) -> MirrorRoom {
        let camera = Camera::from_fov_x(SIZE.0, SIZE.1, 60.0);
        let ray = |x, y| camera.pixel_point(x, y, 1.0);
        let is_floor = |x, y| ray(x, y).y * -WALL < FLOOR;
        let wrong = |x: usize, y: usize| {
            1.0 + error * (((x * 7919 + y * 104_729) % 1009) as f32 / 504.0 - 1.0)
        };
        let z = |x, y| wrong(x, y) * if is_floor(x, y) { FLOOR / ray(x, y).y } else { -WALL };
        let depth = Depth(Plane::from_fn(SIZE.0, SIZE.1, z));
        let points =
            Points(Plane::from_fn(SIZE.0, SIZE.1, |x, y| camera.pixel_point(x, y, z(x, y))));
        let tilt = |x: usize, y: usize| {
            error * Vec3::new((x % 3) as f32 - 1.0, 0.0, (y % 3) as f32 - 1.0) * 10.0
        };
        let flat = |x, y| if is_floor(x, y) { Vec3::Y } else { Vec3::Z };
        let normal =
            Normal(Plane::from_fn(SIZE.0, SIZE.1, |x, y| (flat(x, y) + tilt(x, y)).normalize()));
        let mesh = SceneMesh::new(&points, camera.fx, 0.0, &Plane::filled(SIZE.0, SIZE.1, false));
        MirrorRoom { camera, depth, points, normal, mesh }
    }

    impl MirrorRoom {
        fn is_floor(&self, i: usize) -> bool {
            self.normal.0.pixels()[i].y > 0.5
        }

        /// Radiance that the floor adds to a layer whose room is `plane`, by photo pixel, with its
        /// roughness changed from `old` to `new`.
        fn adds(
            &self,
            [old, new]: [f32; 2],
            lamp: Shape,
            radiance: f32,
            plane: &[Vec3],
        ) -> Vec<Vec3> {
            let floor = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                f32::from(u8::from(self.is_floor(y * SIZE.0 + x)))
            });
            let mut finish = SpecularEdit::default();
            finish.lay(&floor, [Some(new), None], &Roughness(Plane::filled(SIZE.0, SIZE.1, old)));
            let seen = SeenSurface {
                camera: &self.camera,
                full_depth: &self.depth,
                points: &self.points,
                normal: &self.normal,
                mesh: &self.mesh,
            };
            let (kinds, planes) = places(&finish, &seen);
            let nobody = Objects::unseen(&[]);
            let scene = ReflectionScene {
                mesh: &self.mesh,
                objects: &nobody,
                camera: &self.camera,
                points: &self.points,
                normal: &self.normal,
                masks: &[],
                lighting: None,
                layout: None,
                planes: &planes,
            };
            let photo = Picture(Plane::filled(SIZE.0, SIZE.1, Vec3::ONE));
            let mut sums = vec![Vec3::ZERO; plane.len()];
            for kind in kinds {
                let shading = |i: usize| Some(kind.points[i]);
                let (of, _) =
                    reflections((kind.points.len(), 1), shading, &scene, &[("lamp", &lamp)], 64, 1);
                let part = SpecularPart { old: kind.old, share: kind.share, rows: kind.rows, of };
                let weights = [Vec3::splat(radiance)];
                let layers = [plane.to_vec(), vec![Vec3::ZERO; plane.len()]];
                let all: Vec<usize> = (0..plane.len()).collect();
                let around = Around::new(&layers, &all, 0.0);
                let lamp = MirroredLight { id: "lamp", radiance: &weights, cells: &[] };
                let mirror = Mirror::new(&part.of, around, &[lamp]).expect("the lamp is there");
                let (small, depth) = part.reduced(&photo, &self.depth);
                let upsampler = Upsampler::new(&photo, &self.depth, &small, &depth);
                for (i, change) in part.adds(&mirror, &upsampler, 0, plane, |_| Vec3::ZERO) {
                    sums[i as usize] += change;
                }
            }
            sums
        }
    }

    const DULL: f32 = 1.0;

    #[test]
    fn a_mirror_floor_shows_the_wall_at_the_mirrored_pixel() {
        // The stand-in for the picture returns its own column and row.
        let plane: Vec<Vec3> = (0..SIZE.0 * SIZE.1)
            .map(|i| Vec3::new((i % SIZE.0) as f32 + 0.5, (i / SIZE.0) as f32 + 0.5, 1.0))
            .collect();
        for error in [0.0, 0.004] {
            let room = room(error);
            let shown = room.adds([DULL, 0.0], Shape::Absent, 0.0, &plane);
            let mut checked = 0;
            for i in (0..plane.len()).filter(|&i| room.is_floor(i)) {
                let way = room.camera.pixel_point(i % SIZE.0, i / SIZE.0, 1.0);
                let point = way * (FLOOR / way.y);
                let mirrored = Vec3::new(way.x, -way.y, way.z);
                let met = point + mirrored * ((WALL - point.z) / mirrored.z);
                // A crease is cut off by up to a pixel.
                let Some(at) = room.camera.project(met).filter(|at| {
                    room.camera.contains(*at) && met.y > FLOOR + 0.06 && at.x > 2.0 && at.x < 78.0
                }) else {
                    continue;
                };
                // Schlick's reflectance of a dielectric, 4 % at normal incidence, in Karis' fit of
                // it.
                let cosine = -way.normalize().y;
                let want = 0.04 + 0.96 * ((-5.55473 * cosine - 6.98316) * cosine).exp2();
                assert!(
                    (shown[i].z / want - 1.0).abs() < 0.03,
                    "{i}: {} against {want}",
                    shown[i].z
                );
                let (x, y) = (shown[i].x / shown[i].z, shown[i].y / shown[i].z);
                let off = (x - at.x).abs().max((y - at.y).abs());
                assert!(
                    off < if error > 0.0 { 2.0 } else { 1.2 },
                    "{i} shows ({x}, {y}), wanted {at}, error {error}"
                );
                checked += 1;
            }
            assert!(checked > 500, "{checked} pixels of the floor mirror seen wall");
        }
    }

    #[test]
    fn a_small_lamp_shines_where_and_as_ggx_says() {
        let room = room(0.0);
        let (center, radius, radiance) = (Vec3::new(0.3, -0.4, -3.9), 0.015, 50.0);
        let lamp = Shape::Lamp(Lamp::Sphere(SphereLamp { center, radius }));
        let dark = vec![Vec3::ZERO; SIZE.0 * SIZE.1];
        for (roughness, tolerance) in [(0.25, 0.06), (0.7, 0.15)] {
            let shown = room.adds([DULL, roughness], lamp.clone(), radiance, &dark);
            let want = |i: usize| {
                let way = room.camera.pixel_point(i % SIZE.0, i / SIZE.0, 1.0);
                let point = way * (FLOOR / way.y);
                let gloss = Gloss { roughness, specular: 0.5, metallic: 0.0 };
                let surface =
                    Ggx::new(Vec3::Y, -point.normalize(), Vec3::ZERO, gloss).expect("it reflects");
                let light = center - point;
                let solid_angle = std::f32::consts::PI * radius * radius / light.length_squared();
                let light = light.normalize();
                radiance * solid_angle * light.y * surface.value(light).x
            };
            let floor = || (0..dark.len()).filter(|&i| room.is_floor(i));
            let peak = |of: &dyn Fn(usize) -> f32| {
                floor().max_by(|&a, &b| of(a).total_cmp(&of(b))).expect("a floor")
            };
            let (got, wanted) = (peak(&|i| shown[i].x), peak(&want));
            let apart = (got % SIZE.0)
                .abs_diff(wanted % SIZE.0)
                .max((got / SIZE.0).abs_diff(wanted / SIZE.0));
            assert!(apart <= 2, "roughness {roughness}: the peak is {apart} pixels off");
            for i in floor().filter(|&i| want(i) > 0.5 * want(wanted)) {
                let (got, want) = (shown[i].x, want(i));
                // The rougher one is known at every second pixel, at the edge of the floor on one
                // side only.
                assert!(
                    (got / want - 1.0).abs() < tolerance,
                    "roughness {roughness}, pixel {i}: {got} against {want}"
                );
            }
        }
    }

    #[test]
    fn the_old_reflection_is_taken_away_and_what_stays_is_not_touched() {
        let room = room(0.0);
        let even = vec![Vec3::ONE; SIZE.0 * SIZE.1];
        let lamp = || {
            Shape::Lamp(Lamp::Sphere(SphereLamp {
                center: Vec3::new(0.3, -0.6, -3.7),
                radius: 0.1,
            }))
        };
        let sum = |of: [f32; 2]| {
            room.adds(of, lamp(), 9.0, &even).iter().map(|c| f64::from(c.x)).sum::<f64>()
        };
        assert_eq!(sum([0.4, 0.4]), 0.0);
        let (gained, lost) = (sum([DULL, 0.4]), sum([0.4, DULL]));
        assert!(gained > 0.0 && (gained + lost).abs() < 1e-4 * gained, "{gained} and {lost}");
    }

    #[test]
    fn nothing_changed_asks_nothing() {
        let room = room(0.0);
        let seen = SeenSurface {
            camera: &room.camera,
            full_depth: &room.depth,
            points: &room.points,
            normal: &room.normal,
            mesh: &room.mesh,
        };
        let (kinds, planes) = places(&SpecularEdit::default(), &seen);
        assert!(kinds.is_empty() && planes.is_empty());
    }

    #[test]
    fn a_narrow_lobe_is_known_at_photo_pixels_and_a_broad_one_at_every_second_working_pixel() {
        let room = room(0.0);
        let full = (2 * SIZE.0, 2 * SIZE.1);
        let seen = SeenSurface {
            camera: &room.camera.resized(full.0, full.1),
            full_depth: &resize_depth(&room.depth, full.0, full.1),
            points: &room.points,
            normal: &room.normal,
            mesh: &room.mesh,
        };
        let lower = Plane::from_fn(full.0, full.1, |_, y| f32::from(u8::from(y >= 100)));
        for (roughness, size) in [(0.05, full), (0.3, SIZE), (0.7, (SIZE.0 / 2, SIZE.1 / 2))] {
            let mut finish = SpecularEdit::default();
            finish.lay(
                &lower,
                [Some(roughness), None],
                &Roughness(Plane::filled(SIZE.0, SIZE.1, 0.8)),
            );
            let (kinds, _) = places(&finish, &seen);
            let sizes: Vec<_> = kinds.iter().map(|kind| (kind.old, kind.rows.size())).collect();
            assert_eq!(
                sizes,
                [(false, size), (true, (SIZE.0 / 2, SIZE.1 / 2))],
                "roughness {roughness}"
            );
            // The floor is one plane, also at its edge.
            assert!(
                kinds.iter().all(|kind| kind.points.iter().all(|f| f.normal.dot(Vec3::Y) > 0.9999))
            );
        }
    }
}
