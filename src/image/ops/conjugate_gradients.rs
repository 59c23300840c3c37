//! Conjugate gradients.

/// Moves `x` to the solution of A x = b by conjugate gradients with the `diagonal` of A as
/// preconditioner (Hestenes and Stiefel 1952), until the energy of the residual r, which is r . r /
/// diagonal, is at most `enough` of that at the beginning.
///
/// A is symmetric and not negative, `product(p)` is A p, and `residual` is b - A x. The diagonal is
/// above 0.
pub fn conjugate_gradients(
    x: &mut [f32],
    mut residual: Vec<f32>,
    diagonal: &[f32],
    (enough, iterations): (impl Fn(f64) -> f64, usize),
    mut product: impl FnMut(&[f32]) -> Vec<f32>,
) {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let precondition =
        |r: &[f32]| -> Vec<f32> { r.iter().zip(diagonal).map(|(r, d)| r / d).collect() };
    let mut z = precondition(&residual);
    let mut along = z.clone();
    let mut energy = dot(&residual, &z);
    let enough = enough(energy);
    for _ in 0..iterations {
        if energy <= enough {
            break;
        }
        let image = product(&along);
        let curvature = dot(&along, &image);
        if curvature <= 0.0 {
            break; // Nothing is left to gain.
        }
        let length = (energy / curvature) as f32;
        x.iter_mut().zip(&along).for_each(|(x, &p)| *x += length * p);
        residual.iter_mut().zip(&image).for_each(|(r, l)| *r -= length * l);
        z = precondition(&residual);
        let next = dot(&residual, &z);
        let keep = (next / energy) as f32;
        along.iter_mut().zip(&z).for_each(|(p, z)| *p = z + keep * *p);
        energy = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_system_is_solved_in_as_many_steps_as_it_has_unknowns() {
        let a = [[4.0, 1.0, 0.0], [1.0, 3.0, -1.0], [0.0, -1.0, 2.0]];
        let times = |p: &[f32]| -> Vec<f32> {
            a.iter().map(|row| row.iter().zip(p).map(|(a, p)| a * p).sum()).collect()
        };
        let want = [1.0, -2.0, 0.5];
        let mut x = [0.0; 3];
        conjugate_gradients(&mut x, times(&want), &[4.0, 3.0, 2.0], (|_| 0.0, 3), times);
        for (got, want) in x.into_iter().zip(want) {
            assert!((got - want).abs() < 1e-5, "{got} for {want}");
        }
    }

    #[test]
    fn a_solution_and_a_direction_without_curvature_stay() {
        let mut x = [3.0, 4.0];
        let none = |_: &[f32]| vec![0.0; 2];
        conjugate_gradients(&mut x, vec![0.0; 2], &[1.0; 2], (|_| 0.0, 9), none);
        conjugate_gradients(&mut x, vec![1.0; 2], &[1.0; 2], (|_| 0.0, 9), none);
        assert_eq!(x, [3.0, 4.0]);
    }
}
