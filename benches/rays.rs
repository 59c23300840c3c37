//! Rays per second on a depth mesh of a furnished room, beside another library where one is given:
//! benches/peers/README.md.
//!
//!     cargo bench --bench rays -- [PEER]
//!
//! One thread, rays one by one. Sides alternate after every few milliseconds, and of each such
//! piece the best round counts: other work only ever adds.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Instant;

use glam::Vec3;
use relight::geometry::{Camera, RayMesh, cosine_direction};

const ROUNDS: usize = 25;
const RAYS: usize = 100_000;
/// Number of rays after which the other side takes its turn.
const PIECE: usize = 5000;

/// Numbers in 0..1, identical on every machine (xorshift, Marsaglia 2003).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Distance in meters from the origin to the room along `direction`: walls, boxes for furniture and
/// two balls.
fn room(direction: Vec3) -> f32 {
    let boxes = [
        [[-2.6, -1.4, -5.5], [-1.6, 0.6, -4.0]],
        [[-0.9, -1.4, -4.2], [0.5, -0.7, -3.0]],
        [[0.9, -1.4, -5.9], [2.4, -0.5, -4.6]],
        [[1.1, -1.4, -3.2], [1.5, -0.6, -2.8]],
        [[-1.8, -1.4, -2.9], [-1.5, -0.2, -2.6]],
        [[-0.3, 0.5, -4.0], [0.3, 0.75, -3.5]],
        [[1.9, -1.4, -3.9], [2.0, 0.9, -3.8]],
    ];
    let balls = [([-0.2, -0.45, -3.6], 0.25f32), ([1.6, -0.1, -5.2], 0.4)];
    let crossings = |[lower, upper]: [[f32; 3]; 2]| {
        let (a, b) = (Vec3::from(lower) / direction, Vec3::from(upper) / direction);
        (a.min(b).max_element(), a.max(b).min_element())
    };
    let walls = crossings([[-2.6, -1.4, -6.0], [2.9, 1.3, 1.0]]).1;
    let boxes = boxes.map(|b| match crossings(b) {
        (near, far) if near <= far => near,
        _ => f32::INFINITY,
    });
    let balls = balls.map(|(center, radius)| {
        let (center, square) = (Vec3::from(center), direction.length_squared());
        let along = direction.dot(center);
        let root = along * along - square * (center.length_squared() - radius * radius);
        if root > 0.0 { (along - root.sqrt()) / square } else { f32::INFINITY }
    });
    boxes.into_iter().chain(balls).fold(walls, f32::min)
}

/// The point of every pixel, and all triangles between them, with slivers across depth steps.
struct Mesh {
    points: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    width: usize,
}

impl Mesh {
    fn new(camera: &Camera, random: &mut Random) -> Mesh {
        let (width, height) = (camera.width, camera.height);
        let point = |i: usize| {
            let direction = camera.pixel_point(i % width, i / width, 1.0);
            // Noise like that of a depth sensor, growing with the square of the depth.
            let z = room(direction);
            direction * (z + 0.002 * z * z * (random.next() - 0.5))
        };
        let points = (0..width * height).map(point).collect();
        let quads = (0..(height - 1) * width).filter(|i| i % width + 1 < width);
        let halves = |i: usize| {
            let corner = |right: usize, below: usize| (i + right + below * width) as u32;
            [[corner(0, 0), corner(0, 1), corner(1, 1)], [corner(0, 0), corner(1, 1), corner(1, 0)]]
        };
        Mesh { points, triangles: quads.flat_map(halves).collect(), width }
    }

    fn corners(&self) -> impl Iterator<Item = ([Vec3; 3], u32)> {
        self.triangles.iter().zip(0..).map(|(t, id)| (t.map(|i| self.points[i as usize]), id))
    }

    /// A pixel's point, a little above the surface, and the normal there.
    fn surface(&self, pixel: usize) -> (Vec3, Vec3) {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let (x, y) = (x.min(self.width - 2), y.min(self.points.len() / self.width - 2));
        let at = |x: usize, y: usize| self.points[x + y * self.width];
        let normal = (at(x, y + 1) - at(x, y)).cross(at(x + 1, y) - at(x, y)).normalize();
        (self.points[pixel] + 0.01 * normal, normal)
    }
}

/// Rays of one query: origin, direction and limit of each.
struct Set {
    name: &'static str,
    closest: bool,
    rays: Vec<(Vec3, Vec3, f32)>,
}

impl Set {
    /// The three kinds that the library traces, and the rays on which a triangle test leaks.
    fn all(camera: &Camera, mesh: &Mesh, random: &mut Random) -> [Set; 4] {
        let pixels = mesh.points.len();
        let row_by_row = |i: usize| i * pixels / RAYS;
        let shadow = |i: usize, random: &mut Random| {
            let (from, _) = mesh.surface(row_by_row(i));
            (from, Vec3::new(random.next() - 0.5, 1.25, random.next() - 3.5) - from, 0.999)
        };
        let incoherent = |_: usize, random: &mut Random| {
            let (from, normal) = mesh.surface((random.next() * pixels as f32) as usize % pixels);
            (
                from,
                cosine_direction(normal, [random.next().into(), random.next().into()]),
                f32::INFINITY,
            )
        };
        let primary = |i: usize, random: &mut Random| {
            let row = row_by_row(i) / camera.width;
            let within = |most: usize, at: f32| at.clamp(0.5, most as f32 - 0.5);
            let x = within(camera.width, random.next() * camera.width as f32);
            let y = within(camera.height, row as f32 + random.next());
            (Vec3::ZERO, camera.unproject(x, y, 1.0), f32::INFINITY)
        };
        let inner = |i: usize| (1 + i % (camera.width - 2), 1 + i / (camera.width - 2));
        let centers = (0..(camera.width - 2) * (camera.height - 2)).map(inner);
        let through =
            |(x, y): (usize, usize)| (Vec3::ZERO, camera.pixel_point(x, y, 1.0), f32::INFINITY);
        let mut make = |ray: &dyn Fn(usize, &mut Random) -> (Vec3, Vec3, f32)| {
            (0..RAYS).map(|i| ray(i, random)).collect()
        };
        [
            Set { name: "shadow, any hit", closest: false, rays: make(&shadow) },
            Set { name: "incoherent, closest hit", closest: true, rays: make(&incoherent) },
            Set { name: "primary, closest hit", closest: true, rays: make(&primary) },
            Set {
                name: "through the vertices",
                closest: true,
                rays: centers.map(through).collect(),
            },
        ]
    }

    /// Triangle (or `u32::MAX`; 0 of any hit) and distance of each ray.
    fn trace(&self, mesh: &RayMesh, piece: Range<usize>) -> Vec<(u32, f32)> {
        let miss = (u32::MAX, 0.0);
        let ask = |&(origin, direction, limit): &(Vec3, Vec3, f32)| match self.closest {
            true => mesh.closest(origin, direction).map_or(miss, |hit| (hit.id, hit.distance)),
            false if mesh.any(origin, direction, limit, |_| true) => (0, 0.0),
            false => miss,
        };
        self.rays[piece].iter().map(ask).collect()
    }
}

/// Writes numbers as the peers read them.
fn write(
    path: &Path,
    head: [usize; 2],
    floats: impl Iterator<Item = f32>,
    whole: impl Iterator<Item = u32>,
) {
    let mut bytes: Vec<u8> = head.into_iter().flat_map(|n| (n as u32).to_le_bytes()).collect();
    bytes.extend(floats.flat_map(f32::to_le_bytes));
    bytes.extend(whole.flat_map(u32::to_le_bytes));
    std::fs::write(path, bytes).expect("temporary folders take files");
}

/// Another library; benches/peers/embree.cpp documents the protocol.
struct Peer {
    child: Child,
    answers: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts the library; returns its first line too.
    fn new(program: &str, mode: &str, files: &[PathBuf]) -> (Peer, String) {
        let mut command = Command::new(program);
        let child =
            command.arg(mode).args(files).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut child = child.unwrap_or_else(|error| panic!("{program}: {error}"));
        let answers = BufReader::new(child.stdout.take().expect("it is piped"));
        let mut peer = Peer { child, answers };
        let hello = peer.answer();
        (peer, hello)
    }

    fn answer(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).expect("the peer speaks text");
        assert!(!line.is_empty(), "the peer has stopped");
        line.trim().to_owned()
    }

    fn ask(&mut self, request: &str) -> String {
        let input = self.child.stdin.as_mut().expect("it is piped");
        writeln!(input, "{request}").expect("the peer listens");
        self.answer()
    }

    fn hits(&mut self, set: usize, path: &Path) -> Vec<(u32, f32)> {
        self.ask(&format!("hits {set} {}", path.display()));
        let bytes = std::fs::read(path).expect("the peer has written it");
        let word = |b: &[u8]| u32::from_le_bytes(b.try_into().expect("four bytes"));
        bytes.chunks_exact(8).map(|b| (word(&b[..4]), f32::from_bits(word(&b[4..])))).collect()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

/// Number of rays that one side misses and the other hits, and of rays whose distances differ by
/// more than rounding.
fn disagree(ours: &[(u32, f32)], theirs: &[(u32, f32)]) -> [usize; 3] {
    let hit = |side: &(u32, f32)| side.0 != u32::MAX;
    let pairs = || ours.iter().zip(theirs);
    [
        pairs().filter(|(a, b)| !hit(a) && hit(b)).count(),
        pairs().filter(|(a, b)| hit(a) && !hit(b)).count(),
        pairs()
            .filter(|(a, b)| hit(a) && hit(b) && (a.1 - b.1).abs() > 1e-4 * a.1.max(b.1))
            .count(),
    ]
}

/// Other programs in both of their modes, with the mesh and the rays in files.
fn start_peers(
    program: &str,
    mesh: &Mesh,
    sets: &[Set],
    folder: &Path,
) -> Vec<(&'static str, Peer)> {
    let mut peers = Vec::new();
    let mut files = vec![folder.join("mesh")];
    let points = mesh.points.iter().flat_map(|p| p.to_array());
    write(
        &files[0],
        [mesh.points.len(), mesh.triangles.len()],
        points,
        mesh.triangles.iter().flatten().copied(),
    );
    for (i, set) in sets.iter().enumerate() {
        files.push(folder.join(format!("rays_{i}")));
        let numbers =
            set.rays.iter().flat_map(|(o, d, limit)| [o.x, o.y, o.z, d.x, d.y, d.z, *limit]);
        write(
            &files[i + 1],
            [usize::from(set.closest), set.rays.len()],
            numbers,
            std::iter::empty(),
        );
    }
    for mode in ["fast", "robust"] {
        let (peer, hello) = Peer::new(program, mode, &files);
        println!("    peer, {mode}: {hello}");
        peers.push((mode, peer));
    }
    peers
}

fn measure(height: usize, width: usize, program: Option<&str>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut random, camera) = (Random(88172645463325252), Camera::from_fov_x(width, height, 60.0));
    let mesh = Mesh::new(&camera, &mut random);
    let sets = Set::all(&camera, &mesh, &mut random);
    // On one thread, like the rays.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let build = |_| {
        let began = Instant::now();
        let built = pool.install(|| RayMesh::new(mesh.corners()));
        (built, began.elapsed())
    };
    let (ours, built) = (0..5).map(build).min_by_key(|b| b.1).expect("five");
    println!(
        "{height} x {width}, {} triangles; built in {:.0} ms",
        mesh.triangles.len(),
        built.as_secs_f64() * 1e3
    );

    let mut peers =
        program.map_or_else(Vec::new, |program| start_peers(program, &mesh, &sets, folder.path()));
    for (i, set) in sets.iter().enumerate() {
        let pieces: Vec<_> =
            (0..set.rays.len()).step_by(PIECE).map(|i| i..set.rays.len().min(i + PIECE)).collect();
        let mut best = vec![vec![f64::INFINITY; pieces.len()]; 1 + peers.len()];
        for _ in 0..ROUNDS {
            for (p, piece) in pieces.iter().enumerate() {
                let began = Instant::now();
                black_box(set.trace(&ours, piece.clone()));
                best[0][p] = best[0][p].min(began.elapsed().as_secs_f64());
                for (best, (_, peer)) in best[1..].iter_mut().zip(&mut peers) {
                    let seconds = peer.ask(&format!("run {i} {} {}", piece.start, piece.end));
                    best[p] = best[p].min(seconds.parse().expect("seconds"));
                }
            }
        }
        let best: Vec<f64> = best.iter().map(|pieces| pieces.iter().sum()).collect();
        let hits = set.trace(&ours, 0..set.rays.len());
        let count = hits.iter().filter(|h| h.0 != u32::MAX).count();
        let rate = |seconds: f64| set.rays.len() as f64 / seconds * 1e-6;
        println!(
            "  {:26} {:6.2} M rays/s   {count} of {} hit",
            set.name,
            rate(best[0]),
            set.rays.len()
        );
        for ((mode, peer), seconds) in peers.iter_mut().zip(&best[1..]) {
            let theirs = peer.hits(i, &folder.path().join("hits"));
            let [missed, more, further] = disagree(&hits, &theirs);
            println!(
                "    peer, {mode:20} {:6.2} M rays/s   ours / peer {:.2}; hit by the peer alone {missed}, by us alone {more}, elsewhere {further}",
                rate(*seconds),
                seconds / best[0],
            );
        }
    }
}

fn main() {
    // Cargo adds `--bench`.
    let program = std::env::args()
        .skip(1)
        .find(|a| !a.starts_with("--"))
        .or_else(|| std::env::var("RELIGHT_PEER").ok());
    for (height, width) in [(240, 320), (480, 640)] {
        measure(height, width, program.as_deref());
    }
}
