//! A box room with blocks in it, in closed form.

use glam::Vec3;

/// An axis-aligned box seen from inside, and solid ones seen from outside; meters, camera space.
pub struct Boxes {
    /// Low and high corner of the room.
    pub room: [Vec3; 2],
    /// Low and high corner of each block.
    pub blocks: Vec<[Vec3; 2]>,
}

/// The nearest surface along a ray.
pub struct Hit {
    /// Distance in lengths of the ray.
    pub t: f32,
    /// Unit normal towards the origin of the ray.
    pub normal: Vec3,
    /// Number of the side: the room has 0..6, each block the next 6; low x, y, z, then high x, y,
    /// z.
    pub side: u32,
}

impl Boxes {
    /// Number of sides.
    pub fn sides(&self) -> u32 {
        6 * (1 + self.blocks.len() as u32)
    }

    /// The surface that a ray from inside the room meets first.
    pub fn cast(&self, origin: Vec3, ray: Vec3) -> Hit {
        let [low, high] = self.room;
        let far = Vec3::select(ray.cmplt(Vec3::ZERO), low, high);
        let leave = (far - origin) / ray;
        let axis =
            (0..3).min_by(|&a, &b| leave[a].total_cmp(&leave[b])).expect("there are three axes");
        let wall = hit(leave[axis], axis, ray, ray[axis] > 0.0);
        let block = |(i, [low, high]): (usize, &[Vec3; 2])| {
            let (a, b) = ((*low - origin) / ray, (*high - origin) / ray);
            let (enter, leave) = (a.min(b), a.max(b));
            let t = enter.max_element();
            let axis = (0..3).find(|&k| enter[k] == t)?;
            let met = hit(t, axis, ray, ray[axis] < 0.0);
            (t > 0.0 && t < leave.min_element())
                .then_some(Hit { side: met.side + 6 * (i as u32 + 1), ..met })
        };
        let blocks = self.blocks.iter().enumerate().filter_map(block);
        blocks.fold(wall, |nearest, met| if met.t < nearest.t { met } else { nearest })
    }
}

fn hit(t: f32, axis: usize, ray: Vec3, high: bool) -> Hit {
    Hit {
        t,
        normal: -Vec3::AXES[axis] * ray[axis].signum(),
        side: axis as u32 + if high { 3 } else { 0 },
    }
}
