//! Random numbers without state: a hash of (seed, pixel, stream) scrambles a low-discrepancy
//! sequence.

/// The four-dimensional PCG hash of Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT
/// 9(3), 2020.
fn pcg4d(mut v: [u32; 4]) -> [u32; 4] {
    v = v.map(|x| x.wrapping_mul(1664525).wrapping_add(1013904223));
    let mix = |v: &mut [u32; 4]| {
        v[0] = v[0].wrapping_add(v[1].wrapping_mul(v[3]));
        v[1] = v[1].wrapping_add(v[2].wrapping_mul(v[0]));
        v[2] = v[2].wrapping_add(v[0].wrapping_mul(v[1]));
        v[3] = v[3].wrapping_add(v[1].wrapping_mul(v[2]));
    };
    mix(&mut v);
    v = v.map(|x| x ^ (x >> 16));
    mix(&mut v);
    v
}

/// A stream of points in the unit square: the Sobol sequence with Owen scrambling (Burley,
/// "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020). Each point alone is uniformly
/// distributed, any first 2^k of a stream are evenly spread, and the streams of different (seed,
/// pixel, stream) are independent of each other.
#[derive(Clone, Copy)]
pub struct Points2 {
    scramble: u32,
}

/// Length of a stream; later points repeat.
pub const STREAM: usize = 1 << 16;

impl Points2 {
    /// The stream of these numbers.
    pub fn new(seed: u64, pixel: u32, stream: u32) -> Points2 {
        let [scramble, ..] = pcg4d([seed as u32, (seed >> 32) as u32, pixel, stream]);
        Points2 { scramble }
    }

    /// The `i`th point, both coordinates in 0..1.
    pub fn get(&self, i: usize) -> [f64; 2] {
        self.in_turn(2 * i)
    }

    /// The `i`th of the points of this stream (even `i`) and of a second one (odd `i`) in turn.
    ///
    /// Each of the two is evenly spread, which every second point of one is not.
    pub fn in_turn(&self, i: usize) -> [f64; 2] {
        // Four axes cost as much as one.
        let [x, y, z, w] = sobol_burley::sample_4d((i / 2 % STREAM) as u32, 0, self.scramble);
        if i.is_multiple_of(2) { [x, y].map(f64::from) } else { [z, w].map(f64::from) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_points_are_uniform_and_sets_are_even() {
        let cells = |points: &mut dyn Iterator<Item = [f64; 2]>| {
            let mut count = [0u32; 64];
            for [x, y] in points {
                count[(8.0 * x) as usize + 8 * (8.0 * y) as usize] += 1;
            }
            count
        };
        // The third point of 64,000 pixels: chi-squared of 63 degrees of freedom, mean 63, sd 11.2.
        let single = cells(&mut (0..64_000).map(|pixel| Points2::new(9, pixel, 2).get(3)));
        let chi: f64 = single.iter().map(|&n| (f64::from(n) - 1000.0).powi(2) / 1000.0).sum();
        assert!(chi < 63.0 + 4.0 * 11.2, "{chi}");
        // 640 points of one pixel: far more even than chance, whose spread would be 3.2.
        let set = cells(&mut (0..640).map(|i| Points2::new(9, 5, 2).get(i)));
        assert!(set.iter().all(|&n| (7..=13).contains(&n)), "{set:?}");
    }

    #[test]
    fn the_first_points_of_a_stream_are_a_net() {
        for stream in 0..50 {
            let points = Points2::new(3, 11, stream);
            // Each of the 256 boxes of 1 / 2^a by 1 / 2^(8 - a) holds one of the first 256 points.
            for a in 0..=8 {
                let mut seen = [false; 256];
                for [x, y] in (0..256).map(|i| points.get(i)) {
                    let cell = (x * f64::from(1 << a)) as usize
                        + ((y * f64::from(1 << (8 - a))) as usize) * (1 << a);
                    assert!(!std::mem::replace(&mut seen[cell], true), "{stream} {a}");
                }
            }
        }
    }

    #[test]
    fn streams_have_nothing_to_do_with_each_other() {
        // The correlation of the means of neighboring streams over 8 points, of which the standard
        // error over 20,000 pairs is 0.7 %. The mean of f = (x - 1/2) (y - 1/2) is not evened out
        // by the points.
        let mean = |seed, pixel, stream| {
            let points = Points2::new(seed, pixel, stream);
            (0..8).map(|i| points.get(i)).map(|[x, y]| (x - 0.5) * (y - 0.5)).sum::<f64>() / 8.0
        };
        for step in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1 << 32, 0, 0), (0, 320, 0), (0, 1, 1)] {
            let (mut product, mut square) = (0.0, 0.0);
            for pixel in 0..20_000 {
                let (a, b) = (mean(5, pixel, 2), mean(5 + step.0, pixel + step.1, 2 + step.2));
                product += a * b;
                square += 0.5 * (a * a + b * b);
            }
            assert!((product / square).abs() < 4.0 * 0.0071, "{step:?}: {}", product / square);
        }
    }

    #[test]
    fn late_points_stay_in_the_square() {
        for i in [STREAM - 1, STREAM, 10 * STREAM + 7] {
            assert!(Points2::new(1, 2, 3).get(i).iter().all(|x| (0.0..1.0).contains(x)));
        }
    }
}
