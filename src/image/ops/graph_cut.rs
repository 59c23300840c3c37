//! Two labels on a picture by a minimum cut.
//!
//! Boykov and Jolly (ICCV 2001): labels x_p in {0, 1} that minimize
//! `sum_p u_p [x_p = 0] + sum_pq w_pq [x_p != x_q]`, where u_p is the gain of labeling a pixel 1
//! (negative: the cost) and the pairs are 8-neighbors, are the source's side of a minimum cut.
//! Found by the maximum flow of Boykov and Kolmogorov (PAMI 2004): two trees grow from the
//! terminals, each path where they touch is saturated, and the subtrees that this cuts off are
//! adopted again. Capacities are integers: no rounding decides a tie.

use std::collections::VecDeque;

use crate::image::Plane;

/// Steps to the eight neighbors, each beside its reverse: that of direction d is d ^ 1.
const STEPS: [(isize, isize); 8] =
    [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (-1, 1), (1, -1)];
/// Parents other than a direction: the terminal itself, and none.
const TERMINAL: u8 = 8;
const NONE: u8 = 9;

/// The labeling of least energy; of several, that with the fewest pixels labeled true. `gain`
/// holds u_p, and `weight(x, y, x', y')` gives w_pq >= 0 of two neighbors, the same for both
/// orders. Sums along a path must stay below 2^31.
pub fn graph_cut(
    gain: &Plane<i32>,
    weight: impl Fn(usize, usize, usize, usize) -> i32,
) -> Plane<bool> {
    let (width, height) = gain.size();
    let mut flow = Flow::new(gain, weight);
    while let Some(meeting) = flow.grow() {
        flow.augment(meeting);
        flow.adopt();
    }
    Plane::new(width, height, flow.tree.iter().map(|&tree| tree == Some(CutSide::Source)).collect())
}

#[derive(Clone, Copy, PartialEq)]
enum CutSide {
    Source,
    Sink,
}

struct Flow {
    width: usize,
    height: usize,
    /// Residual capacity from each pixel to its eight neighbors.
    left: Vec<[i32; 8]>,
    /// Residual capacity from the source (positive) or to the sink (negative).
    terminal: Vec<i32>,
    tree: Vec<Option<CutSide>>,
    /// Direction of the parent.
    parent: Vec<u8>,
    /// Pixels at the front of their tree.
    active: VecDeque<usize>,
    orphans: VecDeque<usize>,
    /// Steps to the terminal, as found in round `seen`: an upper bound that keeps searches for a
    /// root short.
    steps: Vec<u32>,
    seen: Vec<u32>,
    round: u32,
}

impl Flow {
    fn new(gain: &Plane<i32>, weight: impl Fn(usize, usize, usize, usize) -> i32) -> Flow {
        let (width, height) = gain.size();
        let terminal = gain.pixels().to_vec();
        let tree: Vec<Option<CutSide>> = terminal
            .iter()
            .map(|&t| match t {
                0 => None,
                1.. => Some(CutSide::Source),
                _ => Some(CutSide::Sink),
            })
            .collect();
        let mut flow = Flow {
            width,
            height,
            left: vec![[0; 8]; terminal.len()],
            parent: tree.iter().map(|tree| if tree.is_some() { TERMINAL } else { NONE }).collect(),
            active: (0..terminal.len()).filter(|&i| tree[i].is_some()).collect(),
            orphans: VecDeque::new(),
            steps: vec![1; terminal.len()],
            seen: vec![0; terminal.len()],
            round: 0,
            terminal,
            tree,
        };
        for i in 0..flow.left.len() {
            for d in 0..8 {
                if let Some(j) = flow.neighbor(i, d) {
                    flow.left[i][d as usize] = weight(i % width, i / width, j % width, j / width);
                }
            }
        }
        flow
    }

    fn neighbor(&self, i: usize, d: u8) -> Option<usize> {
        let (dx, dy) = STEPS[d as usize];
        let (x, y) =
            ((i % self.width).checked_add_signed(dx)?, (i / self.width).checked_add_signed(dy)?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// The neighbor in the direction of a parent or of an arc with capacity, which is there.
    fn along(&self, i: usize, d: u8) -> usize {
        self.neighbor(i, d).expect("parents and arcs with capacity lie in the picture")
    }

    /// Capacity by which `i` can hang below its neighbor `j` in direction `d`, in the tree of this
    /// side.
    fn feeds(&self, side: CutSide, i: usize, j: usize, d: u8) -> i32 {
        match side {
            CutSide::Source => self.left[j][(d ^ 1) as usize],
            CutSide::Sink => self.left[i][d as usize],
        }
    }

    /// Lets the trees grow until they touch: (pixel of the source's tree, direction to one of the
    /// sink's).
    fn grow(&mut self) -> Option<(usize, u8)> {
        while let Some(&i) = self.active.front() {
            if let Some(side) = self.tree[i] {
                for d in 0..8 {
                    let Some(j) = self.neighbor(i, d) else { continue };
                    if self.feeds(side, j, i, d ^ 1) <= 0 {
                        continue;
                    }
                    match self.tree[j] {
                        None => {
                            self.tree[j] = Some(side);
                            self.parent[j] = d ^ 1;
                            (self.steps[j], self.seen[j]) = (self.steps[i] + 1, self.seen[i]);
                            self.active.push_back(j);
                        }
                        Some(other) if other != side => {
                            return Some(if side == CutSide::Source { (i, d) } else { (j, d ^ 1) });
                        }
                        Some(_) => {}
                    }
                }
            }
            self.active.pop_front();
        }
        None
    }

    /// Augments the flow along the path over this arc by its bottleneck capacity.
    fn augment(&mut self, (from, d): (usize, u8)) {
        let to = self.along(from, d);
        let mut most = self.left[from][d as usize];
        for (side, start) in [(CutSide::Source, from), (CutSide::Sink, to)] {
            let mut i = start;
            while self.parent[i] != TERMINAL {
                let (up, p) = (self.along(i, self.parent[i]), self.parent[i]);
                most = most.min(self.feeds(side, i, up, p));
                i = up;
            }
            most = most.min(self.terminal[i].abs());
        }
        self.left[from][d as usize] -= most;
        self.left[to][(d ^ 1) as usize] += most;
        for (side, start) in [(CutSide::Source, from), (CutSide::Sink, to)] {
            let mut i = start;
            while self.parent[i] != TERMINAL {
                let (up, p) = (self.along(i, self.parent[i]), self.parent[i]);
                let (tail, arc) = if side == CutSide::Source { (up, p ^ 1) } else { (i, p) };
                let head = if side == CutSide::Source { i } else { up };
                self.left[tail][arc as usize] -= most;
                self.left[head][(arc ^ 1) as usize] += most;
                if self.left[tail][arc as usize] == 0 {
                    self.tear_off(i);
                }
                i = up;
            }
            self.terminal[i] -= if side == CutSide::Source { most } else { -most };
            if self.terminal[i] == 0 {
                self.tear_off(i);
            }
        }
    }

    fn tear_off(&mut self, i: usize) {
        self.parent[i] = NONE;
        self.orphans.push_back(i);
    }

    /// Gives every orphan a new parent in its own tree, or sets it free.
    fn adopt(&mut self) {
        self.round += 1;
        while let Some(i) = self.orphans.pop_front() {
            let side = self.tree[i].expect("an orphan was in a tree");
            let mut best = None;
            for d in 0..8 {
                let Some(j) = self.neighbor(i, d) else { continue };
                if self.tree[j] == Some(side)
                    && self.feeds(side, i, j, d) > 0
                    && let Some(steps) = self.rooted(j)
                    && best.is_none_or(|(least, _)| steps < least)
                {
                    best = Some((steps, d));
                }
            }
            if let Some((steps, d)) = best {
                self.parent[i] = d;
                (self.steps[i], self.seen[i]) = (steps + 1, self.round);
                continue;
            }
            self.tree[i] = None;
            for d in 0..8 {
                let Some(j) = self.neighbor(i, d) else { continue };
                if self.tree[j] != Some(side) {
                    continue;
                }
                if self.feeds(side, i, j, d) > 0 {
                    self.active.push_back(j);
                }
                if self.parent[j] == d ^ 1 {
                    self.tear_off(j);
                }
            }
        }
    }

    /// Steps from `i` to its terminal, or `None` below an orphan; remembered for this round.
    fn rooted(&mut self, i: usize) -> Option<u32> {
        let (mut at, mut walked) = (i, 0);
        let total = loop {
            if self.seen[at] == self.round {
                break walked + self.steps[at];
            }
            match self.parent[at] {
                NONE => return None,
                TERMINAL => break walked + 1,
                d => at = self.along(at, d),
            }
            walked += 1;
        };
        let (mut at, mut steps) = (i, total);
        while self.seen[at] != self.round {
            (self.steps[at], self.seen[at]) = (steps, self.round);
            if self.parent[at] == TERMINAL {
                break;
            }
            at = self.along(at, self.parent[at]);
            steps -= 1;
        }
        Some(total)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    type Weight = dyn Fn(usize, usize, usize, usize) -> i32;

    /// `sum_p u_p [x_p = 0] + sum_pq w_pq [x_p != x_q]`, each pair once.
    fn energy(gain: &Plane<i32>, weight: &Weight, label: &Plane<bool>) -> i32 {
        let (w, h) = gain.size();
        let mut sum = 0;
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            sum += if label.get(x, y) { 0 } else { gain.get(x, y) };
            for (dx, dy) in [(1isize, 0), (0, 1), (1, 1), (-1, 1)] {
                let (nx, ny) = (x.wrapping_add_signed(dx), y + dy);
                if nx < w && ny < h && label.get(x, y) != label.get(nx, ny) {
                    sum += weight(x, y, nx, ny);
                }
            }
        }
        sum
    }

    fn hash(seed: u64, i: u64) -> u64 {
        let x = (seed ^ i).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        (x ^ (x >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 33
    }

    fn random_weight(seed: u64, most: u64) -> impl Fn(usize, usize, usize, usize) -> i32 {
        move |x, y, nx, ny| {
            let (a, b) = ((16 * y + x) as u64, (16 * ny + nx) as u64);
            (hash(seed, 1000 * a.min(b) + a.max(b)) % most) as i32
        }
    }

    proptest! {
        /// Against every labeling.
        #[test]
        fn no_labeling_has_less_energy(w in 1usize..5, h in 1usize..4, seed: u64, most in 1u64..40) {
            let gain = Plane::from_fn(w, h, |x, y| (hash(seed, (90 + 16 * y + x) as u64) % 41) as i32 - 20);
            let weight = random_weight(seed, most);
            let got = graph_cut(&gain, &weight);
            let all = (0u32..1 << (w * h)).map(|bits| Plane::from_fn(w, h, |x, y| bits >> (y * w + x) & 1 == 1));
            let count = |label: &Plane<bool>| label.pixels().iter().filter(|&&l| l).count();
            let best = all.map(|label| (energy(&gain, &weight, &label), count(&label))).min();
            prop_assert_eq!(best, Some((energy(&gain, &weight, &got), count(&got))));
        }
    }

    #[test]
    fn without_weights_each_pixel_decides_and_with_large_ones_their_sum() {
        let gain = Plane::from_fn(9, 7, |x, y| (x * 5 + y * 3) as i32 % 7 - 3);
        assert_eq!(graph_cut(&gain, |_, _, _, _| 0), gain.map(|g| g > 0));
        let sum: i32 = gain.pixels().iter().sum();
        assert_eq!(graph_cut(&gain, |_, _, _, _| 1000), gain.map(|_| sum > 0));
        assert!(graph_cut(&Plane::filled(0, 0, 1), |_, _, _, _| 1).is_empty());
    }

    /// A noisy disc comes out as a disc; all of a working picture in well under a second.
    #[test]
    fn noise_is_cut_away() {
        let inside = |x: usize, y: usize| (x as f32 - 150.0).hypot(y as f32 - 120.0) < 60.0;
        let gain = Plane::from_fn(320, 240, |x, y| {
            let noise = (hash(7, (320 * y + x) as u64) % 401) as i32 - 200;
            if inside(x, y) { 80 + noise } else { noise - 80 }
        });
        let got = graph_cut(&gain, |_, _, _, _| 60);
        let wrong = got
            .pixels()
            .iter()
            .enumerate()
            .filter(|&(i, &l)| l != inside(i % 320, i / 320))
            .count();
        // Half a pixel along the outline of 377; 30 % of all pixels are wrong by themselves.
        assert!(wrong < 188, "{wrong} pixels are wrong");
    }
}
