//! Inpainting of unknown pixels from known ones.

use glam::Vec3;

use crate::image::{Normal, Plane, Points};
use crate::tuning::tuning;

/// Inpaints the pixels where `unknown` holds from known ones around them: from the edge inwards,
/// each pixel takes the mean of its neighbors on the same surface (alike in depth to 3 %, and in
/// normal) with no edge between; where there is none, of all its neighbors. Then Poisson's equation
/// is relaxed along the surface, with the known values on the boundary, so that an edge there
/// leaves no streak. All planes have one size. Without any known pixel nothing changes.
///
/// `link(i, j)` is the wanted difference of the values of pixel `i` and its neighbor `j`, the
/// negative of that of `link(j, i)`, and its weight, above 0 and up to 1, the same for both: less
/// than one half at an edge. Zero with equal weights gives a harmonic filling.
pub fn inpaint_surfaces(
    values: &mut Plane<Vec3>,
    mut unknown: Plane<bool>,
    (points, normal): (&Points, &Normal),
    link: impl Fn(usize, usize) -> (Vec3, f32),
) {
    let (w, h) = values.size();
    let same_surface = |i: usize, j: usize| {
        let z = |i: usize| -points.0.pixels()[i].z;
        (z(j) - z(i)).abs() < TUNING.same_depth * z(i)
            && normal.0.pixels()[i].dot(normal.0.pixels()[j]) > TUNING.same_normal
    };
    let around = |i: usize| {
        let (x, y) = (i % w, i / w);
        let (xs, ys) = (x.saturating_sub(1)..(x + 2).min(w), y.saturating_sub(1)..(y + 2).min(h));
        ys.flat_map(move |y| xs.clone().map(move |x| y * w + x)).filter(move |&j| j != i)
    };
    let mut left: Vec<usize> = (0..w * h).filter(|&i| unknown.pixels()[i]).collect();
    let filled = left.clone();
    let mut alike = true;
    while !left.is_empty() {
        let found: Vec<(usize, Vec3)> = left
            .iter()
            .filter_map(|&i| {
                let known = around(i).filter(|&j| !unknown.pixels()[j]).map(|j| (j, link(i, j)));
                let same =
                    known.filter(|&(j, (_, weight))| !alike || weight >= 0.5 && same_surface(i, j));
                let (sum, weights) = same.fold((Vec3::ZERO, 0.0), |(sum, all), (j, link)| {
                    (sum + link.1 * (values.pixels()[j] + link.0), all + link.1)
                });
                (weights > 0.0).then(|| (i, sum / weights))
            })
            .collect();
        if found.is_empty() && !alike {
            break;
        }
        // Islands that touch nothing of their own surface take the values beside them.
        alike = !found.is_empty();
        for (i, value) in found {
            values.pixels_mut()[i] = value;
            unknown.pixels_mut()[i] = false;
        }
        left.retain(|&i| unknown.pixels()[i]);
    }
    // Of each pixel, its links along the surface and the sum of their weights.
    let linked = |i: usize| {
        let near = around(i).filter(|&j| same_surface(i, j)).map(|j| (j, link(i, j)));
        let near: Vec<(usize, (Vec3, f32))> = near.collect();
        let weights: f32 = near.iter().map(|(_, (_, weight))| weight).sum();
        (i, near, weights)
    };
    let mut inner: Vec<_> = filled.into_iter().map(linked).collect();
    inner.retain(|(_, near, _)| !near.is_empty());
    for _ in 0..TUNING.smoothing {
        for (i, near, weights) in &inner {
            let terms =
                near.iter().map(|&(j, (step, weight))| weight * (values.pixels()[j] + step));
            values.pixels_mut()[*i] = terms.sum::<Vec3>() / *weights;
        }
    }
}

tuning! {
    /// Constants of the inpainting of surfaces.
    pub const TUNING: InpaintTuning {
        /// Relative difference of depth up to which neighbors lie on one surface.
        same_depth: f32 = 0.03,
            unit "1", source Taste, effect "a larger value fills across steps";
        /// Cosine between the normals of neighbors on one surface that must be exceeded.
        same_normal: f32 = 0.9,
            unit "1", source Taste, effect "a smaller value fills across edges";
        /// Gauss-Seidel sweeps towards a harmonic filling.
        smoothing: usize = 60,
            unit "sweeps", source Derived("enough for streaks some ten pixels wide"),
            effect "a smaller value leaves streaks";
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_takes_its_own_surface_and_not_what_stands_before_it() {
        // A wall at 4 m on the right of something at 2 m; a hole in the wall touches both.
        let near = |x: usize| x < 5;
        let points = Points(Plane::from_fn(12, 9, |x, y| {
            Vec3::new(x as f32, y as f32, if near(x) { -2.0 } else { -4.0 })
        }));
        let normal = Normal(Plane::filled(12, 9, Vec3::Z));
        let unknown = Plane::from_fn(12, 9, |x, y| (5..9).contains(&x) && (2..7).contains(&y));
        let mut values = Plane::from_fn(12, 9, |x, _| if near(x) { Vec3::X } else { Vec3::Y });
        values.set(6, 4, Vec3::splat(99.0));
        inpaint_surfaces(&mut values, unknown, (&points, &normal), |_, _| (Vec3::ZERO, 1.0));
        assert!((5..12).all(|x| (0..9).all(|y| values.get(x, y) == Vec3::Y)));
    }

    #[test]
    fn what_lies_across_an_edge_tells_little() {
        // A hole from column 3 to 8 beside an edge at its left: the right side fills it.
        let mut values = Plane::from_fn(12, 9, |x, _| if x < 3 { Vec3::X } else { Vec3::Y });
        let unknown = Plane::from_fn(12, 9, |x, _| (3..9).contains(&x));
        let points = Points(Plane::filled(12, 9, Vec3::NEG_Z));
        let normal = Normal(Plane::filled(12, 9, Vec3::Z));
        let is_edge = |i: usize, j: usize| (i % 12 < 3) != (j % 12 < 3);
        let link = |i, j| (Vec3::ZERO, if is_edge(i, j) { 0.01 } else { 1.0 });
        inpaint_surfaces(&mut values, unknown, (&points, &normal), link);
        for (i, value) in values.pixels().iter().enumerate().filter(|(i, _)| i % 12 >= 3) {
            assert!(value.x < 0.06 && (value.x + value.y - 1.0).abs() < 1e-5, "{i}: {value}");
        }
        // Nothing else is known: then it is what lies across the edge.
        let unknown = Plane::from_fn(12, 9, |x, _| x >= 3);
        inpaint_surfaces(&mut values, unknown, (&points, &normal), link);
        assert!(values.pixels().iter().all(|value| (*value - Vec3::X).abs().max_element() < 1e-5));
    }

    #[test]
    fn given_steps_are_kept_in_the_filling() {
        // A pattern under a hole comes back from its steps and the known rim alone.
        let pattern = Plane::from_fn(12, 12, |x, y| Vec3::splat(((3 * x + 5 * y) % 4) as f32));
        let unknown = Plane::from_fn(12, 12, |x, y| (3..9).contains(&x) && (3..9).contains(&y));
        let mut values = pattern.clone();
        unknown.pixels().iter().zip(values.pixels_mut()).for_each(|(unknown, value)| {
            if *unknown {
                *value = Vec3::splat(99.0);
            }
        });
        let points = Points(Plane::filled(12, 12, Vec3::NEG_Z));
        let normal = Normal(Plane::filled(12, 12, Vec3::Z));
        let step = |i: usize, j: usize| (pattern.pixels()[i] - pattern.pixels()[j], 1.0);
        inpaint_surfaces(&mut values, unknown, (&points, &normal), step);
        for (got, want) in values.pixels().iter().zip(pattern.pixels()) {
            assert!((*got - *want).abs().max_element() < 1e-4, "{got} against {want}");
        }
    }

    #[test]
    fn nothing_known_changes_nothing() {
        let mut values = Plane::filled(3, 2, Vec3::ONE);
        let points = Points(Plane::filled(3, 2, Vec3::NEG_Z));
        inpaint_surfaces(
            &mut values,
            Plane::filled(3, 2, true),
            (&points, &Normal(Plane::filled(3, 2, Vec3::Z))),
            |_, _| (Vec3::ZERO, 1.0),
        );
        assert_eq!(values, Plane::filled(3, 2, Vec3::ONE));
    }
}
