//! Non-negative least squares on the normal equations, for the few columns of the light fit.

use crate::tuning::tuning;

tuning! {
    /// Constants of non-negative least squares.
    pub const TUNING: NnlsTuning {
        /// Gradient above which a column enters.
        tolerance: f64 = 1e-14,
            unit "the largest entry of the right side, columns scaled to unit length",
            source Derived("rounding of 64 bits"),
            effect "a larger value leaves weak columns at zero";
        /// Pivot of the Cholesky factorization below which columns are linearly dependent.
        min_pivot: f64 = 1e-13,
            unit "the diagonal", source Derived("rounding of 64 bits"),
            effect "a larger value drops nearly equal columns";
        /// Largest number of passes, each of which frees one column.
        passes: usize = 6,
            unit "passes per column", source Derived("cycling is impossible in exact arithmetic"),
            effect "none but where rounding cycles";
    }
}

/// Minimizes `x' G x / 2 - b' x` over `x >= 0`, with `gram` = G symmetric positive semi-definite
/// (row by row, n x n).
///
/// Active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), on
/// the normal equations as in Bro and de Jong 1997. Each column is scaled to unit length: a factor
/// on a column divides its weight. A column of length 0, and one that depends on columns already
/// taken, stays 0. The solution meets the Karush-Kuhn-Tucker conditions to about 1e-14 of the
/// largest gradient. Ties go to the lowest index, so that the solution is deterministic.
///
/// # Panics
///
/// When `gram` is not n x n for a `b` of length n.
pub fn nnls(gram: &[f64], b: &[f64]) -> Vec<f64> {
    nnls_from(gram, b, &vec![0.0; b.len()])
}

/// The same, with the columns free at the start that have weight in `start`, which is >= 0. Near
/// the solution a few steps are enough, where [`nnls`] takes one and a factorization for each
/// column that has weight.
///
/// # Panics
///
/// When `gram` is not n x n, or `start` is shorter than `b`.
pub fn nnls_from(gram: &[f64], b: &[f64], start: &[f64]) -> Vec<f64> {
    let n = b.len();
    assert_eq!(gram.len(), n * n, "the Gram matrix is n x n");
    let shrink = |i: usize| if gram[i * n + i] > 0.0 { 1.0 / gram[i * n + i].sqrt() } else { 0.0 };
    let shrink: Vec<f64> = (0..n).map(shrink).collect();
    let gram: Vec<f64> = (0..n * n).map(|at| gram[at] * shrink[at / n] * shrink[at % n]).collect();
    let b: Vec<f64> = b.iter().zip(&shrink).map(|(b, s)| b * s).collect();
    let tolerance = TUNING.tolerance * b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut x: Vec<f64> =
        (0..n).map(|i| if shrink[i] > 0.0 { start[i] / shrink[i] } else { 0.0 }).collect();
    let mut free: Vec<bool> = x.iter().map(|&x| x > 0.0).collect();
    match free.contains(&true).then(|| solve_free(&gram, &b, &free)) {
        Some(Some(z)) => retreat(&gram, &b, &mut free, &mut x, z),
        // Columns that depend on each other: the cold start.
        Some(None) => (x, free) = (vec![0.0; n], vec![false; n]),
        None => {}
    }
    // Columns that cannot enter as long as the same columns are free.
    let mut barred: Vec<bool> = shrink.iter().map(|&s| s == 0.0).collect();
    // Each pass frees one column; cycling is impossible in exact arithmetic, the bound guards
    // rounding.
    for _ in 0..TUNING.passes * (n + 1) {
        let gradient = |i: usize| b[i] - (0..n).map(|j| gram[i * n + j] * x[j]).sum::<f64>();
        let entering = (0..n)
            .filter(|&i| !free[i] && !barred[i])
            .map(|i| (i, gradient(i)))
            .filter(|&(_, g)| g > tolerance)
            .fold(
                None,
                |best: Option<(usize, f64)>, c| {
                    if best.is_none_or(|b| c.1 > b.1) { Some(c) } else { best }
                },
            );
        let Some((entering, _)) = entering else { break };
        free[entering] = true;
        match solve_free(&gram, &b, &free) {
            Some(z) if z[entering] > 0.0 => {
                retreat(&gram, &b, &mut free, &mut x, z);
                barred = shrink.iter().map(|&s| s == 0.0).collect();
            }
            _ => {
                free[entering] = false;
                barred[entering] = true;
            }
        }
    }
    x.iter().zip(&shrink).map(|(x, s)| x * s).collect()
}

/// Moves `x` toward `z`, the minimum over the free columns, and fixes at 0 those that would become
/// negative on the way.
fn retreat(gram: &[f64], b: &[f64], free: &mut [bool], x: &mut Vec<f64>, mut z: Vec<f64>) {
    let n = b.len();
    loop {
        let step = (0..n).filter(|&i| free[i] && z[i] <= 0.0).map(|i| (i, x[i] / (x[i] - z[i])));
        let Some((first, step)) = step.reduce(|a, t| if t.1 < a.1 { t } else { a }) else { break };
        (0..n).filter(|&i| free[i]).for_each(|i| x[i] = (x[i] + step * (z[i] - x[i])).max(0.0));
        (x[first], free[first]) = (0.0, false);
        match solve_free(gram, b, free) {
            Some(solved) => z = solved,
            None => return,
        }
    }
    *x = z;
}

/// The unconstrained minimum over the free columns by Cholesky; `None` when they are linearly
/// dependent.
pub(in crate::optics) fn solve_free(gram: &[f64], b: &[f64], free: &[bool]) -> Option<Vec<f64>> {
    let n = b.len();
    let index: Vec<usize> = (0..n).filter(|&i| free[i]).collect();
    let m = index.len();
    let mut l = vec![0.0; m * m];
    for i in 0..m {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| l[i * m + k] * l[j * m + k]).sum();
            let value = gram[index[i] * n + index[j]] - dot;
            if i == j {
                if value <= TUNING.min_pivot * gram[index[i] * n + index[i]] {
                    return None;
                }
                l[i * m + i] = value.sqrt();
            } else {
                l[i * m + j] = value / l[j * m + j];
            }
        }
    }
    let mut y = vec![0.0; m];
    for i in 0..m {
        let dot: f64 = (0..i).map(|k| l[i * m + k] * y[k]).sum();
        y[i] = (b[index[i]] - dot) / l[i * m + i];
    }
    for i in (0..m).rev() {
        let dot: f64 = (i + 1..m).map(|k| l[k * m + i] * y[k]).sum();
        y[i] = (y[i] - dot) / l[i * m + i];
    }
    let mut x = vec![0.0; n];
    for (k, &i) in index.iter().enumerate() {
        x[i] = y[k];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::rows::{Rows, enumerated};
    use proptest::prelude::*;

    fn gram_of(columns: &[Vec<f64>], y: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gram = columns
            .iter()
            .flat_map(|a| columns.iter().map(|b| dot(a, b)).collect::<Vec<_>>())
            .collect();
        (gram, columns.iter().map(|a| dot(a, y)).collect())
    }

    #[test]
    fn recovers_positive_weights_and_clamps_negative_ones() {
        let columns = vec![vec![1.0, 0.0, 1.0], vec![0.0, 1.0, 1.0]];
        let (gram, b) = gram_of(&columns, &[2.0, 3.0, 5.0]);
        let x = nnls(&gram, &b);
        assert!((x[0] - 2.0).abs() < 1e-12 && (x[1] - 3.0).abs() < 1e-12, "{x:?}");
        let (gram, b) = gram_of(&columns, &[2.0, -3.0, 0.0]);
        // With the second weight at 0 the first alone is (2 + 0) / 2 = 1.
        let x = nnls(&gram, &b);
        assert!((x[0] - 1.0).abs() < 1e-12 && x[1] == 0.0, "{x:?}");
    }

    #[test]
    fn empty_zero_and_equal_columns_are_sound() {
        assert!(nnls(&[], &[]).is_empty());
        assert_eq!(nnls(&[0.0], &[0.0]), vec![0.0]);
        let (gram, b) = gram_of(&[vec![1.0, 2.0], vec![1.0, 2.0]], &[2.0, 4.0]);
        assert_eq!(nnls(&gram, &b), vec![2.0, 0.0]);
    }

    fn rows_of(columns: &[Vec<f64>], y: &[f64]) -> Rows {
        (0..y.len()).map(|r| columns.iter().map(|c| c[r]).chain([y[r]]).collect()).collect()
    }

    /// A column that depends on one already taken must not keep others from entering.
    #[test]
    fn a_dependent_column_bars_no_other() {
        let first = vec![1.0, 1.0, 0.0, 0.0];
        let again = vec![1.0 + 1e-8, 1.0 - 1e-8, 0.0, 0.0];
        let third = vec![0.0, 0.0, 1e-12, 0.0];
        let (gram, b) = gram_of(&[first, again, third], &[3.0, 1.0, 1e-9, 0.0]);
        let x = nnls(&gram, &b);
        assert!((x[2] - 1e3).abs() < 1e-6, "{x:?}");
    }

    /// Sums in 64 bits lose 1e-16 / d^2 of columns that differ by a share d, which is less than the
    /// 6e-8 / d that their 32 bits do.
    #[test]
    fn normal_equations_lose_less_than_the_layers_rounding() {
        for d in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6] {
            let column = |at: f64| {
                (0..500)
                    .map(move |p| f64::from((1.0 / (0.3 + (p as f64 / 500.0 - at).powi(2))) as f32))
            };
            let columns: Vec<Vec<f64>> = vec![column(0.0).collect(), column(d).collect()];
            let y: Vec<f64> = (0..500).map(|p| 0.3 * columns[0][p] + 0.2 * columns[1][p]).collect();
            let (gram, b) = gram_of(&columns, &y);
            let (got, want) = (nnls(&gram, &b), enumerated(&rows_of(&columns, &y)));
            let off = (0..2).map(|i| (got[i] - want[i]).abs()).fold(0.0, f64::max);
            assert!(off < 6e-8 / d, "{d:e}: off by {off:e}: {got:?} against {want:?}");
        }
    }

    proptest! {
        /// All sets of active bounds, each solved by QR: the weights do not depend on the columns'
        /// scales.
        #[test]
        fn agrees_with_every_active_set(k in 1usize..=5, data in proptest::collection::vec(-1.0f64..1.0, 40),
            y in proptest::collection::vec(-1.0f64..1.0, 8), powers in proptest::collection::vec(-6i32..=6, 5))
        {
            let columns: Vec<Vec<f64>> = data.chunks(8).take(k).zip(&powers)
                .map(|(column, &power)| column.iter().map(|v| v * 10f64.powi(power)).collect()).collect();
            let (gram, b) = gram_of(&columns, &y);
            let (got, want) = (nnls(&gram, &b), enumerated(&rows_of(&columns, &y)));
            for i in 0..k {
                // Five random columns of 8 have condition numbers up to some 1e3; squared, 1e-16 x
                // 1e6.
                let scale = 10f64.powi(powers[i]);
                prop_assert!((got[i] - want[i]).abs() * scale < 1e-8, "{got:?} against {want:?}");
            }
        }

        /// Wherever it begins, it ends at the same weights.
        #[test]
        fn the_start_does_not_matter(data in proptest::collection::vec(-1.0f64..1.0, 60), y in proptest::collection::vec(-1.0f64..1.0, 12),
            start in proptest::collection::vec(-1.0f64..2.0, 5))
        {
            let columns: Vec<Vec<f64>> = data.chunks(12).map(<[f64]>::to_vec).collect();
            let (gram, b) = gram_of(&columns, &y);
            let start: Vec<f64> = start.iter().map(|v| v.max(0.0)).collect();
            let (got, want) = (nnls_from(&gram, &b, &start), nnls(&gram, &b));
            for i in 0..5 {
                prop_assert!((got[i] - want[i]).abs() < 1e-6, "{got:?} against {want:?}");
            }
        }

        /// Karush-Kuhn-Tucker: x >= 0, gradient <= 0 where x = 0, gradient = 0 where x > 0.
        #[test]
        fn meets_the_optimality_conditions(data in proptest::collection::vec(-1.0f64..1.0, 60), y in proptest::collection::vec(-1.0f64..1.0, 12)) {
            let columns: Vec<Vec<f64>> = data.chunks(12).map(<[f64]>::to_vec).collect();
            let (gram, b) = gram_of(&columns, &y);
            let x = nnls(&gram, &b);
            for i in 0..columns.len() {
                let gradient = b[i] - (0..columns.len()).map(|j| gram[i * columns.len() + j] * x[j]).sum::<f64>();
                prop_assert!(x[i] >= 0.0);
                prop_assert!(gradient < 1e-8, "gradient {gradient} at {i}");
                prop_assert!(x[i] == 0.0 || gradient.abs() < 1e-8, "gradient {gradient} at a free column");
            }
        }
    }
}
