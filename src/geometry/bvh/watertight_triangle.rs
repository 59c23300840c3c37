//! Rays against triangles, eight at once, without gaps between neighbors.
//!
//! The test is that of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1),
//! 2013. The ray is turned and sheared into the z axis; a triangle is hit when the origin lies on
//! the same side of its three edges. Two triangles see their shared edge with exactly opposite
//! signs, because a product of two numbers rounds the same in either triangle. A fused multiply-add
//! would break that, and would make the result depend on the processor: so none is used.

use std::hint::black_box;

use fearless_simd::{Simd, f32x8, prelude::*};
use glam::Vec3;

/// Up to eight triangles in five cache lines. Places without one hold NaN, which no ray meets.
#[repr(C, align(64))]
pub struct Packet {
    /// By corner, axis and triangle.
    corners: [[[f32; 8]; 3]; 3],
    /// The caller's numbers.
    pub ids: [u32; 8],
}

impl Packet {
    /// Packs the first eight triangles.
    pub fn new(triangles: impl IntoIterator<Item = ([Vec3; 3], u32)>) -> Packet {
        let mut packet = Packet { corners: [[[f32::NAN; 8]; 3]; 3], ids: [u32::MAX; 8] };
        for (lane, (corners, id)) in triangles.into_iter().take(8).enumerate() {
            for (axes, corner) in packet.corners.iter_mut().zip(corners) {
                for (lanes, value) in axes.iter_mut().zip(corner.to_array()) {
                    lanes[lane] = value;
                }
            }
            packet.ids[lane] = id;
        }
        packet
    }

    /// Reads both ends, so that they are near when the packet is tested.
    #[inline(always)]
    pub fn fetch(&self) {
        black_box((self.corners[0][0][0], self.ids[0]));
    }
}

/// A ray turned so that it runs along the axis of its largest component, the last of `axes`.
pub struct Turned<S: Simd> {
    simd: S,
    axes: [usize; 3],
    origin: [f32x8<S>; 3],
    shear: [f32x8<S>; 3],
}

impl<S: Simd> Turned<S> {
    /// The direction is not zero.
    #[inline(always)]
    pub fn new(simd: S, origin: Vec3, direction: Vec3) -> Turned<S> {
        let z = direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            (x, y) = (y, x);
        }
        let inverse = 1.0 / direction[z];
        let (shear_x, shear_y) = (direction[x] * inverse, direction[y] * inverse);
        Turned {
            simd,
            axes: [x, y, z],
            origin: [
                f32x8::splat(simd, origin[x]),
                f32x8::splat(simd, origin[y]),
                f32x8::splat(simd, origin[z]),
            ],
            shear: [
                f32x8::splat(simd, shear_x),
                f32x8::splat(simd, shear_y),
                f32x8::splat(simd, inverse),
            ],
        }
    }

    #[inline(always)]
    fn turn(&self, corner: &[[f32; 8]; 3]) -> [f32x8<S>; 3] {
        let [x, y, z] = self.axes;
        let depth = f32x8::simd_from(self.simd, corner[z]) - self.origin[2];
        [
            f32x8::simd_from(self.simd, corner[x]) - self.origin[0] - self.shear[0] * depth,
            f32x8::simd_from(self.simd, corner[y]) - self.origin[1] - self.shear[1] * depth,
            self.shear[2] * depth,
        ]
    }

    /// The triangles hit within (0, `limit`], a bit each, and their distances in units of the
    /// direction. A triangle seen edge on is not hit but by rounding, nor is anything when numbers
    /// overflow: then the distance is not a number.
    #[inline(always)]
    pub fn hits(&self, packet: &Packet, limit: f32) -> (u64, [f32; 8]) {
        let [a, b, c] = [&packet.corners[0], &packet.corners[1], &packet.corners[2]];
        let (a, b, c) = (self.turn(a), self.turn(b), self.turn(c));
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        let zero = f32x8::splat(self.simd, 0.0);
        let inside = u.min(v).min(w).simd_ge(zero) | u.max(v).max(w).simd_le(zero);
        if inside.to_bitmask() == 0 {
            return (0, [0.0; 8]);
        }
        let distance = (u * a[2] + v * b[2] + w * c[2]) / (u + v + w);
        let hit =
            inside & distance.simd_gt(zero) & distance.simd_le(f32x8::splat(self.simd, limit));
        (hit.to_bitmask(), distance.into())
    }
}
