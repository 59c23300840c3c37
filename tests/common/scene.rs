//! A photographed box room whose lights, albedo and shading are known.

use std::sync::Arc;

use glam::Vec3;
use relight::geometry::Camera;
use relight::graph::{Context, Gather, Node};
use relight::image::{Albedo, Depth, Mask, Picture, Plane, Segments, Shading};
use relight::nodes::artifacts::{UnitDirect, UnitIndirect, Visibility};
use relight::nodes::render::direct::Direct;
use relight::nodes::render::shadow::Shadow;
use relight::nodes::render::trace_indirect::TraceIndirect;
use relight::optics::{Lamp, LightKind, Radiance, Shape};

use super::boxes::Boxes;
use super::room::Room;

/// A light of the scene, and its unit layers.
pub struct Light {
    pub id: &'static str,
    pub shape: Arc<Shape>,
    pub radiance: Arc<Radiance>,
    /// Its pixels; `None` for a light that the photo does not show.
    pub mask: Option<Arc<Mask>>,
    pub direct: Arc<UnitDirect>,
    pub visibility: Arc<Visibility>,
    pub indirect: Arc<UnitIndirect>,
}

impl Light {
    fn new(
        (id, shape, radiance): (&'static str, Shape, Vec<Vec3>),
        mask: Option<Arc<Mask>>,
        (room, albedo, shadow): (&Room, &Arc<Albedo>, &Shadow),
    ) -> Light {
        let ctx = Context::default();
        let direct =
            Direct::default().run(room.direct_in(&shape), &ctx).expect("the light is sound").direct;
        let visibility = shadow.run(room.shadow_in(&shape, mask.clone()), &ctx);
        let visibility = visibility.expect("the light is sound").visibility;
        let indirect =
            TraceIndirect::default().run(room.indirect_in(albedo, &direct, &visibility), &ctx);
        let indirect = indirect.expect("the light is sound").indirect;
        let (shape, radiance) = (Arc::new(shape), Arc::new(Radiance(radiance)));
        Light { id, shape, radiance, mask, direct, visibility, indirect }
    }

    /// Shading at pixel `i` by the light as it is.
    pub fn shading(&self, i: usize) -> Vec3 {
        self.shading_by(&self.radiance.0, i)
    }

    /// Shading at pixel `i` by these radiances: the sum over lobes of w (direct x lit + indirect).
    pub fn shading_by(&self, radiance: &[Vec3], i: usize) -> Vec3 {
        let lobe = |(lobe, w): (usize, &Vec3)| {
            let direct =
                self.direct.lobes[lobe].pixels()[i] * self.visibility.lit[lobe].pixels()[i];
            *w * (Vec3::splat(direct) + self.indirect.lobes[lobe].0.pixels()[i])
        };
        radiance.iter().enumerate().map(lobe).sum()
    }

    pub fn kind(&self) -> LightKind {
        kind(&self.shape)
    }
}

fn kind(shape: &Shape) -> LightKind {
    if matches!(shape, Shape::Window(_)) { LightKind::Window } else { LightKind::Lamp }
}

/// The layout of a scene.
pub struct Plan {
    pub camera: Camera,
    pub boxes: Boxes,
    /// Albedo of a side at a point.
    pub paint: fn(u32, Vec3) -> Vec3,
    /// Whether the camera sees lights in its view: their pixels are masks, and spheres are part of
    /// the depth.
    pub sees_lights: bool,
    /// The stage that traces the visibility of each light.
    pub shadow: Shadow,
}

impl Plan {
    /// A room of 4 x 2.5 x 13 m around the camera with a block on its floor, each side of one
    /// paint.
    pub fn of_size((width, height): (usize, usize)) -> Plan {
        let boxes = Boxes {
            room: [Vec3::new(-2.0, -1.2, -4.0), Vec3::new(2.0, 1.3, 9.0)],
            blocks: vec![[Vec3::new(0.2, -1.2, -3.2), Vec3::new(0.8, -0.5, -2.6)]],
        };
        let paint = |side: u32, _: Vec3| {
            Vec3::new(0.5, 0.35, 0.25).lerp(Vec3::splat(0.7), side as f32 / 11.0)
        };
        let shadow = Shadow { samples: 64, half: false, ..Shadow::default() };
        Plan {
            camera: Camera::from_fov_x(width, height, 75.0),
            boxes,
            paint,
            sees_lights: true,
            shadow,
        }
    }

    /// Planar distance to a light at a pixel, where the camera sees it.
    fn met(&self, shape: &Shape, x: usize, y: usize) -> Option<f32> {
        let ray = self.camera.pixel_point(x, y, 1.0);
        let surface = self.boxes.cast(Vec3::ZERO, ray).t;
        shape.intersect(Vec3::ZERO, ray).filter(|t| self.sees_lights && *t < 1.01 * surface)
    }

    fn mask(&self, shape: &Shape) -> Option<Mask> {
        let seen = |x, y| f32::from(u8::from(self.met(shape, x, y).is_some()));
        let mask = Plane::from_fn(self.camera.width, self.camera.height, seen);
        mask.pixels().contains(&1.0).then_some(Mask(mask))
    }
}

/// A room under known lights. Each side is a segment.
pub struct Scene {
    pub boxes: Boxes,
    pub room: Room,
    pub albedo: Arc<Albedo>,
    pub segments: Arc<Segments>,
    pub lights: Vec<Light>,
}

impl std::ops::Deref for Scene {
    type Target = Room;

    fn deref(&self) -> &Room {
        &self.room
    }
}

impl Scene {
    /// The room of [`Plan::of_size`] with lights of these names, shapes and radiances.
    pub fn new(size: (usize, usize), lights: Vec<(&'static str, Shape, Vec<Vec3>)>) -> Scene {
        Scene::of(Plan::of_size(size), lights)
    }

    pub fn of(plan: Plan, lights: Vec<(&'static str, Shape, Vec<Vec3>)>) -> Scene {
        let Camera { width, height, .. } = plan.camera;
        let hit = |x, y| plan.boxes.cast(Vec3::ZERO, plan.camera.pixel_point(x, y, 1.0));
        let balls =
            || lights.iter().filter(|(_, shape, _)| matches!(shape, Shape::Lamp(Lamp::Sphere(_))));
        let depth = Plane::from_fn(width, height, |x, y| {
            balls().filter_map(|(_, shape, _)| plan.met(shape, x, y)).fold(hit(x, y).t, f32::min)
        });
        let masks = lights
            .iter()
            .filter_map(|(id, shape, _)| Some((id.to_string(), kind(shape), plan.mask(shape)?)));
        let room = Room::with_lights(plan.camera, Depth(depth), masks.collect());
        let albedo = Plane::from_fn(width, height, |x, y| {
            let hit = hit(x, y);
            (plan.paint)(hit.side, plan.camera.pixel_point(x, y, 1.0) * hit.t)
        });
        let albedo = Arc::new(Albedo(albedo));
        let light = |light: (&'static str, Shape, Vec<Vec3>)| {
            let mask = plan.mask(&light.1).map(Arc::new);
            Light::new(light, mask, (&room, &albedo, &plan.shadow))
        };
        let lights = lights.into_iter().map(light).collect();
        let segments = Segments {
            label: Plane::from_fn(width, height, |x, y| hit(x, y).side),
            count: plan.boxes.sides(),
        };
        Scene { room, albedo, segments: Arc::new(segments), lights, boxes: plan.boxes }
    }

    /// One value of each light.
    pub fn each<T>(&self, value: impl Fn(&Light) -> Arc<T>) -> Gather<T> {
        Gather(self.lights.iter().map(|light| (light.id.to_string(), value(light))).collect())
    }

    /// Pixels of the visible lights.
    pub fn masks(&self) -> Gather<Mask> {
        let visible = self
            .lights
            .iter()
            .filter_map(|light| Some((light.id.to_string(), light.mask.clone()?)));
        Gather(visible.collect())
    }

    /// Kinds of the visible lights.
    pub fn kinds(&self) -> Gather<LightKind> {
        let visible = self.lights.iter().filter(|light| light.mask.is_some());
        Gather(visible.map(|light| (light.id.to_string(), Arc::new(light.kind()))).collect())
    }

    /// A plane of the room's size, of zeros.
    pub fn none(&self) -> Arc<Mask> {
        Arc::new(Mask(self.albedo.0.map(|_| 0.0)))
    }

    /// Shading by each light at its radiance.
    pub fn shading(&self) -> Gather<Shading> {
        let (w, h) = self.size();
        self.each(|light| {
            let pixels = (0..w * h).map(|i| light.shading(i));
            Arc::new(Shading(Plane::new(w, h, pixels.collect())))
        })
    }

    /// The photo under all lights, not clipped: albedo x shading, and in a light's own pixels its
    /// radiance.
    pub fn photo(&self) -> Picture {
        let (w, h) = self.size();
        let pixel = |i: usize| {
            let own =
                |light: &&Light| light.mask.as_ref().is_some_and(|mask| mask.0.pixels()[i] > 0.0);
            let ray = self.camera.pixel_point(i % w, i / w, 1.0).normalize();
            match self.lights.iter().find(own).map(|light| (&*light.shape, &light.radiance.0)) {
                Some((Shape::Window(window), radiance)) => window.emitted(radiance, ray),
                Some((_, radiance)) => radiance.iter().sum(),
                None => {
                    let shading = self.lights.iter().map(|light| light.shading(i));
                    self.albedo.0.pixels()[i] * shading.sum::<Vec3>()
                }
            }
        };
        Picture(Plane::new(w, h, (0..w * h).map(pixel).collect()))
    }
}

/// A photo as a camera stores it: clipped at 1, and 1 where it is.
pub fn stored(photo: &Picture) -> (Arc<Picture>, Arc<Mask>) {
    let clipped = photo.0.map(|shown| f32::from(u8::from(shown.max_element() >= 1.0)));
    (Arc::new(Picture(photo.0.map(|shown| shown.min(Vec3::ONE)))), Arc::new(Mask(clipped)))
}
