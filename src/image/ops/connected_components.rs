//! Connected components of a set of pixels.

use crate::image::Plane;

/// The 8-connected components of `set`: pixel indices in rising order, components in the order of
/// their first pixels.
pub fn connected_components(set: &Plane<bool>) -> Vec<Vec<usize>> {
    let (w, h) = set.size();
    let mut left = set.clone();
    let mut components = Vec::new();
    for start in 0..w * h {
        if !left.pixels()[start] {
            continue;
        }
        left.pixels_mut()[start] = false;
        let mut component = vec![start];
        let mut next = 0;
        while next < component.len() {
            let (cx, cy) = (component[next] % w, component[next] / w);
            next += 1;
            for y in cy.saturating_sub(1)..(cy + 2).min(h) {
                for x in cx.saturating_sub(1)..(cx + 2).min(w) {
                    if left.get(x, y) {
                        left.set(x, y, false);
                        component.push(y * w + x);
                    }
                }
            }
        }
        component.sort_unstable();
        components.push(component);
    }
    components
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_join_and_gaps_part() {
        let rows = ["#..##", ".#..#", "....#", "##..."];
        let set = Plane::from_fn(5, 4, |x, y| rows[y].as_bytes()[x] == b'#');
        assert_eq!(connected_components(&set), [vec![0, 6], vec![3, 4, 9, 14], vec![15, 16]]);
        assert!(connected_components(&Plane::filled(3, 3, false)).is_empty());
        assert_eq!(connected_components(&Plane::filled(1, 1, true)), [vec![0]]);
    }
}
