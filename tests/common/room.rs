//! A seen room made ready for any light: `Mesh` and `Transport` run on its depth, and the inputs of
//! the stages after them.

use std::sync::Arc;

use relight::geometry::{Camera, SceneMesh};
use relight::graph::{Context, Gather, Node};
use relight::image::{Albedo, Depth, Mask, Normal, Plane, Points};
use relight::nodes::artifacts::{UnitDirect, Visibility};
use relight::nodes::render::direct::DirectIn;
use relight::nodes::render::shadow::ShadowIn;
use relight::nodes::render::trace_indirect::TraceIndirectIn;
use relight::nodes::render::transport::{Transport, TransportIn};
use relight::nodes::scene::mesh::{Mesh, MeshIn};
use relight::optics::{self, LightKind, Shape};

/// The seen room that the stages before the lights make of a camera and its depth.
pub struct Room {
    pub camera: Arc<Camera>,
    pub depth: Arc<Depth>,
    pub points: Arc<Points>,
    pub normal: Arc<Normal>,
    pub mesh: Arc<SceneMesh>,
    /// 128 rays from every fourth pixel along each axis.
    pub transport: Arc<optics::LightTransport>,
}

impl Room {
    /// `depth` returns planar z in meters at a pixel.
    pub fn new(camera: Camera, depth: impl Fn(usize, usize) -> f32) -> Room {
        Room::with_lights(
            camera,
            Depth(Plane::from_fn(camera.width, camera.height, depth)),
            Vec::new(),
        )
    }

    /// Panes of windows among the `masks` become no triangles.
    pub fn with_lights(
        camera: Camera,
        depth: Depth,
        masks: Vec<(String, LightKind, Mask)>,
    ) -> Room {
        let (camera, depth) = (Arc::new(camera), Arc::new(depth));
        let kinds =
            Gather(masks.iter().map(|(id, kind, _)| (id.clone(), Arc::new(*kind))).collect());
        let masks = Gather(masks.into_iter().map(|(id, _, mask)| (id, Arc::new(mask))).collect());
        let inputs = MeshIn {
            depth: depth.clone(),
            holes: None,
            photo: None,
            clipped: None,
            camera: camera.clone(),
            ignore: None,
            masks,
            kinds,
        };
        let seen = Mesh::default().run(inputs, &Context::default()).expect("the room is sound");
        let inputs = TransportIn {
            mesh: seen.mesh.clone(),
            points: seen.points.clone(),
            normal: seen.normal.clone(),
            layout: None,
        };
        let transport = Transport::default()
            .run(inputs, &Context::default())
            .expect("the room is sound")
            .transport;
        Room { camera, depth, points: seen.points, normal: seen.normal, mesh: seen.mesh, transport }
    }

    /// A floor one meter below the camera and a wall three meters before it.
    pub fn floor_and_wall(camera: Camera) -> Room {
        Room::new(camera, |x, y| {
            let down = -camera.pixel_point(x, y, 1.0).y;
            if down > 0.0 { 3f32.min(1.0 / down) } else { 3.0 }
        })
    }

    /// A square at 2 m before a wall at 4 m: a quarter to three quarters of the width, a sixth to
    /// five sixths of the height.
    pub fn square_before_wall(camera: Camera) -> Room {
        let Camera { width, height, .. } = camera;
        let square = |x: usize, y: usize| {
            (width / 4..3 * width / 4).contains(&x) && (height / 6..5 * height / 6).contains(&y)
        };
        Room::new(camera, |x, y| if square(x, y) { 2.0 } else { 4.0 })
    }

    /// Width and height of its planes.
    pub fn size(&self) -> (usize, usize) {
        self.points.0.size()
    }

    pub fn direct_in(&self, shape: &Shape) -> DirectIn {
        DirectIn {
            points: self.points.clone(),
            normal: self.normal.clone(),
            shape: Arc::new(shape.clone()),
            estimated: None,
            sunlight: None,
        }
    }

    pub fn shadow_in(&self, shape: &Shape, mask: Option<Arc<Mask>>) -> ShadowIn {
        let (points, normal, mesh) = (self.points.clone(), self.normal.clone(), self.mesh.clone());
        let shape = Arc::new(shape.clone());
        ShadowIn { points, normal, mesh, shape, mask, estimated: None, sunlight: None }
    }

    pub fn indirect_in(
        &self,
        albedo: &Arc<Albedo>,
        direct: &Arc<UnitDirect>,
        visibility: &Arc<Visibility>,
    ) -> TraceIndirectIn {
        TraceIndirectIn {
            transport: self.transport.clone(),
            points: self.points.clone(),
            normal: self.normal.clone(),
            albedo: albedo.clone(),
            direct: direct.clone(),
            visibility: visibility.clone(),
            objects: None,
            room: None,
            unedited: None,
        }
    }
}
