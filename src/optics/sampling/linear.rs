//! The linear density on the unit interval.

/// The inverse of the distribution function on 0..1 whose density is linear from `a` at 0 to `b` at
/// 1; `a`, `b` >= 0.
///
/// `u` is in 0..1; the result is in 0..1. Where both ends are zero, the density counts as uniform.
pub fn invert_linear(u: f64, a: f64, b: f64) -> f64 {
    let root = (a * a + u * (b * b - a * a)).max(0.0).sqrt();
    let sum = a + root;
    if sum > 0.0 { (u * (a + b) / sum).min(1.0) } else { u }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distribution_function_gives_u_back() {
        for (a, b) in [(0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.2, 3.0), (5.0, 1e-3)] {
            for u in [0.0, 1e-6, 0.3, 0.5, 0.99, 1.0] {
                let x = invert_linear(u, a, b);
                let below = (a * x + 0.5 * (b - a) * x * x) / (0.5 * (a + b));
                assert!((below - u).abs() < 1e-12, "{a} {b} {u}: {x}");
            }
        }
        assert_eq!(invert_linear(0.4, 0.0, 0.0), 0.4, "nothing anywhere counts as uniform");
    }
}
