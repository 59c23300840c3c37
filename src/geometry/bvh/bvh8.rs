//! A bounding volume hierarchy whose nodes have up to eight children, tested at once.
//!
//! obvhs builds a binary hierarchy; it is collapsed so that the remaining boxes have the least
//! total area, which is proportional to the expected number of tests of a random ray (the dynamic
//! program of Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs Through
//! Compressed Wide BVHs", HPG 2017, section 4.2).

use std::hint::black_box;
use std::time::Duration;

use fearless_simd::{Simd, f32x8, prelude::*};
use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::{Bvh2, builder::build_bvh2_from_tris};
use obvhs::triangle::Triangle;

use super::watertight_triangle::Packet;

/// Splitting large triangles mostly helps long slivers (curtains, slanted surfaces). A slower build
/// beyond that costs more than it gains on the rays of a picture. The packets are formed here, not
/// by the builder.
const BUILD: BvhBuildParams =
    BvhBuildParams { pre_split: true, max_prims_per_leaf: 1, ..BvhBuildParams::fast_build() };

/// Children that may wait for their turn on the stack of an ordinary hierarchy; a deeper one gets a
/// stack of its own size.
const WAITING: usize = 128;

/// Set in the number of a packet, clear in that of a node.
const PACKET: u32 = 1 << 31;

/// Boxes of eight children; the box of no child is inside out and is never entered.
#[repr(C, align(64))]
struct WideNode {
    /// By axis, side (lower, upper) and child.
    planes: [[[f32; 8]; 2]; 3],
    children: [u32; 8],
}

/// The hierarchy. The first node is the root.
pub struct Bvh8 {
    nodes: Vec<WideNode>,
    packets: Vec<Packet>,
    /// The largest absolute coordinate.
    extent: f32,
    /// Largest number of children on the stack.
    waiting: usize,
}

impl Bvh8 {
    /// Builds the hierarchy of triangles with finite corners.
    pub fn new(triangles: &[([Vec3; 3], u32)]) -> Bvh8 {
        let extent =
            triangles.iter().flat_map(|t| t.0).map(|p| p.abs().max_element()).fold(0.0, f32::max);
        let mut bvh = Bvh8 { nodes: Vec::new(), packets: Vec::new(), extent, waiting: 0 };
        if !triangles.is_empty() {
            let shape = |(c, _): &([Vec3; 3], u32)| Triangle {
                v0: c[0].into(),
                v1: c[1].into(),
                v2: c[2].into(),
            };
            let shapes: Vec<Triangle> = triangles.iter().map(shape).collect();
            bvh.collapse(
                &build_bvh2_from_tris(&shapes, BUILD, &mut Duration::default()),
                triangles,
            );
        }
        bvh
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.packets[..])
    }

    fn collapse(&mut self, binary: &Bvh2, triangles: &[([Vec3; 3], u32)]) {
        let costs = Costs::new(binary);
        // The node or packet that a child of the binary hierarchy becomes, its index in the output,
        // and the number of children that wait beside it.
        let mut todo = vec![(0, None, 0)];
        while let Some((at, place, beside)) = todo.pop() {
            let mut children = if place.is_none() && costs.is_packet(0) {
                vec![0]
            } else {
                costs.children(binary, at)
            };
            let number = if children.is_empty() {
                let inside = triangles_below(binary, at);
                self.packets.push(Packet::new(inside.iter().map(|&i| triangles[i as usize])));
                (self.packets.len() - 1) as u32 | PACKET
            } else {
                let mut node = WideNode {
                    planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3],
                    children: [PACKET; 8],
                };
                let beside = beside + children.len() - 1;
                self.waiting = self.waiting.max(beside);
                // The last is made first: the packets of a node lie side by side.
                children.sort_by_key(|&child| costs.is_packet(child));
                for (slot, &child) in children.iter().enumerate() {
                    let aabb = binary.nodes[child as usize].aabb;
                    for axis in 0..3 {
                        node.planes[axis][0][slot] = aabb.min[axis];
                        node.planes[axis][1][slot] = aabb.max[axis];
                    }
                    todo.push((child, Some((self.nodes.len(), slot)), beside));
                }
                self.nodes.push(node);
                (self.nodes.len() - 1) as u32
            };
            if let Some((parent, slot)) = place {
                self.nodes[parent].children[slot] = number;
            }
        }
    }

    /// Brings a child closer while its siblings are sorted and entered. Rays spend most of their
    /// time waiting for memory. Safe Rust lacks a prefetch; a read does the same if nothing uses
    /// its value, since no instruction waits for it.
    #[inline(always)]
    fn fetch(&self, child: u32) {
        if child & PACKET != 0 {
            self.packets[(child & !PACKET) as usize].fetch();
        } else {
            black_box(self.nodes[child as usize].children[0]);
        }
    }

    /// Passes the packets near the ray to `meet`, with the length of the ray in units of the
    /// direction; `meet` returns its length from there; a negative answer ends the walk. With
    /// `NEAREST_FIRST`, nearer boxes are entered first. Origin and direction are finite, the
    /// direction is not zero.
    #[inline(always)]
    pub fn walk<S: Simd, const NEAREST_FIRST: bool>(
        &self,
        simd: S,
        [origin, direction]: [Vec3; 2],
        mut limit: f32,
        mut meet: impl FnMut(&Packet, f32) -> f32,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = Slabs::new(simd, origin, direction, self.extent);
        let mut ordinary = [(0.0f32, 0u32); WAITING];
        let mut deep = Vec::new();
        let stack = if self.waiting < WAITING {
            &mut ordinary[..]
        } else {
            deep.resize(self.waiting + 1, (0.0, 0));
            &mut deep[..]
        };
        let mut waiting = 0;
        let mut at = 0;
        loop {
            if at & PACKET != 0 {
                limit = meet(&self.packets[(at & !PACKET) as usize], limit);
                if limit < 0.0 {
                    return;
                }
            } else {
                let node = &self.nodes[at as usize];
                let (mut entered, nears) = slabs.enter(node, limit);
                if entered != 0 {
                    let take = |entered: &mut u64| {
                        let slot = entered.trailing_zeros() as usize & 7;
                        *entered &= *entered - 1;
                        self.fetch(node.children[slot]);
                        (nears[slot], node.children[slot])
                    };
                    let mut next = take(&mut entered);
                    let begin = waiting;
                    while entered != 0 {
                        let mut child = take(&mut entered);
                        if NEAREST_FIRST && child.0 < next.0 {
                            (child, next) = (next, child);
                        }
                        let mut place = waiting;
                        waiting += 1;
                        while NEAREST_FIRST && place > begin && stack[place - 1].0 < child.0 {
                            stack[place] = stack[place - 1];
                            place -= 1;
                        }
                        stack[place] = child;
                    }
                    at = next.1;
                    continue;
                }
            }
            loop {
                if waiting == 0 {
                    return;
                }
                waiting -= 1;
                let (near, child) = stack[waiting];
                if near <= limit {
                    at = child;
                    break;
                }
            }
        }
    }
}

/// A ray against the boxes of a node. On each axis it enters through one plane and leaves through
/// the other, by its sign.
struct Slabs<S: Simd> {
    simd: S,
    /// The side through which the ray enters.
    side: [usize; 3],
    near: [f32x8<S>; 3],
    far: [f32x8<S>; 3],
    inverse: [f32x8<S>; 3],
}

impl<S: Simd> Slabs<S> {
    #[inline(always)]
    fn new(simd: S, origin: Vec3, direction: Vec3, extent: f32) -> Slabs<S> {
        // The rounded quantities, here and in the triangle test, are at most the distance of origin
        // and corner along an axis. Entering from a little behind and leaving from a little ahead
        // makes every box larger by some ten times the error.
        let slack = 2e-6 * (extent + origin.abs().max_element());
        let zero = f32x8::splat(simd, 0.0);
        let mut slabs =
            Slabs { simd, side: [0; 3], near: [zero; 3], far: [zero; 3], inverse: [zero; 3] };
        for axis in 0..3 {
            // This also holds for minus zero: its inverse is negative.
            let backwards = direction[axis].is_sign_negative();
            let slack = if backwards { -slack } else { slack };
            slabs.side[axis] = usize::from(backwards);
            slabs.near[axis] = f32x8::splat(simd, origin[axis] + slack);
            slabs.far[axis] = f32x8::splat(simd, origin[axis] - slack);
            // Finite and never zero, so that nothing below is zero times infinity.
            slabs.inverse[axis] =
                f32x8::splat(simd, (1.0 / direction[axis]).clamp(-f32::MAX, f32::MAX));
        }
        slabs
    }

    /// The distance at which the ray crosses a plane of each box.
    #[inline(always)]
    fn cross(&self, planes: &[f32; 8], origin: f32x8<S>, axis: usize) -> f32x8<S> {
        (f32x8::simd_from(self.simd, *planes) - origin) * self.inverse[axis]
    }

    #[inline(always)]
    fn near(&self, node: &WideNode, axis: usize) -> f32x8<S> {
        self.cross(&node.planes[axis][self.side[axis] & 1], self.near[axis], axis)
    }

    #[inline(always)]
    fn far(&self, node: &WideNode, axis: usize) -> f32x8<S> {
        self.cross(&node.planes[axis][1 - (self.side[axis] & 1)], self.far[axis], axis)
    }

    /// The boxes that the ray crosses within 0..=`limit`, a bit each, and the distances at which it
    /// enters them.
    #[inline(always)]
    fn enter(&self, node: &WideNode, limit: f32) -> (u64, [f32; 8]) {
        let (zero, limit) = (f32x8::splat(self.simd, 0.0), f32x8::splat(self.simd, limit));
        let nears = self.near(node, 0).max(self.near(node, 1)).max(self.near(node, 2).max(zero));
        let fars = self.far(node, 0).min(self.far(node, 1)).min(self.far(node, 2).min(limit));
        (nears.simd_le(fars).to_bitmask(), nears.into())
    }
}

/// The triangles in a part of the binary hierarchy, each once: one that was split can come twice.
fn triangles_below(binary: &Bvh2, at: u32) -> Vec<u32> {
    let (mut inside, mut todo) = (Vec::new(), vec![at]);
    while let Some(at) = todo.pop() {
        let node = &binary.nodes[at as usize];
        let first = node.first_index;
        if node.is_leaf() {
            inside.extend(
                &binary.primitive_indices[first as usize..(first + node.prim_count) as usize],
            );
        } else {
            todo.extend([first, first + 1]);
        }
    }
    inside.sort_unstable();
    inside.dedup();
    inside
}

/// The collapse of a binary hierarchy into wide nodes, at least cost.
struct Costs {
    /// By node the least area of boxes in and below it, shown as at most 1, 2, .. 8 children.
    areas: Vec<[f32; 8]>,
    /// By node the triangles in it. A packet takes up to eight at the cost of one.
    triangles: Vec<u32>,
}

impl Costs {
    fn new(binary: &Bvh2) -> Costs {
        let mut parents_first = vec![0];
        let mut seen = 0;
        while let Some(&at) = parents_first.get(seen) {
            let node = &binary.nodes[at];
            if !node.is_leaf() {
                parents_first.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
            seen += 1;
        }
        let mut costs = Costs {
            areas: vec![[0.0; 8]; binary.nodes.len()],
            triangles: vec![0; binary.nodes.len()],
        };
        for &at in parents_first.iter().rev() {
            let node = &binary.nodes[at];
            let area = node.aabb.half_area();
            if node.is_leaf() {
                costs.areas[at] = [area; 8];
                costs.triangles[at] = node.prim_count;
                continue;
            }
            let [left, right] = [node.first_index as usize, node.first_index as usize + 1];
            costs.triangles[at] = costs.triangles[left] + costs.triangles[right];
            let (left, right) = (costs.areas[left], costs.areas[right]);
            let shared =
                |children: usize| (1..children).map(move |k| left[k - 1] + right[children - k - 1]);
            let below = if costs.is_packet(at as u32) {
                0.0
            } else {
                shared(8).fold(f32::INFINITY, f32::min)
            };
            let mut least = area + below;
            for children in 1..=8 {
                least = shared(children).fold(least, f32::min);
                costs.areas[at][children - 1] = least;
            }
        }
        costs
    }

    fn is_packet(&self, at: u32) -> bool {
        self.triangles[at as usize] <= 8
    }

    /// The best children of a wide node made of this node; none of a packet.
    fn children(&self, binary: &Bvh2, at: u32) -> Vec<u32> {
        let mut children = Vec::new();
        if self.is_packet(at) {
            return children;
        }
        let mut todo = vec![(at, 8)];
        while let Some((at, places)) = todo.pop() {
            let (left, right) =
                (binary.nodes[at as usize].first_index, binary.nodes[at as usize].first_index + 1);
            let cost = |k: usize| {
                self.areas[left as usize][k - 1] + self.areas[right as usize][places - k - 1]
            };
            let best = (2..places).fold(1, |best, k| if cost(k) < cost(best) { k } else { best });
            for (child, places) in [(left, best), (right, places - best)] {
                let areas = &self.areas[child as usize];
                // Places that gain nothing stay free.
                match (1..=places).find(|&k| areas[k - 1] == areas[places - 1]) {
                    Some(places @ 2..) => todo.push((child, places)),
                    _ => children.push(child),
                }
            }
        }
        children
    }
}
