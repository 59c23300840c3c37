//! Outlines and names drawn into a picture.

use glam::Vec3;

use crate::image::Plane;

/// Draws the inner edge of `mask`, which has the picture's size, and `name` above it; both grow
/// with the picture. Of a name, small letters of `GLYPHS`, digits and `_` are drawn, others left
/// blank.
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
    // A dark field with a margin of one dot keeps the name legible on anything.
    let (width, height) = (scale * (6 * name.len() + 1), scale * 9);
    let (left, top) = (left.min(w.saturating_sub(width)), top.saturating_sub(height));
    for (x, y) in (0..height.min(h)).flat_map(|y| (0..width.min(w)).map(move |x| (x, y))) {
        let (column, row) = (x / scale, y / scale);
        let letter = name.as_bytes().get(column.wrapping_sub(1) / 6).copied();
        let dot = column > 0
            && row > 0
            && letter.is_some_and(|letter| lit(letter, (column - 1) % 6, row - 1));
        picture.set(left + x, top + y, if dot { color } else { Vec3::ZERO });
    }
}

fn lit(letter: u8, column: usize, row: usize) -> bool {
    let rows = GLYPHS.iter().find(|(name, _)| *name == letter).map(|(_, rows)| rows);
    rows.is_some_and(|rows| column < 5 && row < 7 && rows[row] >> (4 - column) & 1 == 1)
}

/// Letters of 5 x 7 dots, a row a number.
const GLYPHS: [(u8, [u8; 7]); 20] = [
    (b'a', [0, 0, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111]),
    (b'd', [0b00001, 0b00001, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111]),
    (b'i', [0b00100, 0, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'l', [0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'm', [0, 0, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101]),
    (b'n', [0, 0, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001]),
    (b'o', [0, 0, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    (b'p', [0, 0, 0b11110, 0b10001, 0b11110, 0b10000, 0b10000]),
    (b'w', [0, 0, 0b10001, 0b10101, 0b10101, 0b10101, 0b01010]),
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
