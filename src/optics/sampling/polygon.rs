//! Polygons above a receiver's horizon: their solid angle and their irradiance in closed form.

use std::f64::consts::TAU;

use glam::DVec3;

/// The part of a convex polygon that lies above a receiver's horizon. Everything is relative to the
/// receiver.
#[derive(Clone, Copy)]
pub struct Outline {
    edges: [ArcEdge; Outline::MOST],
    count: usize,
}

/// An arc of a great circle on the receiver's sphere of directions.
#[derive(Clone, Copy)]
pub struct ArcEdge {
    /// The first corner.
    pub start: DVec3,
    /// The second corner.
    pub end: DVec3,
    /// Unit normal of the plane through receiver and edge; the polygon lies on its positive side.
    pub inward: DVec3,
    /// The angle that the edge subtends, 0..pi.
    pub angle: f64,
}

impl Outline {
    /// Most corners: a convex polygon of four gains at most one when a plane cuts it.
    pub const MOST: usize = 5;

    /// The outline of a convex polygon above the horizon of `normal`; `None` where no part of it is
    /// above.
    ///
    /// The `corners`, three or four, are counter-clockwise as the receiver sees them.
    pub fn above(corners: &[DVec3], normal: DVec3) -> Option<Outline> {
        let (above, corners) = clip(corners, normal);
        let nothing =
            ArcEdge { start: DVec3::ZERO, end: DVec3::ZERO, inward: DVec3::ZERO, angle: 0.0 };
        let mut outline = Outline { edges: [nothing; Outline::MOST], count: 0 };
        for i in 0..corners {
            let (start, end) = (above[i], above[(i + 1) % corners]);
            // The difference first: the product of two long, nearly equal corners would lose their
            // difference.
            let cross = (end - start).cross(start);
            let length = cross.length();
            // An edge that is seen end on, or on which the receiver lies, is not a part of the
            // outline.
            if length > 0.0 && length.is_finite() {
                let angle = length.atan2(start.dot(end));
                outline.edges[outline.count] =
                    ArcEdge { start, end, inward: cross / length, angle };
                outline.count += 1;
            }
        }
        (outline.count > 2).then_some(outline)
    }

    /// The edges in the order of the corners, three to five.
    pub fn edges(&self) -> &[ArcEdge] {
        &self.edges[..self.count]
    }

    /// The solid angle, steradians.
    pub fn solid_angle(&self) -> f64 {
        let edges = self.edges();
        let triangle = |edge: &ArcEdge| triangle_solid_angle(edges[0].start, edge.start, edge.end);
        edges[1..edges.len() - 1].iter().map(triangle).sum::<f64>().max(0.0)
    }

    /// The irradiance over pi, E / L in 0..=1, of uniform radiance, for a receiver of unit
    /// `normal`.
    ///
    /// Lambert's formula, Photometria (1760): (1/2 pi) sum over the edges of (angle) (normal .
    /// edge's unit normal).
    pub fn irradiance(&self, normal: DVec3) -> f64 {
        (self.edges().iter().map(|edge| edge.angle * edge.inward.dot(normal)).sum::<f64>() / TAU)
            .max(0.0)
    }
}

/// The solid angle of a triangle, steradians, positive for corners counter-clockwise as the
/// receiver sees them.
///
/// Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", IEEE Trans. Biomed. Eng. 30
/// (1983); it stays exact for small and distant triangles.
pub fn triangle_solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let volume = a.dot((c - a).cross(b - a));
    2.0 * volume.atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
}

/// The corners of the part above the horizon, and their number.
fn clip(corners: &[DVec3], normal: DVec3) -> ([DVec3; Outline::MOST], usize) {
    let mut above = [DVec3::ZERO; Outline::MOST];
    let mut count = 0;
    let mut push = |corner: DVec3| {
        if count < above.len() {
            above[count] = corner;
            count += 1;
        }
    };
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let (height_a, height_b) = (normal.dot(a), normal.dot(b));
        if height_a >= 0.0 {
            push(a);
        }
        if (height_a > 0.0 && height_b < 0.0) || (height_a < 0.0 && height_b > 0.0) {
            push(a + (b - a) * (height_a / (height_a - height_b)));
        }
    }
    (above, count)
}

/// The irradiance over pi, E / L = (1/pi) integral of cos(theta) over the polygon's part above the
/// horizon of `normal`, 0..=1.
///
/// `corners` (three or four, convex, either orientation) are relative to the shaded point. 64-bit
/// because the terms of a small, distant polygon cancel almost wholly.
pub fn polygon_irradiance(corners: &[DVec3], normal: DVec3) -> f64 {
    let (above, count) = clip(corners, normal);
    let sum: f64 = (0..count)
        .map(|i| {
            let (a, b) = (above[i], above[(i + 1) % count]);
            let cross = a.cross(b - a);
            let length = cross.length();
            // An edge that is seen end on, or on which the point lies, contributes nothing.
            if length > 0.0 { length.atan2(a.dot(b)) * normal.dot(cross) / length } else { 0.0 }
        })
        .sum();
    (sum / TAU).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A rectangle from (0, 0) to (a, b) at height c over the point, parallel to its surface.
    fn corner_rectangle(a: f64, b: f64, c: f64) -> [DVec3; 4] {
        [DVec3::new(0.0, 0.0, c), DVec3::new(a, 0.0, c), DVec3::new(a, b, c), DVec3::new(0.0, b, c)]
    }

    #[test]
    fn agrees_with_the_textbook_view_factors() {
        // Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-3: element parallel
        // to a rectangle.
        let (a, b, c): (f64, f64, f64) = (0.7, 1.3, 0.9);
        let (x, y) = (a / c, b / c);
        let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        let b3 = (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / TAU;
        assert!((polygon_irradiance(&corner_rectangle(a, b, c), DVec3::Z) - b3).abs() < 1e-14);
        // B-4: element perpendicular to a rectangle that stands on its plane.
        let wall = [
            DVec3::new(c, 0.0, 0.0),
            DVec3::new(c, b, 0.0),
            DVec3::new(c, b, a),
            DVec3::new(c, 0.0, a),
        ];
        let r = (c * c + a * a).sqrt();
        let b4 = ((b / c).atan() - c / r * (b / r).atan()) / TAU;
        assert!((polygon_irradiance(&wall, DVec3::Z) - b4).abs() < 1e-14);
    }

    #[test]
    fn the_horizon_cuts_exactly() {
        // A wall that extends as far below the horizon as above it gives the same as its upper
        // half.
        let wall = |bottom: f64| {
            [
                DVec3::new(1.0, -1.0, bottom),
                DVec3::new(1.0, 2.0, bottom),
                DVec3::new(1.0, 2.0, 1.5),
                DVec3::new(1.0, -1.0, 1.5),
            ]
        };
        let whole = polygon_irradiance(&wall(-1.5), DVec3::Z);
        assert!((whole - polygon_irradiance(&wall(0.0), DVec3::Z)).abs() < 1e-15);
        assert_eq!(
            polygon_irradiance(&wall(-1.5), DVec3::Z),
            polygon_irradiance(&wall(-1.5).map(|c| c * 3.0), DVec3::Z)
        );
        assert_eq!(
            polygon_irradiance(&wall(-1.5).map(|c| DVec3::new(c.x, c.y, c.z - 2.0)), DVec3::Z),
            0.0,
            "all below"
        );
    }

    #[test]
    fn large_and_small_polygons_reach_their_limits() {
        let sky = [
            DVec3::new(1e6, 1e6, 1.0),
            DVec3::new(-1e6, 1e6, 1.0),
            DVec3::new(-1e6, -1e6, 1.0),
            DVec3::new(1e6, -1e6, 1.0),
        ];
        assert!(
            (polygon_irradiance(&sky, DVec3::Z) - 1.0).abs() < 1e-6,
            "a whole sky of 1 gives 1"
        );
        let far = corner_rectangle(1e-3, 1e-3, 5.0);
        let point = 1e-6 / (PI * 25.0);
        assert!(
            (polygon_irradiance(&far, DVec3::Z) / point - 1.0).abs() < 1e-6,
            "a far small one is a point"
        );
        assert_eq!(polygon_irradiance(&[DVec3::ZERO; 4], DVec3::Z), 0.0);
        assert!(polygon_irradiance(&[DVec3::ZERO, DVec3::X, DVec3::Z], DVec3::Z).is_finite());
    }
}
