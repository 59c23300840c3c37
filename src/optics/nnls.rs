//! Non-negative least squares on the normal equations, for the few columns that lights make.

/// Minimises `x' G x / 2 - b' x` over `x >= 0`, with `gram` = G symmetric positive semi-definite (row-major, n x n).
///
/// Active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), on the normal equations as
/// in Bro and de Jong 1997. A column without weight in G stays 0. The answer meets the Karush-Kuhn-Tucker conditions to
/// about 1e-10 of the largest gradient; ties go to the lowest index, so that the answer is deterministic.
pub fn nnls(gram: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    assert_eq!(gram.len(), n * n, "the Gram matrix is n x n");
    let mut x = vec![0.0; n];
    let mut free = vec![false; n];
    let scale = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let tolerance = 1e-10 * scale;
    // Each pass frees one column; cycling is impossible in exact arithmetic, the bound guards rounding.
    for _ in 0..4 * n + 4 {
        let gradient = |i: usize| b[i] - (0..n).map(|j| gram[i * n + j] * x[j]).sum::<f64>();
        let entering = (0..n)
            .filter(|&i| !free[i] && gram[i * n + i] > 0.0)
            .map(|i| (i, gradient(i)))
            .filter(|&(_, g)| g > tolerance)
            .fold(None, |best: Option<(usize, f64)>, c| if best.is_none_or(|b| c.1 > b.1) { Some(c) } else { best });
        let Some((entering, _)) = entering else { break };
        free[entering] = true;
        loop {
            let Some(z) = solve_free(gram, b, &free) else {
                // Linearly dependent on the free columns: it adds nothing.
                free[entering] = false;
                break;
            };
            if (0..n).all(|i| !free[i] || z[i] > 0.0) {
                x = z;
                break;
            }
            let step = (0..n)
                .filter(|&i| free[i] && z[i] <= 0.0)
                .map(|i| x[i] / (x[i] - z[i]))
                .fold(1.0f64, |a, t| if t.is_finite() { a.min(t) } else { 0.0 });
            for i in 0..n {
                if free[i] {
                    x[i] += step * (z[i] - x[i]);
                    if x[i] <= 1e-14 * scale.max(1.0) && z[i] <= 0.0 {
                        x[i] = 0.0;
                        free[i] = false;
                    }
                }
            }
            if !free.iter().any(|&f| f) {
                break;
            }
        }
    }
    x
}

/// The unconstrained minimum over the free columns by Cholesky; `None` when they are linearly dependent.
fn solve_free(gram: &[f64], b: &[f64], free: &[bool]) -> Option<Vec<f64>> {
    let n = b.len();
    let index: Vec<usize> = (0..n).filter(|&i| free[i]).collect();
    let m = index.len();
    let mut l = vec![0.0; m * m];
    for i in 0..m {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| l[i * m + k] * l[j * m + k]).sum();
            let value = gram[index[i] * n + index[j]] - dot;
            if i == j {
                if value <= 1e-13 * gram[index[i] * n + index[i]] {
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
    use proptest::prelude::*;

    fn gram_of(columns: &[Vec<f64>], y: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gram = columns.iter().flat_map(|a| columns.iter().map(|b| dot(a, b)).collect::<Vec<_>>()).collect();
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

    proptest! {
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
