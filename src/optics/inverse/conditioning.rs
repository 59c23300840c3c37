//! Conditioning of a fit: the condition number of its columns, and the two that are hardest to
//! distinguish.

use crate::tuning::tuning;

tuning! {
    /// Constants of the condition number of a fit.
    pub const TUNING: ConditioningTuning {
        /// Condition number of equal columns.
        max_number: f64 = 1e15,
            unit "1", source Derived("inverse of the accuracy of 64 bits"),
            effect "a larger value reports numbers that are rounding";
        /// Sweeps of Jacobi rotations.
        sweeps: usize = 30,
            unit "sweeps", source Taste, effect "a smaller value may end before all eigenvalues are exact";
        /// Entry beside the diagonal below which its rotation is left out.
        max_off_diagonal: f64 = 1e-15,
            unit "1, columns have unit length", source Derived("accuracy of 64 bits"),
            effect "a larger value makes eigenvalues less exact";
        /// Least eigenvalue by which the largest one is divided.
        min_eigenvalue: f64 = 1e-15,
            unit "the largest eigenvalue", source Derived("accuracy of 64 bits"),
            effect "a smaller value reports numbers that are rounding";
    }
}

/// Condition number of a symmetric positive semi-definite matrix whose columns are scaled to unit
/// length, and its cause.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditioning {
    /// Largest over smallest eigenvalue, 1..=1e15; 1 for fewer than two columns.
    pub number: f64,
    /// The two columns of largest weight in the weakest direction, lower index first: moving light
    /// between them changes the photo least.
    pub most_correlated: Option<[usize; 2]>,
    /// Cosine between these two, -1..=1.
    pub correlation: f64,
}

impl Default for Conditioning {
    fn default() -> Conditioning {
        Conditioning { number: 1.0, most_correlated: None, correlation: 0.0 }
    }
}

impl Conditioning {
    /// Conditioning of columns of which these two are equal.
    pub fn of_equals(most_correlated: [usize; 2]) -> Conditioning {
        Conditioning {
            number: TUNING.max_number,
            most_correlated: Some(most_correlated),
            correlation: 1.0,
        }
    }
}

/// Conditioning of a k x k Gram matrix, row by row, by Jacobi rotations. Columns of length 0 are
/// left out. A factor on a column changes nothing: a light that is 1e6 times weaker is not harder
/// to distinguish.
pub fn conditioning(gram: &[f64], k: usize) -> Conditioning {
    let used: Vec<usize> = (0..k).filter(|&i| gram[i * k + i] > 0.0).collect();
    let m = used.len();
    if m < 2 {
        return Conditioning::default();
    }
    let length = |i: usize| gram[i * k + i].sqrt();
    let cosine = |i: usize, j: usize| gram[i * k + j] / length(i) / length(j);
    let mut a: Vec<f64> =
        used.iter().flat_map(|&i| used.iter().map(move |&j| cosine(i, j))).collect();
    // Columns of `v` become the eigenvectors.
    let mut v: Vec<f64> = (0..m * m).map(|i| f64::from(u8::from(i / m == i % m))).collect();
    for _ in 0..TUNING.sweeps {
        for (p, q) in (0..m).flat_map(|p| (p + 1..m).map(move |q| (p, q))) {
            if a[p * m + q].abs() < TUNING.max_off_diagonal {
                continue;
            }
            let theta = 0.5 * (a[q * m + q] - a[p * m + p]) / a[p * m + q];
            let t =
                if theta == 0.0 { 1.0 } else { theta.signum() / (theta.abs() + theta.hypot(1.0)) };
            let (cos, sin) = (1.0 / t.hypot(1.0), t / t.hypot(1.0));
            let turn = |x: f64, y: f64| (cos * x - sin * y, sin * x + cos * y);
            for i in 0..m {
                (a[i * m + p], a[i * m + q]) = turn(a[i * m + p], a[i * m + q]);
                (v[i * m + p], v[i * m + q]) = turn(v[i * m + p], v[i * m + q]);
            }
            for i in 0..m {
                (a[p * m + i], a[q * m + i]) = turn(a[p * m + i], a[q * m + i]);
            }
        }
    }
    let eigenvalue = |i: usize| a[i * m + i];
    let weakest = (0..m).fold(0, |low, i| if eigenvalue(i) < eigenvalue(low) { i } else { low });
    let strongest = (0..m).map(eigenvalue).fold(0.0, f64::max);
    let mut order: Vec<usize> = (0..m).collect();
    order.sort_by(|&i, &j| v[j * m + weakest].abs().total_cmp(&v[i * m + weakest].abs()));
    let [i, j] = [used[order[0].min(order[1])], used[order[0].max(order[1])]];
    Conditioning {
        number: strongest / eigenvalue(weakest).max(TUNING.min_eigenvalue * strongest),
        most_correlated: Some([i, j]),
        correlation: cosine(i, j),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_columns_are_their_closed_form_at_any_scale() {
        // Unit columns at angle t: eigenvalues 1 +- cos t.
        let c = 0.6;
        for s in [1e-9, 1.0, 1e9] {
            let got = conditioning(&[4.0, 2.0 * 3.0 * c * s, 2.0 * 3.0 * c * s, 9.0 * s * s], 2);
            assert!((got.number - (1.0 + c) / (1.0 - c)).abs() < 1e-9, "{got:?}");
            assert!(
                got.most_correlated == Some([0, 1]) && (got.correlation - c).abs() < 1e-12,
                "{got:?}"
            );
        }
    }

    #[test]
    fn the_pair_that_looks_alike_is_named_among_others() {
        // Columns 1 and 3 at a cosine of 1 - 1e-6, 2 empty, 0 across.
        let near = 1.0 - 1e-6;
        let mut gram = vec![0.0; 16];
        for (i, j, g) in [(0, 0, 5.0), (1, 1, 1.0), (3, 3, 1.0), (1, 3, near), (3, 1, near)] {
            gram[i * 4 + j] = g;
        }
        let got = conditioning(&gram, 4);
        assert_eq!(got.most_correlated, Some([1, 3]));
        assert!((got.number * 1e-6 / (1.0 + near) - 1.0).abs() < 1e-9, "{got:?}");
    }

    #[test]
    fn nothing_one_and_equal_columns_are_sound() {
        assert_eq!(conditioning(&[], 0), Conditioning::default());
        assert_eq!(conditioning(&[0.0, 0.0, 0.0, 2.0], 2), Conditioning::default());
        let equal = conditioning(&[1.0; 4], 2);
        assert!(
            (1e14..=1e15).contains(&equal.number) && equal.most_correlated == Some([0, 1]),
            "{equal:?}"
        );
    }
}
