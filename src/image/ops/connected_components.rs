//! What hangs together.

use crate::image::Plane;

/// The parts of `set` that hang together over sides and corners, as pixel indices from small to large, in the order of their first
/// pixels.
pub fn parts(set: &Plane<bool>) -> Vec<Vec<usize>> {
    let (w, h) = set.size();
    let mut left = set.clone();
    let mut parts = Vec::new();
    for start in 0..w * h {
        if !left.pixels()[start] {
            continue;
        }
        left.pixels_mut()[start] = false;
        let mut part = vec![start];
        let mut next = 0;
        while next < part.len() {
            let (cx, cy) = (part[next] % w, part[next] / w);
            next += 1;
            for y in cy.saturating_sub(1)..(cy + 2).min(h) {
                for x in cx.saturating_sub(1)..(cx + 2).min(w) {
                    if left.get(x, y) {
                        left.set(x, y, false);
                        part.push(y * w + x);
                    }
                }
            }
        }
        part.sort_unstable();
        parts.push(part);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_join_and_gaps_part() {
        let rows = ["#..##", ".#..#", "....#", "##..."];
        let set = Plane::from_fn(5, 4, |x, y| rows[y].as_bytes()[x] == b'#');
        assert_eq!(parts(&set), [vec![0, 6], vec![3, 4, 9, 14], vec![15, 16]]);
        assert!(parts(&Plane::filled(3, 3, false)).is_empty());
        assert_eq!(parts(&Plane::filled(1, 1, true)), [vec![0]]);
    }
}
