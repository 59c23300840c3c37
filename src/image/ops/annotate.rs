//! Outlines, lines and text drawn into a picture.

use glam::{Vec2, Vec3};

use crate::image::Plane;

/// Draws the inner edge of `mask`, which has the picture's size, and `name` above it; both grow
/// with the picture. Of a name, small letters, digits and `_` are drawn as in [`write_text`].
///
/// # Panics
/// The sizes differ.
pub fn annotate(picture: &mut Plane<Vec3>, mask: &Plane<bool>, name: &str, color: Vec3) {
    let (w, h) = picture.size();
    assert_eq!(mask.size(), (w, h), "mask and picture have one size");
    let scale = (w.max(h) / 320).max(1);
    let outside = |x: usize, y: usize, dx: isize, dy: isize| {
        let at = x.checked_add_signed(dx).zip(y.checked_add_signed(dy));
        at.is_none_or(|(x, y)| x >= w || y >= h || !mask.get(x, y))
    };
    let reach = scale as isize;
    let (mut left, mut top) = (w, h);
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| mask.get(x, y))
    {
        (left, top) = (left.min(x), top.min(y));
        if [(-reach, 0), (reach, 0), (0, -reach), (0, reach)]
            .iter()
            .any(|&(dx, dy)| outside(x, y, dx, dy))
        {
            picture.set(x, y, color);
        }
    }
    if left == w {
        return;
    }
    let (width, height) = text_size(name, scale);
    let corner = (left.min(w.saturating_sub(width)), top.saturating_sub(height));
    write_text(picture, corner, name, color, scale);
}

/// Columns and rows that a text covers, with dots of `scale` pixels.
pub fn text_size(text: &str, scale: usize) -> (usize, usize) {
    (scale * (6 * text.len() + 1), scale * 9)
}

/// Writes a text with its upper left corner at a pixel, with dots of `scale` pixels; what lies
/// outside of the picture is cut off. Small letters (but j, q, v, x and z), digits, `_` and `.`
/// are drawn, other characters are left blank.
pub fn write_text(
    picture: &mut Plane<Vec3>,
    (left, top): (usize, usize),
    text: &str,
    color: Vec3,
    scale: usize,
) {
    // A dark field with a margin of one dot keeps the text legible on anything.
    let (width, height) = text_size(text, scale);
    let (w, h) = picture.size();
    let (right, bottom) = ((left + width).min(w), (top + height).min(h));
    for (x, y) in (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))) {
        let (column, row) = ((x - left) / scale, (y - top) / scale);
        let letter = text.as_bytes().get(column.wrapping_sub(1) / 6).copied();
        let dot = column > 0
            && row > 0
            && letter.is_some_and(|letter| lit(letter, (column - 1) % 6, row - 1));
        picture.set(x, y, if dot { color } else { Vec3::ZERO });
    }
}

/// Blends a line of a width in pixels into the picture: a pixel gets the fraction of the color by
/// which it lies within half the width of the line (pixel centers at + 0.5). Places need not lie in
/// the picture.
pub fn draw_line(picture: &mut Plane<Vec3>, from: Vec2, to: Vec2, color: Vec3, width: f32) {
    let (w, h) = picture.size();
    let Some((from, to)) = clip_line(from, to, Vec2::new(w as f32, h as f32), width + 1.0) else {
        return;
    };
    let way = to - from;
    let is_steep = way.y.abs() > way.x.abs();
    let (major, minor) = if is_steep { (1, 0) } else { (0, 1) };
    let size = [w, h];
    let ends = [from[major].min(to[major]), from[major].max(to[major])];
    let first = (ends[0] - width).floor().max(0.0) as usize;
    let last = ((ends[1] + width).ceil().max(0.0) as usize).min(size[major]);
    for step in first..last {
        let along = ((step as f32 + 0.5).clamp(ends[0], ends[1]) - from[major]) / way[major];
        let middle = from[minor] + if along.is_finite() { along * way[minor] } else { 0.0 };
        // A diagonal line is wider along an axis than across itself.
        let reach = 1.5 * (0.5 * width + 1.0);
        let low = (middle - reach).floor().max(0.0) as usize;
        let high = ((middle + reach).ceil().max(0.0) as usize).min(size[minor]);
        for across in low..high {
            let (x, y) = if is_steep { (across, step) } else { (step, across) };
            let off = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) - from;
            let at = (off.dot(way) / way.length_squared().max(1e-12)).clamp(0.0, 1.0);
            let covered = (0.5 * width + 0.5 - off.distance(way * at)).clamp(0.0, 1.0);
            picture.set(x, y, picture.get(x, y).lerp(color, covered));
        }
    }
}

/// The part of a line within a picture of this size and a margin around it (Liang and Barsky, ACM
/// TOG 1984), pixels. `None` where it lies outside or has no finite ends.
pub fn clip_line(from: Vec2, to: Vec2, size: Vec2, margin: f32) -> Option<(Vec2, Vec2)> {
    let way = to - from;
    let (mut enter, mut leave) = (0.0f32, 1.0f32);
    for axis in 0..2 {
        let (low, high) = (-margin - from[axis], size[axis] + margin - from[axis]);
        if way[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / way[axis], high / way[axis]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    (enter <= leave && from.is_finite() && to.is_finite())
        .then(|| (from + way * enter, from + way * leave))
}

fn lit(letter: u8, column: usize, row: usize) -> bool {
    let rows = GLYPHS.iter().find(|(name, _)| *name == letter).map(|(_, rows)| rows);
    rows.is_some_and(|rows| column < 5 && row < 7 && rows[row] >> (4 - column) & 1 == 1)
}

/// Letters of 5 x 7 dots, a row a number.
const GLYPHS: [(u8, [u8; 7]); 33] = [
    (b'a', [0, 0, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111]),
    (b'b', [0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b11110]),
    (b'c', [0, 0, 0b01111, 0b10000, 0b10000, 0b10000, 0b01111]),
    (b'd', [0b00001, 0b00001, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111]),
    (b'e', [0, 0, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
    (b'f', [0b00110, 0b01001, 0b01000, 0b11100, 0b01000, 0b01000, 0b01000]),
    (b'g', [0, 0b01111, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    (b'h', [0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001]),
    (b'i', [0b00100, 0, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'k', [0b10000, 0b10000, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010]),
    (b'l', [0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'm', [0, 0, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101]),
    (b'n', [0, 0, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001]),
    (b'o', [0, 0, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    (b'p', [0, 0, 0b11110, 0b10001, 0b11110, 0b10000, 0b10000]),
    (b'r', [0, 0, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    (b's', [0, 0, 0b01111, 0b10000, 0b01110, 0b00001, 0b11110]),
    (b't', [0b01000, 0b01000, 0b11100, 0b01000, 0b01000, 0b01001, 0b00110]),
    (b'u', [0, 0, 0b10001, 0b10001, 0b10001, 0b10011, 0b01101]),
    (b'w', [0, 0, 0b10001, 0b10101, 0b10101, 0b10101, 0b01010]),
    (b'y', [0, 0, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    (b'.', [0, 0, 0, 0, 0, 0b01100, 0b01100]),
    (b'_', [0, 0, 0, 0, 0, 0, 0b11111]),
    (b'0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    (b'1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    (b'3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    (b'4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    (b'5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    (b'6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    (b'7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    (b'8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    (b'9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_and_the_name_are_drawn_and_the_inside_stays() {
        let mut picture = Plane::filled(60, 40, Vec3::splat(0.5));
        let mask = Plane::from_fn(60, 40, |x, y| (10..30).contains(&x) && (20..35).contains(&y));
        annotate(&mut picture, &mask, "lamp_0", Vec3::X);
        assert_eq!((picture.get(10, 27), picture.get(29, 34)), (Vec3::X, Vec3::X));
        assert_eq!(
            (picture.get(15, 27), picture.get(31, 27)),
            (Vec3::splat(0.5), Vec3::splat(0.5))
        );
        // `l` starts a dot right of and below the corner of its field.
        let rows =
            |y: usize| (11..16).map(|x| picture.get(x, 11 + 1 + y) == Vec3::X).collect::<Vec<_>>();
        assert_eq!(rows(0), [false, true, true, false, false]);
        assert_eq!(rows(6), [false, true, true, true, false]);
    }

    #[test]
    fn a_line_covers_its_area_at_any_angle_and_stays_in_the_picture() {
        let middle = Vec2::new(40.3, 30.6);
        for degrees in [0.0f32, 10.0, 45.0, 63.0, 90.0, 135.0, 271.0] {
            let way = Vec2::from_angle(degrees.to_radians()) * 20.0;
            let mut picture = Plane::filled(80, 60, Vec3::ZERO);
            draw_line(&mut picture, middle - way, middle + way, Vec3::X, 2.0);
            let covered: f32 = picture.pixels().iter().map(|c| c.x).sum();
            // Two round ends add a circle of the width.
            let wanted = 40.0 * 2.0 + std::f32::consts::PI;
            assert!((covered - wanted).abs() < 0.06 * wanted, "{degrees}: {covered}, not {wanted}");
        }
        let mut picture = Plane::filled(80, 60, Vec3::ZERO);
        draw_line(&mut picture, Vec2::new(-1e7, 30.5), Vec2::new(1e7, 30.5), Vec3::X, 1.0);
        assert!((0..80).all(|x| picture.get(x, 30).x > 0.9), "a long line crosses all columns");
        let before = picture.clone();
        draw_line(&mut picture, Vec2::new(-50.0, 9.0), Vec2::new(-9.0, 70.0), Vec3::X, 3.0);
        draw_line(&mut picture, Vec2::NAN, Vec2::new(9.0, 7.0), Vec3::X, 3.0);
        assert_eq!(picture, before, "a line outside and one without a place draw nothing");
    }

    #[test]
    fn a_tiny_picture_and_an_empty_mask_are_no_fault() {
        for size in [(1, 1), (3, 2), (70, 5)] {
            for full in [false, true] {
                let mut picture = Plane::filled(size.0, size.1, Vec3::ONE);
                annotate(&mut picture, &Plane::filled(size.0, size.1, full), "window_12", Vec3::X);
                assert_eq!(picture == Plane::filled(size.0, size.1, Vec3::ONE), !full);
            }
        }
    }
}
