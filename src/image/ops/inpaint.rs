//! Inpainting of unknown pixels from known ones.

use glam::{BVec3, Vec3};
use rayon::prelude::*;

use super::conjugate_gradients::conjugate_gradients;
use crate::image::{Normal, Plane, Points};
use crate::tuning::tuning;

/// Inpaints the channels that are `unknown` from known pixels around them: from the edge inwards,
/// each pixel takes the mean of its neighbors on the same surface (alike in depth to 3 %, and in
/// normal) with no edge between; where there is none, of all its neighbors. Then Poisson's equation
/// is solved along the surface, with the known values on the boundary. All planes have one size.
/// Without any known pixel nothing changes.
///
/// `link(i, j)` is the wanted difference of the values of pixel `i` and its neighbor `j`, the
/// negative of that of `link(j, i)`, and its weight, above 0 and up to 1, the same for both: less
/// than one half at an edge. Zero with equal weights gives a harmonic filling.
pub fn inpaint_surfaces(
    values: &mut Plane<Vec3>,
    unknown: Plane<BVec3>,
    (points, normal): (&Points, &Normal),
    link: impl Fn(usize, usize) -> (Vec3, f32) + Sync,
) {
    let same_surface = |i: usize, j: usize| {
        let z = |i: usize| -points.0.pixels()[i].z;
        (z(j) - z(i)).abs() < TUNING.same_depth * z(i).min(z(j))
            && normal.0.pixels()[i].dot(normal.0.pixels()[j]) > TUNING.same_normal
    };
    inpaint_within(values, unknown, same_surface, link);
}

/// The same along all of the picture: only the weights of the links tell surfaces apart.
pub fn inpaint(
    values: &mut Plane<Vec3>,
    unknown: Plane<BVec3>,
    link: impl Fn(usize, usize) -> (Vec3, f32) + Sync,
) {
    inpaint_within(values, unknown, |_, _| true, link);
}

fn inpaint_within(
    values: &mut Plane<Vec3>,
    unknown: Plane<BVec3>,
    same_surface: impl Fn(usize, usize) -> bool + Sync,
    link: impl Fn(usize, usize) -> (Vec3, f32) + Sync,
) {
    let (w, h) = values.size();
    let channels = unknown;
    let mut unknown = channels.map(BVec3::any);
    let around = |i: usize| {
        let (x, y) = (i % w, i / w);
        let (xs, ys) = (x.saturating_sub(1)..(x + 2).min(w), y.saturating_sub(1)..(y + 2).min(h));
        ys.flat_map(move |y| xs.clone().map(move |x| y * w + x)).filter(move |&j| j != i)
    };
    let filled: Vec<usize> = (0..w * h).filter(|&i| unknown.pixels()[i]).collect();
    let touches_known = |&i: &usize| around(i).any(|j| !unknown.pixels()[j]);
    let mut front: Vec<usize> = filled.iter().copied().filter(touches_known).collect();
    let mut waits = unknown.clone();
    front.iter().for_each(|&i| waits.pixels_mut()[i] = false);
    let mut alike = true;
    while !front.is_empty() {
        let value = |&i: &usize| {
            let known = around(i).filter(|&j| !unknown.pixels()[j]).map(|j| (j, link(i, j)));
            let same =
                known.filter(|&(j, (_, weight))| !alike || weight >= 0.5 && same_surface(i, j));
            let (sum, weights) = same.fold((Vec3::ZERO, 0.0), |(sum, all), (j, link)| {
                (sum + link.1 * (values.pixels()[j] + link.0), all + link.1)
            });
            (weights > 0.0).then(|| (i, sum / weights))
        };
        let found: Vec<(usize, Vec3)> = front.par_iter().filter_map(value).collect();
        if found.is_empty() && !alike {
            break;
        }
        // Islands that touch nothing of their own surface take the values beside them.
        alike = !found.is_empty();
        for &(i, value) in &found {
            let known = values.pixels()[i];
            values.pixels_mut()[i] = Vec3::select(channels.pixels()[i], value, known);
            unknown.pixels_mut()[i] = false;
        }
        front.retain(|&i| unknown.pixels()[i]);
        for j in found.iter().flat_map(|&(i, _)| around(i)) {
            if std::mem::take(&mut waits.pixels_mut()[j]) {
                front.push(j);
            }
        }
    }
    solve(values, &filled, &channels, |i| {
        let near = around(i).filter(|&j| same_surface(i, j));
        near.map(|j| (j, link(i, j))).collect()
    });
}

/// A neighbor, the wanted difference to it and the weight of that.
type Link = (usize, (Vec3, f32));

/// Minimizes the weighted squares of the differences from those that are wanted, over the channels
/// of the pixels `inner` that are `unknown`, from the given values.
fn solve(
    values: &mut Plane<Vec3>,
    inner: &[usize],
    unknown: &Plane<BVec3>,
    links: impl Fn(usize) -> Vec<Link> + Sync,
) {
    let links: Vec<Vec<Link>> = inner.par_iter().map(|&i| links(i)).collect();
    let solved = |channel: usize| {
        let is_unknown = |&k: &usize| unknown.pixels()[inner[k]].test(channel);
        let own: Vec<usize> = (0..inner.len()).filter(is_unknown).collect();
        let mut place = vec![None; values.len()];
        own.iter().enumerate().for_each(|(at, &k)| place[inner[k]] = Some(at));
        let value = |i: usize| values.pixels()[i][channel];
        let pull =
            |i: usize, &(j, (step, weight)): &Link| weight * (value(j) + step[channel] - value(i));
        let residual =
            own.iter().map(|&k| links[k].iter().map(|link| pull(inner[k], link)).sum()).collect();
        let weight = |&k: &usize| links[k].iter().map(|(_, (_, weight))| weight).sum::<f32>();
        let diagonal: Vec<f32> = own.iter().map(|k| weight(k).max(f32::MIN_POSITIVE)).collect();
        let mut x: Vec<f32> = own.iter().map(|&k| value(inner[k])).collect();
        // The rows of the matrix without its diagonal, one after the other, and their ends.
        let mut others = Vec::new();
        let row = |&k: &usize| {
            others
                .extend(links[k].iter().filter_map(|&(j, (_, weight))| Some((place[j]?, weight))));
            others.len()
        };
        let ends: Vec<usize> = own.iter().map(row).collect();
        let enough = |energy| f64::from(TUNING.tolerance * TUNING.tolerance) * energy;
        let end = (enough, TUNING.iterations);
        conjugate_gradients(&mut x, residual, &diagonal, end, |along| {
            let mut start = 0;
            let row = |(at, &end): (usize, &usize)| {
                let others = &others[std::mem::replace(&mut start, end)..end];
                let others = others.iter().map(|&(j, weight)| weight * along[j]);
                diagonal[at] * along[at] - others.sum::<f32>()
            };
            ends.iter().enumerate().map(row).collect()
        });
        own.into_iter().map(|k| inner[k]).zip(x).collect::<Vec<(usize, f32)>>()
    };
    let solved: Vec<Vec<(usize, f32)>> = (0..3).into_par_iter().map(solved).collect();
    for (channel, solved) in solved.into_iter().enumerate() {
        solved.into_iter().for_each(|(i, x)| values.pixels_mut()[i][channel] = x);
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
        /// Norm of the residual of Poisson's equation over that at the beginning.
        tolerance: f32 = 1e-4,
            unit "1", source Derived("below the steps of 8 bits"), effect "a larger value leaves streaks";
        /// Largest number of iterations.
        iterations: usize = 1000,
            unit "iterations", source Derived("several times the side of a photo at working size"),
            effect "a smaller value leaves streaks in wide holes";
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
        inpaint_surfaces(&mut values, unknown.map(BVec3::splat), (&points, &normal), |_, _| {
            (Vec3::ZERO, 1.0)
        });
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
        inpaint_surfaces(&mut values, unknown.map(BVec3::splat), (&points, &normal), link);
        for (i, value) in values.pixels().iter().enumerate().filter(|(i, _)| i % 12 >= 3) {
            assert!(value.x < 0.06 && (value.x + value.y - 1.0).abs() < 1e-5, "{i}: {value}");
        }
        // Nothing else is known: then it is what lies across the edge.
        let unknown = Plane::from_fn(12, 9, |x, _| x >= 3);
        inpaint_surfaces(&mut values, unknown.map(BVec3::splat), (&points, &normal), link);
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
        inpaint_surfaces(&mut values, unknown.map(BVec3::splat), (&points, &normal), step);
        for (got, want) in values.pixels().iter().zip(pattern.pixels()) {
            assert!((*got - *want).abs().max_element() < 1e-4, "{got} against {want}");
        }
    }

    #[test]
    fn a_wide_hole_is_filled_to_the_solution_and_known_channels_stay() {
        // Harmonic between two ends 80 pixels apart: a ramp.
        let (w, h) = (82, 5);
        let is_end = |x: usize| x == 0 || x == w - 1;
        let ramp = |x: usize| x as f32 / (w - 1) as f32;
        let mut values = Plane::from_fn(w, h, |x, _| match is_end(x) {
            true => Vec3::new(ramp(x), ramp(x), 7.0),
            false => Vec3::new(5.0, 5.0, 7.0),
        });
        let unknown = Plane::from_fn(w, h, |x, _| BVec3::new(!is_end(x), !is_end(x), false));
        let points = Points(Plane::filled(w, h, Vec3::NEG_Z));
        let normal = Normal(Plane::filled(w, h, Vec3::Z));
        inpaint_surfaces(&mut values, unknown, (&points, &normal), |_, _| (Vec3::ZERO, 1.0));
        for (i, value) in values.pixels().iter().enumerate() {
            let want = Vec3::new(ramp(i % w), ramp(i % w), 7.0);
            assert!((*value - want).abs().max_element() < 5e-3, "{i}: {value} for {want}");
        }
    }

    #[test]
    fn nothing_known_changes_nothing() {
        let mut values = Plane::filled(3, 2, Vec3::ONE);
        let points = Points(Plane::filled(3, 2, Vec3::NEG_Z));
        inpaint_surfaces(
            &mut values,
            Plane::filled(3, 2, BVec3::TRUE),
            (&points, &Normal(Plane::filled(3, 2, Vec3::Z))),
            |_, _| (Vec3::ZERO, 1.0),
        );
        assert_eq!(values, Plane::filled(3, 2, Vec3::ONE));
    }
}
