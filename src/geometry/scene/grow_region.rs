//! Region growing: the connected surface around a pixel that lies in its plane and has its color.
//!
//! Two labels by a minimum cut (Boykov and Jolly, ICCV 2001; Rother, Kolmogorov and Blake, GrabCut,
//! SIGGRAPH 2004, for the turns): by being of the surface a pixel gains
//! `1 - (c / chroma)^2 - (i / intensity)^2 - (p / plane)^2 - (n / normal)^2`, and where the depth
//! may be wrong but the paint is exactly the same, `2 exp(-(c^2 + i^2) / same^2)`. Here c and i are
//! the distance of its reflectance in log chromaticity and log intensity from that of the region
//! around it, p is its distance from the plane and n = 1 - cos of its normal's angle to the
//! plane's. Neighbors of two labels cost the more the less of an edge the picture has there. In c
//! and i a channel has the weight 1 / (1 + (s / chroma)^2), where s is three deviations of its
//! relative noise: the blue of a yellow wall at night is mostly noise. The region contains the
//! pixels that are reached from the first one without crossing an edge: sharp, blurred over two
//! pixels, or faint (`FaintEdges`); each round estimates plane and reflectance from them. A lamp
//! before a wall cuts the wall into parts, with its body and with the edges of its light: where the
//! region reaches a lamp, it contains all parts of the surface beside the lamp, too. The
//! reflectance is a mean with weights that fade with the distance, since that of a wall changes
//! slowly where the estimated light errs, and at once where the paint changes. A step within the
//! photo's noise is not an edge. At the end the region is closed over grain and thin lines
//! (`close_region`).

use glam::{Vec3, Vec4};

use super::close_region::{close_region, sides};
use super::faint_edges::FaintEdges;
use super::photo_edges::{PhotoEdges, log_photo};
use crate::geometry::PlaneFit;
use crate::image::{
    Albedo, Grain, Normal, Picture, Plane, Points, connected_components, distance, graph_cut,
    log_above,
};
use crate::tuning::tuning;

tuning! {
    /// Constants of the surface that a pixel belongs to.
    pub const TUNING: GrowRegionTuning {
        /// Log chromaticity at which a pixel is of another paint; wide, since estimated light errs.
        chroma: f32 = 0.8,
            unit "1", source Measured("walls of eight photographs; in 36 rooms for tuning precision 0.79 with 0.5, 0.78 with 0.8"),
            effect "a larger value joins other paints";
        /// Distance over which the weight of a pixel in the reflectance around another one falls
        /// to 1 / e.
        fading: f32 = 0.05,
            unit "fraction of the long side", source Measured("nine walls of eight photographs: the same with 0.025 to 0.05, worse with 0.08"),
            effect "a larger value excludes the parts of a wall near lamps";
        /// Log intensity of the reflectance at which a pixel is of another paint.
        intensity: f32 = 1.0,
            unit "1", source Taste, effect "a larger value joins other paints";
        /// Gain of a pixel for exactly the paint around it.
        sure_paint: f32 = 2.0,
            unit "what a sure pixel gains", source Measured("nine walls of eight photographs, with depth by a sensor that is wrong in corners of the photo"),
            effect "a larger value joins things of the same paint before a surface";
        /// Log step at which that gain is 1 / e.
        same_paint: f32 = 0.1,
            unit "1", source Measured("nine walls of eight photographs"),
            effect "a larger value joins other paints";
        /// Distance from the plane at which a pixel is of another surface.
        off_plane: f32 = 0.03,
            unit "fraction of the distance from the camera", source Taste,
            effect "a larger value joins surfaces before and behind";
        /// 1 - cosine between the normals of a pixel and of the plane at which the pixel is of
        /// another surface.
        normal: f32 = 0.3,
            unit "1", source Taste, effect "a larger value joins slanted surfaces";
        /// Distance from the border of the photo up to which normals have a smaller weight: there
        /// depth is often filled in.
        border: f32 = 0.06,
            unit "fraction of the width", source Measured("nine walls of eight photographs, with depth by a sensor"),
            effect "a larger value joins other surfaces at the border";
        /// Least gain of a pixel.
        min_gain: f32 = -3.0,
            unit "what a sure pixel gains", source Taste, effect "a smaller value keeps single deviating pixels out";
        /// Cost of parting two pixels that look alike.
        parting: f32 = 2.0,
            unit "what a sure pixel gains", source Measured("nine walls of eight photographs: 0.5 has torn outlines where the photo is white"),
            effect "a larger value makes shorter outlines, and joins thin things of the same paint";
        /// Log step of the picture across which parting costs 1 / e of that.
        step: f32 = 0.12,
            unit "1", source Taste, effect "a smaller value follows fainter edges";
        /// Distance from a lamp up to which a pixel is beside it.
        beside_lamp: f32 = 3.0,
            unit "pixels", source Measured("nyu_0958, whose lamps cut a wall into parts; by eye"),
            effect "a larger value joins parts of a surface that something else than a lamp separates";
        /// Steps in which gains and costs are rounded to whole numbers.
        unit: f32 = 256.0,
            unit "steps per gain of a sure pixel", source Taste,
            effect "a larger value rounds less; sums along a path must stay below 2^31";
        /// Gain of the first pixel in those steps, which keeps it in the surface.
        sure: i32 = 1 << 16,
            unit "steps", source Derived("more than all its neighbors can gain"), effect "none above";
        /// Ratio of a step to the deviation of the photo's noise up to which the step is noise.
        deviations: f32 = 3.0,
            unit "1", source Derived("one step of 370 is larger in normal noise"),
            effect "a larger value crosses fainter edges of dark and noisy photos";
        /// Rounds in which color and plane converge.
        rounds: usize = 4,
            unit "rounds", source Taste, effect "a larger value is slower";
        /// Least reflectance; darker values count as this.
        black: f32 = 0.01,
            unit "reflectance", source Taste, effect "a larger value makes dark paints alike";
        /// Radius around the first pixel from which the first color is taken.
        seed_radius: usize = 2,
            unit "pixels", source Taste, effect "a larger value averages more of the surroundings";
        /// Largest number of pixels through which the plane is fitted; of more, every nth is taken.
        max_points: usize = 1500,
            unit "pixels", source Measured("run time; no page records it"),
            effect "a larger value is slower and more exact";
    }
}

/// The pixels of the surface at pixel (x, y). All planes have one size; `grain` is the noise of the
/// photo at its own size, `lamps` are the pixels that show one.
pub fn grow_region(
    (x, y): (usize, usize),
    photo: &Picture,
    reflectance: &Albedo,
    points: &Points,
    normal: &Normal,
    grain: Option<&Grain>,
    lamps: &Plane<bool>,
) -> Plane<bool> {
    let (w, h) = photo.0.size();
    let beside_lamps = connected_components(&distance(lamps).map(|far| far <= TUNING.beside_lamp));
    let color = reflectance.0.map(|c| log_above(TUNING.black, c));
    let seen = log_photo(photo);
    let start = y * w + x;
    let noise = photo
        .0
        .map(|level| TUNING.deviations * grain.map_or(Vec3::ZERO, |grain| grain.relative(level)));
    let faint = FaintEdges::find(&seen, &noise);
    let mut found = Plane::from_fn(w, h, |px, py| {
        px.abs_diff(x) <= TUNING.seed_radius && py.abs_diff(y) <= TUNING.seed_radius
    });
    let mut surface =
        (normal.0.pixels()[start], normal.0.pixels()[start].dot(points.0.pixels()[start]));
    // The weight of a normal.
    let inner = |i: usize| {
        let (x, y) = (i % w, i / w);
        let border = x.min(w - 1 - x).min(y).min(h - 1 - y) as f32 + 0.5;
        (border / (TUNING.border * w as f32)).min(1.0)
    };
    // The distance of a pixel from a plane and 1 - cos of its normal's angle, over their limits.
    let off_plane = |(plane, offset): (Vec3, f32), i: usize| {
        let (point, n) = (points.0.pixels()[i], normal.0.pixels()[i]);
        let off = (plane.dot(point) - offset) / (TUNING.off_plane * point.length().max(1e-3));
        [off, inner(i) * (1.0 - n.dot(plane)) / TUNING.normal]
    };
    let square = |terms: [f32; 2]| terms.iter().map(|term| term * term).sum::<f32>();
    for round in 0..TUNING.rounds {
        let members: Vec<usize> = (0..w * h).filter(|&i| found.pixels()[i]).collect();
        let paint = mean_around(&found, &color);
        if round > 0 {
            // The plane of a surface contains its first pixel.
            if let Some(plane) = plane_of(&members, points, normal)
                && square(off_plane((plane.normal, plane.offset), start)) < 1.0
            {
                surface = (plane.normal, plane.offset);
            }
        }
        let gain = |i: usize| {
            let step = color.pixels()[i] - paint.pixels()[i];
            let noise = noise.pixels()[i] / TUNING.chroma;
            let weight = (Vec3::ONE + noise * noise).recip();
            let weight = weight / weight.element_sum();
            let level = step.dot(weight);
            let off_gray = step - Vec3::splat(level);
            let off_paint = [
                (3.0 * weight.dot(off_gray * off_gray)).sqrt() / TUNING.chroma,
                level / TUNING.intensity,
            ];
            let same = [off_paint[0] * TUNING.chroma, level].map(|step| step / TUNING.same_paint);
            let sure = TUNING.sure_paint * (-square(same)).exp();
            let gain = 1.0 + sure - square(off_plane(surface, i)) - square(off_paint);
            (TUNING.unit * gain.max(TUNING.min_gain)) as i32
        };
        let gain = Plane::new(
            w,
            h,
            (0..w * h).map(|i| if i == start { TUNING.sure } else { gain(i) }).collect(),
        );
        let label = graph_cut(&gain, |x, y, nx, ny| {
            let step = (seen.get(x, y) - seen.get(nx, ny)).length() / TUNING.step;
            (TUNING.unit * TUNING.parting * (-step * step).exp()) as i32
        });
        let edges = PhotoEdges::new(&seen, &noise, &faint, &label);
        found = edges.reached(&label, &[start]);
        let reached =
            beside_lamps.iter().filter(|pixels| pixels.iter().any(|&i| found.pixels()[i]));
        let starts: Vec<usize> =
            reached.flatten().copied().filter(|&i| label.pixels()[i]).collect();
        let parts = edges.reached(&label, &starts);
        found.pixels_mut().iter_mut().zip(parts.pixels()).for_each(|(found, part)| *found |= part);
        // The middle pixel of a blurred edge belongs to both sides.
        let beside = |i: usize| {
            label.pixels()[i] && sides((w, h), i).any(|j| found.pixels()[j] && !edges.between(i, j))
        };
        let middle: Vec<usize> = (0..w * h).filter(|&i| !found.pixels()[i] && beside(i)).collect();
        middle.into_iter().for_each(|i| found.pixels_mut()[i] = true);
        if round + 1 == TUNING.rounds {
            let on_plane = |i: usize| off_plane(surface, i).iter().all(|term| term.abs() <= 1.0);
            close_region(&mut found, &label, &seen, on_plane);
        }
    }
    found
}

/// The plane that most of some pixels lie on.
pub(super) fn plane_of(pixels: &[usize], points: &Points, normal: &Normal) -> Option<PlaneFit> {
    let seen = (points.0.pixels(), normal.0.pixels());
    PlaneFit::of_pixels(pixels, seen, TUNING.max_points, TUNING.off_plane)
}

/// Mean of the `values` of a set around each pixel, with weights that fade along both axes.
pub(super) fn mean_around(set: &Plane<bool>, values: &Plane<Vec3>) -> Plane<Vec3> {
    let (w, h) = set.size();
    let fade = (-1.0 / (TUNING.fading * w.max(h) as f32)).exp();
    let pixels = set.pixels().iter().zip(values.pixels());
    let mut sums: Vec<Vec4> =
        pixels.map(|(&is_in, value)| if is_in { value.extend(1.0) } else { Vec4::ZERO }).collect();
    for (lines, to_next_line, count, step) in [(h, w, w, 1), (w, 1, h, w)] {
        for line in 0..lines {
            let at = |i: usize| line * to_next_line + i * step;
            let own: Vec<Vec4> = (0..count).map(|i| sums[at(i)]).collect();
            let mut before = Vec4::ZERO;
            for (i, own) in own.iter().enumerate() {
                sums[at(i)] += before;
                before = fade * (before + *own);
            }
            let mut after = Vec4::ZERO;
            for (i, own) in own.iter().enumerate().rev() {
                sums[at(i)] += after;
                after = fade * (after + *own);
            }
        }
    }
    Plane::new(w, h, sums.into_iter().map(|sum| sum.truncate() / sum.w).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (60, 40);

    /// A back wall that meets a floor in row 30, of one paint; on the wall a framed picture of the
    /// wall's color, before it a post.
    fn room() -> (Picture, Albedo, Points, Normal) {
        let (w, h) = SIZE;
        let post = |x: usize| (40..44).contains(&x);
        let frame = |x: usize, y: usize| {
            (10..24).contains(&x)
                && (6..20).contains(&y)
                && !((12..22).contains(&x) && (8..18).contains(&y))
        };
        let ray = |x: usize, y: usize| Vec3::new(x as f32 - 29.5, 15.0 - y as f32, -50.0) / 50.0;
        let depth = |x: usize, y: usize| match y {
            _ if post(x) => 2.0,
            ..30 => 4.0,
            _ => 4.0 * 15.0 / (y as f32 - 15.0),
        };
        let points = Plane::from_fn(w, h, |x, y| ray(x, y) * depth(x, y));
        let normal =
            Plane::from_fn(w, h, |x, y| if y >= 30 && !post(x) { Vec3::Y } else { Vec3::Z });
        let albedo = Plane::from_fn(w, h, |x, y| Vec3::splat(if frame(x, y) { 0.05 } else { 0.6 }));
        let photo = Plane::from_fn(w, h, |x, y| albedo.get(x, y) * (1.0 - 0.01 * x as f32));
        (Picture(photo), Albedo(albedo), Points(points), Normal(normal))
    }

    fn no_lamp() -> Plane<bool> {
        Plane::filled(SIZE.0, SIZE.1, false)
    }

    #[test]
    fn a_wall_ends_at_the_floor_at_what_stands_before_it_and_at_what_hangs_on_it() {
        let (photo, albedo, points, normal) = room();
        let found = grow_region((30, 10), &photo, &albedo, &points, &normal, None, &no_lamp());
        for (x, y, inside) in [
            (30, 10, true),
            (2, 2, true),
            (2, 28, true),
            (17, 12, false),
            (10, 6, false),
            (42, 10, false),
            (30, 36, false),
        ] {
            assert_eq!(found.get(x, y), inside, "({x}, {y})");
        }
        // The way to the other side of the post is hidden; it is another place of the same wall.
        assert!(!found.get(50, 10));
        let floor = grow_region((10, 37), &photo, &albedo, &points, &normal, None, &no_lamp());
        assert!(floor.get(20, 36) && !floor.get(20, 26));
    }

    #[test]
    fn a_wall_continues_behind_a_lamp_that_it_reaches() {
        let (photo, albedo, points, normal) = room();
        let found = |start: (usize, usize), lamp: std::ops::Range<usize>| {
            let lamp = Plane::from_fn(SIZE.0, SIZE.1, |x, y| lamp.contains(&x) && y < 12);
            grow_region(start, &photo, &albedo, &points, &normal, None, &lamp)
        };
        // The post is a lamp.
        let wall = found((30, 10), 40..44);
        assert!(wall.get(50, 10) && wall.get(50, 28));
        assert!(!wall.get(42, 10) && !wall.get(50, 36) && !wall.get(17, 12));
        // A lamp elsewhere on the hidden part.
        assert!(!found((30, 10), 52..55).get(50, 10));
        // The picture in the frame reaches no lamp.
        assert!(!found((17, 12), 40..44).get(50, 10));
    }

    #[test]
    fn noise_is_no_edge() {
        let (mut photo, albedo, points, normal) = room();
        for (i, pixel) in photo.0.pixels_mut().iter_mut().enumerate() {
            let noise = |c: usize| ((3 * i + c) * 7919 % 1009) as f32 / 1009.0 - 0.5;
            *pixel *= Vec3::ONE + 0.3 * Vec3::new(noise(0), noise(1), noise(2));
        }
        let found = grow_region((30, 10), &photo, &albedo, &points, &normal, None, &no_lamp());
        let (wall, inside) = (0..30 * SIZE.0)
            .filter(|i| i % SIZE.0 < 40 && albedo.0.pixels()[*i].x > 0.1)
            .fold((0, 0), |(all, inside), i| (all + 1, inside + usize::from(found.pixels()[i])));
        // All but the hundred pixels that the frame holds.
        assert!(inside + 100 >= wall && inside > 0 && !found.get(17, 12), "{inside} of {wall}");
    }

    #[test]
    fn a_wall_keeps_the_dim_part_with_the_first_pixel() {
        let (_, _, points, normal) = room();
        // To the right a lamp makes the estimated paint less and less yellow, at first quickly.
        let paint = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let less_yellow = 0.12 * x.min(8) as f32 + 0.02 * x.clamp(8, 36) as f32;
            let blue = 0.05 * less_yellow.exp();
            if y < 30 { Vec3::new(0.5, 0.45, blue) } else { Vec3::new(0.5, 0.1, 0.05) }
        });
        let photo = Picture(paint.clone());
        let found =
            grow_region((2, 10), &photo, &Albedo(paint), &points, &normal, None, &no_lamp());
        let inside = [(1, 10), (2, 14), (20, 10), (36, 10)].map(|(x, y)| found.get(x, y));
        assert_eq!(inside, [true; 4]);
        assert!(!found.get(20, 36), "the floor");
    }

    #[test]
    fn a_faint_edge_ends_a_wall_whose_depth_goes_on() {
        let (photo, albedo, points, normal) = room();
        let found = |step: f32| {
            let brighter = |y: usize| if y < 5 { step.exp() } else { 1.0 };
            let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| photo.0.get(x, y) * brighter(y));
            grow_region((30, 12), &Picture(photo), &albedo, &points, &normal, None, &no_lamp())
        };
        let row = |found: &Plane<bool>, y: usize| (26..38).all(|x| found.get(x, y));
        let (faint, none) = (found(0.2), found(0.05));
        assert!(row(&faint, 5) && !(0..SIZE.0).any(|x| faint.get(x, 3)));
        assert!(row(&none, 5) && row(&none, 1));
    }

    #[test]
    fn depth_that_errs_does_not_part_a_wall_of_one_paint() {
        let (photo, albedo, points, normal) = room();
        let part = |x: usize, y: usize| (26..37).contains(&x) && (3..15).contains(&y);
        let found = |nearer: f32, darker: f32| {
            let scale = |x, y, scale: f32| if part(x, y) { scale } else { 1.0 };
            let points =
                Plane::from_fn(SIZE.0, SIZE.1, |x, y| points.0.get(x, y) * scale(x, y, nearer));
            let [photo, albedo] = [&photo.0, &albedo.0].map(|plane| {
                Plane::from_fn(SIZE.0, SIZE.1, |x, y| plane.get(x, y) * scale(x, y, darker))
            });
            let (photo, albedo, points) = (Picture(photo), Albedo(albedo), Points(points));
            grow_region((30, 20), &photo, &albedo, &points, &normal, None, &no_lamp()).get(31, 8)
        };
        assert!(found(0.955, 1.0));
        assert!(!found(0.955, 0.8), "another paint");
        assert!(!found(0.9, 1.0), "something before the wall");
    }

    #[test]
    fn normals_at_the_border_of_the_photo_count_less() {
        let (photo, albedo, points, normal) = room();
        let found = |rows: std::ops::Range<usize>| {
            let normal = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                if rows.contains(&y) { -Vec3::Y } else { normal.0.get(x, y) }
            });
            let normal = Normal(normal);
            grow_region((30, 20), &photo, &albedo, &points, &normal, None, &no_lamp())
                .get(30, rows.start)
        };
        assert!(found(0..2));
        assert!(!found(10..16));
    }

    #[test]
    fn a_blurred_edge_parts_a_wall_from_its_baseboard() {
        let (_, _, points, normal) = room();
        // Brighter by exp(0.54) from row 25 on, over two rows here and there.
        let brighter = |x: usize, y: usize| match y {
            ..24 => 0.0,
            24 => [0.0, 0.1, 0.27, 0.44][x / 2 % 4],
            _ => 0.54,
        };
        let paint =
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| Vec3::splat(0.3 * f32::exp(brighter(x, y))));
        let photo = Picture(paint.clone());
        let found =
            grow_region((30, 10), &photo, &Albedo(paint), &points, &normal, None, &no_lamp());
        assert!((0..40).all(|x| found.get(x, 23) && !found.get(x, 25)));
    }

    #[test]
    fn a_channel_that_is_noise_does_not_part_a_wall() {
        let (_, _, points, normal) = room();
        let noise = |x: usize, y: usize| ((y * 641 + x) * 7919 % 1009) as f32 / 1009.0;
        let wall = |x: usize, y: usize| Vec3::new(0.2, 0.15, 0.004 + 0.02 * noise(x, y).powi(2));
        let photo = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            if y < 30 { wall(x, y) } else { Vec3::new(0.2, 0.15, 0.2) }
        });
        let reflectance = Albedo(photo.map(|c| 3.0 * c));
        let photo = Picture(photo);
        let count = |grain: Option<&Grain>| {
            let found =
                grow_region((30, 10), &photo, &reflectance, &points, &normal, grain, &no_lamp());
            (0..30 * SIZE.0).filter(|&i| found.pixels()[i]).count()
        };
        let grain = Grain::measure(&Picture(Plane::from_fn(400, 300, wall))).expect("it has noise");
        // The wall up to the post.
        assert_eq!(count(Some(&grain)), 40 * 30);
        assert!(count(None) < 40 * 30);
    }

    #[test]
    fn one_pixel_is_a_surface() {
        let one = |v: Vec3| Plane::filled(1, 1, v);
        let found = grow_region(
            (0, 0),
            &Picture(one(Vec3::ONE)),
            &Albedo(one(Vec3::ONE)),
            &Points(one(-Vec3::Z)),
            &Normal(one(Vec3::Z)),
            None,
            &Plane::filled(1, 1, false),
        );
        assert!(found.get(0, 0));
    }
}
