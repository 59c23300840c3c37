//! Points spread evenly over triangles.

use glam::Vec3;

/// Steps of the additive recurrence in two dimensions: Roberts, "The Unreasonable Effectiveness of
/// Quasirandom Sequences", 2018 (R2).
const R2: [f64; 2] = [0.754_877_666_2, 0.569_840_291];

/// `count` points in `triangles`, each of which has its fraction by area; none without triangles.
pub fn spread(triangles: &[[Vec3; 3]], count: usize) -> Vec<Vec3> {
    let area = |[a, b, c]: &[Vec3; 3]| f64::from((*b - *a).cross(*c - *a).length());
    let whole: f64 = triangles.iter().map(area).sum();
    let (mut triangle, mut reached) = (0, triangles.first().map_or(0.0, area));
    let mut points = Vec::with_capacity(count);
    for k in 0..count {
        while reached < (k as f64 + 0.5) / count as f64 * whole && triangle + 1 < triangles.len() {
            triangle += 1;
            reached += area(&triangles[triangle]);
        }
        let Some(&[a, b, c]) = triangles.get(triangle) else { break };
        let (u, v) = ((k as f64 * R2[0]).fract() as f32, (k as f64 * R2[1]).fract() as f32);
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        points.push(a + u * (b - a) + v * (c - a));
    }
    points
}
