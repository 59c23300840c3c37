//! Least squares by rows, slow and simple: the reference for solvers of the normal equations.

/// A dense system, the right side as the last entry of each row.
pub type Rows = Vec<Vec<f64>>;

/// Columns `free` of the rows, reduced by Householder reflections to an upper triangle and the
/// residual.
fn triangle(rows: &Rows, free: &[usize]) -> Rows {
    let right = rows[0].len() - 1;
    let mut a: Rows =
        rows.iter().map(|row| free.iter().chain([&right]).map(|&j| row[j]).collect()).collect();
    for j in 0..free.len().min(a.len()) {
        let mut v: Vec<f64> = a[j..].iter().map(|row| row[j]).collect();
        v[0] += v.iter().map(|x| x * x).sum::<f64>().sqrt().copysign(v[0]);
        let norm: f64 = v.iter().map(|x| x * x).sum();
        for c in (j..=free.len()).filter(|_| norm > 0.0) {
            let dot: f64 = v.iter().zip(&a[j..]).map(|(v, row)| v * row[c]).sum();
            v.iter().zip(&mut a[j..]).for_each(|(v, row)| row[c] -= 2.0 * v * dot / norm);
        }
    }
    a.truncate(free.len() + 1);
    a
}

/// Least squares over columns `free`; the others are 0.
fn least_squares(rows: &Rows, free: &[usize]) -> Vec<f64> {
    let (a, m) = (triangle(rows, free), free.len());
    let mut x = vec![0.0; rows[0].len() - 1];
    for j in (0..m).rev() {
        let known: f64 = (j + 1..m).map(|c| a[j][c] * x[free[c]]).sum();
        x[free[j]] = (a[j][m] - known) / a[j][j];
    }
    x
}

/// Non-negative least squares: of all sets of columns that may be above 0, the feasible one of
/// least misfit.
pub fn enumerated(rows: &Rows) -> Vec<f64> {
    let k = rows[0].len() - 1;
    let all: Vec<usize> = (0..k).collect();
    let small = triangle(rows, &all);
    let free = least_squares(&small, &all);
    if free.iter().all(|x| *x >= 0.0) {
        return free;
    }
    let misfit = |x: &[f64]| -> f64 {
        small
            .iter()
            .map(|row| (row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>() - row[k]).powi(2))
            .sum()
    };
    let sets = (0..1usize << k)
        .map(|set| all.iter().copied().filter(|j| set >> j & 1 == 1).collect::<Vec<_>>());
    let tried =
        sets.map(|free| least_squares(&small, &free)).filter(|x| x.iter().all(|v| *v >= 0.0));
    tried
        .map(|x| (misfit(&x), x))
        .fold((f64::INFINITY, vec![]), |a, b| if b.0 < a.0 { b } else { a })
        .1
}
