//! Doubts about a scene: signs that its depth, its field of view or a mask is not as it is stated.
//!
//! Rooms are alike: their surfaces lie some meters away, no floor is above the camera, floors and
//! walls meet at right angles, and lamps are brighter than the wall behind them. A scene that
//! breaks one of these by far was read with a wrong unit, kind, lens or mask.

use std::fmt;

use super::level_sides::{Patches, median, patches};
use super::right_angles::{exact_up, right_angles};
use super::upright_edges::UprightEdges;
use crate::geometry::Camera;
use crate::image::{
    Depth, Mask, Measure, Picture, Plane, dilate, fit, luminance, resize, resize_depth,
};
use crate::tuning::tuning;

tuning! {
    /// Limits of plausible scenes.
    pub const TUNING: PlausibilityTuning {
        /// Longer side at which a scene is judged.
        long_side: usize = 320,
            unit "pixels", source Derived("the working size of most graphs"), effect "a larger value is slower";
        /// Field of view below which the number is rather one of radians: a telescope's.
        narrow: f32 = 5.0,
            unit "degrees", source Taste, effect "a larger value doubts more lenses";
        /// Median depths of rooms.
        distances: [f32; 2] = [0.5, 20.0],
            unit "meters", source Taste, effect "a wider range doubts fewer units";
        /// Heights of the camera above the floor.
        heights: [f32; 2] = [0.2, 4.5],
            unit "meters", source Taste, effect "a wider range doubts fewer units";
        /// Downward component of a ray or a normal from which it points down.
        down: [f32; 2] = [0.1, 0.3],
            unit "1", source Measured("tests/plausibility.rs"), effect "larger values count fewer surfaces";
        /// Fraction of the surfaces below the camera that may face down: 0.07 in sound scenes, 0.32
        /// and more in inverse depth.
        facing_down: f32 = 0.25,
            unit "1", source Measured("tests/plausibility.rs"), effect "a larger value doubts fewer kinds of depth";
        /// Stretches of the tangents of view that are tried: even in their logarithm.
        stretches: [f32; 2] = [0.35, 2.85],
            unit "1", source Taste, effect "a wider range finds wilder lenses";
        /// Stretches on either side of 1.
        steps: i32 = 6,
            unit "1", source Taste, effect "a larger value is slower and more exact";
        /// Gain in right angles from which another lens or kind of depth is likely: at most 1.4 in
        /// sound scenes.
        gain: f32 = 1.6,
            unit "1", source Measured("tests/plausibility.rs"), effect "a larger value doubts fewer lenses";
        /// Right angles that must then be found.
        least: f32 = 0.09,
            unit "1", source Measured("tests/plausibility.rs"), effect "a larger value doubts fewer lenses";
        /// Angle between gravity by level surfaces and by upright edges: at most 8.1 in sound
        /// scenes.
        lean: f32 = 11.0,
            unit "degrees", source Measured("tests/plausibility.rs"), effect "a larger value doubts fewer depths";
        /// Gain in edges that point up from which the edges are believed: at most 1.12 in 310 views
        /// of rooms where the angle is larger than that.
        lean_gain: f32 = 1.2,
            unit "1", source Measured("docs/doubts.md"), effect "a larger value doubts fewer depths";
        /// Distance around a mask whose pixels are compared with it.
        ring: usize = 8,
            unit "pixels", source Taste, effect "a larger value compares with more of the room";
        /// Brightness of a light over its surroundings, of medians.
        brighter: f32 = 1.3,
            unit "1", source Measured("tests/plausibility.rs"), effect "a larger value doubts more masks";
        /// Brightness of white: lights may be no brighter than their glare there.
        white: f32 = 0.8,
            unit "fraction of the photo's white", source Measured("tests/plausibility.rs"), effect "a larger value doubts more masks";
        /// Least brightness of a light.
        bright: f32 = 0.5,
            unit "fraction of the photo's brightest tenth", source Measured("tests/plausibility.rs"), effect "a larger value doubts more masks";
        /// Brightness, over the surroundings, of a lamp that is off before a bright wall: of
        /// medians, and of brightest tenths.
        off: [f32; 2] = [0.4, 0.45],
            unit "1", source Measured("tests/plausibility.rs"), effect "larger values doubt fewer masks";
        /// Least number of pixels of a mask that is judged.
        pixels: usize = 12,
            unit "pixels", source Taste, effect "a larger value judges fewer masks";
    }
}

/// A scene as it was read. All planes and the camera have one size.
pub struct SeenRoom<'a> {
    /// Planar depth.
    pub depth: &'a Depth,
    /// The stated camera.
    pub camera: &'a Camera,
    /// The stated quantity of the depth file.
    pub measure: Measure,
    /// Above 0 on panes and what is not part of the room.
    pub outside: &'a Plane<f32>,
    /// The photo, linear.
    pub photo: &'a Picture,
    /// Name and mask of each visible light.
    pub lights: Vec<(&'a str, &'a Mask)>,
}

/// A reason to doubt a scene. Its text has the numbers, the likely cause and the line of
/// `scene.ron` to change.
#[derive(Clone, Debug, PartialEq)]
pub enum Doubt {
    /// The field of view is that of a telescope.
    Radians {
        /// Stated horizontal field of view, degrees.
        stated: f32,
    },
    /// The median depth is not that of a room.
    Distance {
        /// Median depth, meters.
        median: f32,
    },
    /// Surfaces below the camera face down, as if the floor hung above it: near and far are
    /// exchanged.
    Inverted {
        /// Fraction of those surfaces.
        share: f32,
        /// The quantity that the scene states.
        measure: Measure,
    },
    /// Surfaces meet at right angles if the numbers have another meaning.
    Kind {
        /// The likely quantity.
        likely: Measure,
        /// Factor on the measure of right angles.
        gain: f32,
    },
    /// Surfaces meet at right angles under another field of view.
    Lens {
        /// Stated horizontal field of view, degrees.
        stated: f32,
        /// The likely one, degrees.
        likely: f32,
        /// Factor on the measure of right angles.
        gain: f32,
    },
    /// Upright edges of the photo are not across the level surfaces of the depth.
    Leaning {
        /// Angle between the two directions of gravity, degrees.
        angle: f32,
        /// The horizontal field of view under which they are one, degrees, if there is one.
        likely: Option<f32>,
    },
    /// The floor is not at a height at which people hold cameras.
    CameraHeight {
        /// Distance from the floor to the camera, meters.
        height: f32,
    },
    /// A mask is as bright as its surroundings, or hardly brighter.
    DimMask {
        /// Name of the light.
        light: String,
        /// Median luminance of the mask.
        inside: f32,
        /// Median luminance around it.
        around: f32,
    },
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Doubt::Radians { stated } => write!(
                f,
                "the stated field of view of {stated:.2} degrees is that of a telescope: radians? Then \
                it is {:.0} degrees; in scene.ron: `camera: FovX({0:.0})`",
                stated.to_degrees()
            ),
            Doubt::Distance { median } => {
                let [near, far] = TUNING.distances;
                write!(f, "the median depth is {median} m, wanted {near} to {far} m in a room: ")?;
                match median {
                    300.0.. => write!(f, "probably millimeters: multiply `scale` by 0.001"),
                    20.0.. => write!(f, "probably centimeters: multiply `scale` by 0.01"),
                    0.02.. => write!(f, "probably relative depth, or feet or a wrong `scale`"),
                    _ => write!(f, "probably meters read as millimeters: multiply `scale` by 1000"),
                }?;
                write!(f, "; in scene.ron: `depth: (.., scale: ..)`")
            }
            Doubt::Inverted { share, measure } => {
                let (cause, kind) = match measure {
                    Measure::Disparity => ("distances, not a disparity", "PlanarZ"),
                    _ => ("a disparity or inverse depth, larger is nearer", "Disparity"),
                };
                let percent = 100.0 * share;
                write!(
                    f,
                    "{percent:.0} % of the surfaces below the camera face down, as if the floor were above \
                    it: the numbers are probably {cause}; in scene.ron: `depth: (.., kind: {kind})`"
                )
            }
            Doubt::Kind { likely, gain } => write!(
                f,
                "floor and walls are bent: {gain:.1} times as many surfaces meet at right angles if the \
                numbers are of another kind; in scene.ron: `depth: (.., kind: {likely:?})`"
            ),
            Doubt::Lens { stated, likely, gain } => write!(
                f,
                "the right angles of floor and walls are bent under the stated field of view of \
                {stated:.0} degrees: {gain:.1} times as many surfaces meet at right angles under about \
                {likely:.0}; in scene.ron: `camera: FovX({likely:.0})`"
            ),
            Doubt::Leaning { angle, likely } => {
                write!(
                    f,
                    "the upright edges of the photo lean {angle:.0} degrees from upright in the depth: "
                )?;
                match likely {
                    Some(likely) => write!(
                        f,
                        "the field of view is probably about {likely:.0} degrees; in scene.ron: \
                        `camera: FovX({likely:.0})`"
                    ),
                    None => write!(
                        f,
                        "the depth is probably turned, or that of another photo or part of it; in \
                        scene.ron: `depth: (path: ..)`"
                    ),
                }
            }
            Doubt::CameraHeight { height } => write!(
                f,
                "the camera stands {height:.2} m above the floor, wanted {} to {} m: the unit of the \
                depth is probably wrong; in scene.ron: `depth: (.., scale: ..)`",
                TUNING.heights[0], TUNING.heights[1]
            ),
            Doubt::DimMask { light, inside, around } => write!(
                f,
                "the mask of `{light}` is hardly brighter than its surroundings (luminance {inside:.2}, around \
                it {around:.2}): it is off, or the mask marks something else; in scene.ron: `lights: {{ \"{light}\": .. }}`"
            ),
        }
    }
}

/// Everything doubtful about a scene, the likeliest cause first: of a wrong depth or lens, one
/// doubt, as the others follow from it.
pub fn doubts(room: &SeenRoom) -> Vec<Doubt> {
    let (width, height) = room.depth.0.size();
    let (width, height) = fit(width, height, TUNING.long_side);
    let depth = resize_depth(room.depth, width, height);
    let outside = resize(room.outside, width, height);
    let camera = room.camera.resized(width, height);
    let photo = resize(&room.photo.0, width, height).map(luminance);
    let mut found: Vec<Doubt> =
        of_depth((&depth, &camera, &outside), room.measure, &photo).into_iter().collect();
    found.extend(
        room.lights.iter().filter_map(|(light, mask)| {
            of_mask(light, &Mask(resize(&mask.0, width, height)), &photo)
        }),
    );
    found
}

/// The likeliest fault of the depth or the lens.
fn of_depth(
    (depth, camera, outside): (&Depth, &Camera, &Plane<f32>),
    measure: Measure,
    photo: &Plane<f32>,
) -> Option<Doubt> {
    let stated = 2.0 * (0.5 * camera.width as f32 / camera.fx).atan().to_degrees();
    if stated < TUNING.narrow {
        return Some(Doubt::Radians { stated });
    }
    let median = median(depth);
    let seen = patches(depth, camera, outside);
    let share = facing_down(&seen);
    if share > TUNING.facing_down {
        return Some(Doubt::Inverted { share, measure });
    }
    if !(TUNING.distances[0]..=TUNING.distances[1]).contains(&median) {
        return Some(Doubt::Distance { median });
    }
    let bent = bent((depth, camera, outside), measure, &seen);
    bent.or_else(|| leaning(&seen, camera, photo)).or_else(|| {
        let height = seen.sides().floor?;
        let usual = TUNING.heights[0]..=TUNING.heights[1];
        (!usual.contains(&height)).then_some(Doubt::CameraHeight { height })
    })
}

/// Fraction of the surfaces below the camera that face down.
fn facing_down(seen: &Patches) -> f32 {
    let [low, down] = TUNING.down;
    let (mut below, mut facing) = (0, 0);
    for (p, n) in seen.points.iter().zip(&seen.normals) {
        if p.y < -low * p.length() {
            below += 1;
            facing += usize::from(n.y < -down);
        }
    }
    facing as f32 / below.max(1) as f32
}

/// The kind of depth or the lens under which many more surfaces meet at right angles.
fn bent(
    (depth, camera, outside): (&Depth, &Camera, &Plane<f32>),
    measure: Measure,
    seen: &Patches,
) -> Option<Doubt> {
    let stated = right_angles(seen, 1.0);
    let [narrow, wide] = TUNING.stretches.map(f32::ln);
    let stretch = |i: i32| {
        let end = if i < 0 { narrow } else { wide };
        (end * i.abs() as f32 / TUNING.steps as f32).exp()
    };
    let lenses: Vec<(f32, f32)> = (-TUNING.steps..=TUNING.steps)
        .map(|i| (stretch(i), right_angles(seen, stretch(i))))
        .collect();
    let best_lens = lenses.iter().map(|lens| lens.1).fold(0.0, f32::max);
    let other = match measure {
        Measure::PlanarZ => Some((Measure::RayLength, -1)),
        Measure::RayLength => Some((Measure::PlanarZ, 1)),
        Measure::Disparity => None,
    };
    let other = other.map(|(likely, power)| {
        let ray = |x, y| camera.pixel_point(x, y, 1.0).length().powi(power);
        let (width, height) = depth.0.size();
        let depth = Plane::from_fn(width, height, |x, y| depth.0.get(x, y) * ray(x, y));
        (likely, right_angles(&patches(&Depth(depth), camera, outside), 1.0))
    });
    let is_likely = |score: f32| score > TUNING.least.max(TUNING.gain * stated);
    let gain = |score: f32| score / stated.max(0.01);
    match other {
        Some((likely, score)) if is_likely(score) && score >= best_lens => {
            Some(Doubt::Kind { likely, gain: gain(score) })
        }
        _ if is_likely(best_lens) => {
            // Within a plateau of equal scores, the middle.
            let near = lenses.iter().filter(|lens| lens.1 > 0.95 * best_lens);
            let (sum, count) = near.fold((0.0, 0.0), |(sum, n), (k, _)| (sum + k.ln(), n + 1.0));
            let tangent = 0.5 * camera.width as f32 / camera.fx;
            let degrees = |tangent: f32| 2.0 * tangent.atan().to_degrees();
            let likely = degrees(tangent * (sum / count as f32).exp());
            Some(Doubt::Lens { stated: degrees(tangent), likely, gain: gain(best_lens) })
        }
        _ => None,
    }
}

/// The doubt about a depth or a lens under which level surfaces and upright edges disagree on
/// gravity.
///
/// Under tangents of view that are k times too large, the slope of the pitch that the depth shows
/// is k times too large, that which the edges show k times too small.
fn leaning(seen: &Patches, camera: &Camera, photo: &Plane<f32>) -> Option<Doubt> {
    let lines = UprightEdges::new(photo, camera);
    let (edges, surfaces) = (lines.up()?, exact_up(seen));
    let angle = edges.angle_between(surfaces).to_degrees();
    let gain = lines.agreement(edges) / lines.agreement(surfaces).max(f32::MIN_POSITIVE);
    if angle < TUNING.lean || gain < TUNING.lean_gain {
        return None;
    }
    let slopes = [surfaces, edges].map(|up| up.z / up.y);
    let stretch = (slopes[0] / slopes[1]).max(0.0).sqrt();
    let [narrow, wide] = TUNING.stretches;
    // A lens explains another pitch of the same sign, and not another roll.
    let roll = (edges.x - surfaces.x).abs().asin().to_degrees();
    let lens = (1.0 / wide..=1.0 / narrow).contains(&stretch) && roll < 0.5 * TUNING.lean;
    let tangent = 0.5 * camera.width as f32 / camera.fx;
    let likely = lens.then(|| 2.0 * (tangent / stretch).atan().to_degrees());
    Some(Doubt::Leaning { angle, likely })
}

/// The doubt about a mask that marks neither a bright light nor a dark lamp before a bright wall.
fn of_mask(light: &str, mask: &Mask, photo: &Plane<f32>) -> Option<Doubt> {
    let (width, height) = photo.size();
    let wide = dilate([mask].into_iter(), photo.size(), TUNING.ring);
    let mask = &mask.0;
    let luminances = |keep: &dyn Fn(usize) -> bool| {
        let kept = (0..width * height).filter(|&i| keep(i)).map(|i| photo.pixels()[i]);
        let mut kept: Vec<f32> = kept.collect();
        kept.sort_by(f32::total_cmp);
        kept
    };
    let inside = luminances(&|i| mask.pixels()[i] > 0.5);
    let around = luminances(&|i| wide.pixels()[i] && mask.pixels()[i] <= 0.0);
    if inside.len() < TUNING.pixels || around.len() < TUNING.pixels {
        return None;
    }
    let all = luminances(&|_| true);
    let at = |sorted: &[f32], share: f32| sorted[((sorted.len() - 1) as f32 * share) as usize];
    let (middle, middle_around) = (at(&inside, 0.5), at(&around, 0.5));
    let is_light = middle >= TUNING.white * at(&all, 0.995)
        || (middle >= TUNING.brighter * middle_around && middle >= TUNING.bright * at(&all, 0.9));
    let is_off = middle < TUNING.off[0] * middle_around
        || at(&inside, 0.9) < TUNING.off[1] * at(&around, 0.9);
    (!is_light && !is_off).then(|| Doubt::DimMask {
        light: light.into(),
        inside: middle,
        around: middle_around,
    })
}
