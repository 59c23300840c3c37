//! The photometric web of a luminaire: its luminous intensity by direction, from files of IES
//! LM-63.
//!
//! A web is a far field: the luminous intensity I(direction), candela, of a body that is small
//! beside its distance. The relative intensity is g = 4 pi I / F with F = integral of I over all
//! directions, the luminous flux, so that g is 1 for a body that emits evenly. Type C photometry: v
//! is the angle from the luminaire's axis, which points down when it hangs, h the angle about it.
//! Source: ANSI/IES LM-63-02; intensity between the angles of the file is bilinear in them.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::image::rule;
use crate::tuning::tuning;

/// Most values of a table; a file with more is refused before memory is allocated.
const MAX_VALUES: usize = 1 << 20;

/// A table of relative intensity and the orientation of its luminaire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotometricWeb {
    /// The direction of v = 0; unit length.
    pub axis: Vec3,
    /// The direction of v = 90 degrees, h = 0; unit length, orthogonal to the axis.
    pub side: Vec3,
    /// The relative intensity by angle.
    pub table: PhotometricWebTable,
}

/// A table of the relative intensity g = 4 pi I / F by angle in degrees.
///
/// ```
/// use relight::optics::PhotometricWebTable;
///
/// // 100 cd straight down, 50 at 45 degrees, none from 90, the same all around.
/// let file = "IESNA91\nTILT=NONE\n1 -1 1 3 1 1 2 0 0 0\n1 1 1\n0 45 90\n0\n100 50 0\n";
/// let (_, lumens) = PhotometricWebTable::parse(file)?;
/// assert!((lumens - 228.3).abs() < 0.1);
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotometricWebTable {
    /// Ascending, at least two.
    vertical: Vec<f32>,
    /// Ascending from 0 to 360, or a single 0 for a web that is the same all around.
    horizontal: Vec<f32>,
    /// Relative intensity, row by row: a row per horizontal angle, a column per vertical one.
    intensity: Vec<f32>,
}

impl PhotometricWeb {
    /// The relative intensity g, 0 or more, in a unit `direction` away from the lamp; 0 outside of
    /// the table.
    pub fn relative_intensity(&self, direction: DVec3) -> f64 {
        let (axis, side) = (self.axis.as_dvec3(), self.side.as_dvec3());
        let (along, across, third) =
            (direction.dot(axis), direction.dot(side), direction.dot(axis.cross(side)));
        let v = across.hypot(third).atan2(along).to_degrees();
        let h = third.atan2(across).to_degrees().rem_euclid(360.0);
        self.table.relative_intensity(v, h)
    }
}

impl PhotometricWebTable {
    /// The consistency of a table that was read from disk: a value for each pair of angles, and
    /// angles that ascend.
    ///
    /// # Errors
    /// The rule that is broken.
    pub(in crate::optics) fn check(&self) -> Result<(), String> {
        let cells = self.vertical.len().checked_mul(self.horizontal.len());
        rule(cells == Some(self.intensity.len()), "a share for each pair of angles")?;
        rule(
            self.vertical.len() >= 2 && !self.horizontal.is_empty(),
            "two vertical angles and a horizontal one",
        )?;
        let ascend = |angles: &[f32]| angles.windows(2).all(|pair| pair[0] < pair[1]);
        rule(ascend(&self.vertical) && ascend(&self.horizontal), "angles that ascend")
    }

    /// The bilinear interpolation at angles in degrees; 0 outside of the table.
    fn relative_intensity(&self, v: f64, h: f64) -> f64 {
        let Some((i, s)) = between(&self.vertical, v) else { return 0.0 };
        let (j, t) = between(&self.horizontal, h).unwrap_or((0, 0.0));
        let rows = self.horizontal.len();
        let at = |j: usize, i: usize| {
            f64::from(self.intensity[j.min(rows - 1) * self.vertical.len() + i])
        };
        let row = |j: usize| at(j, i) * (1.0 - s) + at(j, i + 1) * s;
        row(j) * (1.0 - t) + row(j + 1) * t
    }

    /// The memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * (self.vertical.len() + self.horizontal.len() + self.intensity.len())
    }

    /// The table of an LM-63 file, and the luminous flux to which its candela sum, lumens.
    ///
    /// # Errors
    /// A message with the wanted and the given text for a file that is not LM-63, has a tilt in
    /// another file, is not type C photometry, has more than 2^20 values, angles that do not
    /// ascend, or candela that are negative or all zero.
    pub fn parse(text: &str) -> Result<(PhotometricWebTable, f64), String> {
        let (_, after) = text
            .match_indices("TILT=")
            .find(|(at, _)| *at == 0 || text[..*at].ends_with(['\n', '\r']))
            .map(|(at, _)| text.split_at(at + "TILT=".len()))
            .ok_or(
                "wanted a photometric file of IES LM-63, got none: the line `TILT=` is missing",
            )?;
        let (tilt, body) = after.split_once(['\n', '\r']).unwrap_or((after, ""));
        let mut numbers = Numbers {
            words: body.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()),
        };
        match tilt.trim() {
            "NONE" => {}
            // The dependence of the output on the tilt of the lamp; the candela below are as
            // measured, without tilt.
            "INCLUDE" => {
                numbers.next("lamp to luminaire geometry")?;
                let count = numbers.count("tilt angles")?;
                numbers.many(2 * count, "tilt angles and factors")?;
            }
            other => {
                return Err(format!("wanted TILT=NONE or TILT=INCLUDE, got TILT={}", short(other)));
            }
        }
        numbers.next("number of lamps")?;
        numbers.next("lumens per lamp")?;
        let mut scale = numbers.next("candela multiplier")?;
        let (verticals, horizontals) =
            (numbers.count("vertical angles")?, numbers.count("horizontal angles")?);
        let kind = numbers.next("photometric type")?;
        if kind != 1.0 {
            return Err(format!("wanted type C photometry (1), got type {kind}"));
        }
        numbers.many(4, "units and sizes")?;
        scale *= numbers.next("ballast factor")?;
        numbers.many(2, "ballast lamp factor and input watts")?;
        if verticals < 2 || verticals * horizontals > MAX_VALUES {
            return Err(format!(
                "wanted at least 2 vertical angles and {MAX_VALUES} values at most, got {verticals} x {horizontals}"
            ));
        }
        let vertical = ascending(numbers.many(verticals, "vertical angles")?, 180.0, "vertical")?;
        let horizontal =
            ascending(numbers.many(horizontals, "horizontal angles")?, 360.0, "horizontal")?;
        let candela: Vec<f64> = numbers
            .many(verticals * horizontals, "candela values")?
            .into_iter()
            .map(|value| value * scale)
            .collect();
        if let Some(bad) = candela.iter().find(|value| !(**value >= 0.0 && value.is_finite())) {
            return Err(format!("wanted candela of 0 or more, got {bad}"));
        }
        let (horizontal, candela) = all_around(&horizontal, candela, verticals)?;
        let flux = flux(&vertical, &horizontal, &candela);
        if !(flux > 0.0 && flux.is_finite()) {
            return Err(format!("wanted a luminaire with flux above 0, got {flux} lumens"));
        }
        let single =
            |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<f32>>();
        let intensity: Vec<f64> =
            candela.iter().map(|value| 4.0 * std::f64::consts::PI * value / flux).collect();
        let [vertical, horizontal, intensity] =
            [&vertical, &horizontal, &intensity].map(|values| single(values));
        Ok((PhotometricWebTable { vertical, horizontal, intensity }, flux))
    }
}

tuning! {
    /// Constants of photometric tables.
    pub const TUNING: PhotometricWebTuning {
        /// Tolerance of the first and last angle of a table.
        angle_slack: f64 = 1e-4,
            unit "degrees", source Derived("single precision"),
            effect "a larger value emits beyond the ends of a table";
    }
}

/// The index of the angle before `at`, and the fraction of the interval before the next at which
/// `at` lies; `None` outside.
fn between(angles: &[f32], at: f64) -> Option<(usize, f64)> {
    let (first, last) = (f64::from(*angles.first()?), f64::from(*angles.last()?));
    if angles.len() < 2 || !(first - TUNING.angle_slack..=last + TUNING.angle_slack).contains(&at) {
        return None;
    }
    let next = angles.partition_point(|angle| f64::from(*angle) <= at).clamp(1, angles.len() - 1);
    let (low, high) = (f64::from(angles[next - 1]), f64::from(angles[next]));
    Some((next - 1, ((at - low) / (high - low)).clamp(0.0, 1.0)))
}

/// An iterator over the numbers of a text.
struct Numbers<I> {
    words: I,
}

impl<'a, I: Iterator<Item = &'a str>> Numbers<I> {
    fn next(&mut self, what: &str) -> Result<f64, String> {
        let word =
            self.words.next().ok_or_else(|| format!("wanted {what}, got the end of the file"))?;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(format!("wanted {what}, got `{}`", short(word))),
        }
    }

    fn count(&mut self, what: &str) -> Result<usize, String> {
        let number = self.next(&format!("the number of {what}"))?;
        let whole = number.fract() == 0.0 && (1.0..=MAX_VALUES as f64).contains(&number);
        whole
            .then_some(number as usize)
            .ok_or_else(|| format!("wanted the number of {what}, got {number}"))
    }

    fn many(&mut self, count: usize, what: &str) -> Result<Vec<f64>, String> {
        (0..count).map(|_| self.next(what)).collect()
    }
}

fn short(word: &str) -> String {
    word.chars().take(40).collect()
}

fn ascending(angles: Vec<f64>, most: f64, what: &str) -> Result<Vec<f64>, String> {
    let within = angles.iter().all(|angle| (0.0..=most).contains(angle));
    if within && angles.windows(2).all(|pair| pair[0] < pair[1]) {
        Ok(angles)
    } else {
        Err(format!("wanted {what} angles ascending within 0..={most} degrees, got {angles:?}")
            .chars()
            .take(200)
            .collect())
    }
}

/// The horizontal angles from 0 to 360 and their candela, from a file that may contain a half or a
/// quarter of a symmetric luminaire.
fn all_around(
    given: &[f64],
    candela: Vec<f64>,
    verticals: usize,
) -> Result<(Vec<f64>, Vec<f64>), String> {
    if given.len() == 1 {
        return Ok((vec![0.0], candela));
    }
    let (first, last) = (given[0], given[given.len() - 1]);
    // The angle of the file that stands for an angle in 0..=360.
    let folded: fn(f64) -> f64 = match (first, last) {
        (0.0, 90.0) => |h| {
            let h = h % 180.0;
            if h > 90.0 { 180.0 - h } else { h }
        },
        (0.0, 180.0) => |h| if h > 180.0 { 360.0 - h } else { h },
        (90.0, 270.0) => |h| if (90.0..=270.0).contains(&h) { h } else { (540.0 - h) % 360.0 },
        (0.0, 360.0) => |h| h,
        (0.0, last) if last < 360.0 && last > 180.0 => {
            // All around but for the last angle, which is the first again.
            let mut horizontal = given.to_vec();
            horizontal.push(360.0);
            let closed = candela.iter().chain(&candela[..verticals]).copied().collect();
            return Ok((horizontal, closed));
        }
        _ => {
            return Err(format!(
                "wanted horizontal angles of 0 alone, 0..90, 0..180, 90..270 or 0..360, got {first}..{last}"
            ));
        }
    };
    let mut horizontal: Vec<f64> = match (first, last) {
        (0.0, 90.0) => (0..4)
            .flat_map(|quarter| {
                let turned = |h: &f64| if quarter % 2 == 0 { *h } else { 90.0 - h };
                given
                    .iter()
                    .map(move |h| 90.0 * f64::from(quarter) + turned(h))
                    .collect::<Vec<f64>>()
            })
            .collect(),
        (0.0, 180.0) => given.iter().copied().chain(given.iter().map(|h| 360.0 - h)).collect(),
        (90.0, 270.0) => given
            .iter()
            .copied()
            .chain(given.iter().map(|h| (540.0 - h) % 360.0))
            .chain([0.0, 360.0])
            .collect(),
        _ => given.to_vec(),
    };
    horizontal.sort_by(f64::total_cmp);
    horizontal.dedup();
    let at = |h: f64, v: usize| {
        let next = given.partition_point(|g| *g <= h).clamp(1, given.len() - 1);
        let t = ((h - given[next - 1]) / (given[next] - given[next - 1])).clamp(0.0, 1.0);
        candela[(next - 1) * verticals + v] * (1.0 - t) + candela[next * verticals + v] * t
    };
    let rows = horizontal
        .iter()
        .flat_map(|h| (0..verticals).map(|v| at(folded(*h), v)).collect::<Vec<f64>>())
        .collect();
    Ok((horizontal, rows))
}

/// The integral of the bilinear table over all directions, in closed form: between two vertical
/// angles, with I = a + b v, the integral of I sin v is [-(a + b v) cos v + b sin v].
fn flux(vertical: &[f64], horizontal: &[f64], candela: &[f64]) -> f64 {
    let row = |j: usize| -> f64 {
        let row = &candela[j * vertical.len()..(j + 1) * vertical.len()];
        let contributions = vertical.windows(2).zip(row.windows(2)).map(|(v, i)| {
            let (from, to) = (v[0].to_radians(), v[1].to_radians());
            let b = (i[1] - i[0]) / (to - from);
            let whole = |v: f64, i: f64| -i * v.cos() + b * v.sin();
            whole(to, i[1]) - whole(from, i[0])
        });
        contributions.sum()
    };
    if horizontal.len() == 1 {
        return 2.0 * std::f64::consts::PI * row(0);
    }
    let rows: Vec<f64> = (0..horizontal.len()).map(row).collect();
    let turns = horizontal.windows(2).zip(rows.windows(2));
    turns.map(|(h, row)| 0.5 * (row[0] + row[1]) * (h[1] - h[0]).to_radians()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A file of these angles and this intensity.
    fn file(vertical: &[f64], horizontal: &[f64], candela: impl Fn(f64, f64) -> f64) -> String {
        let list = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let rows = horizontal
            .iter()
            .map(|h| list(&vertical.iter().map(|v| candela(*v, *h)).collect::<Vec<_>>()));
        format!(
            "IESNA:LM-63-2002\r\n[TEST] ours\r\nTILT=NONE\r\n1 -1 2.0 {} {} 1 2 0.1 0.1 0\r\n0.5 1 10\r\n{}\r\n{}\r\n{}\r\n",
            vertical.len(),
            horizontal.len(),
            list(vertical),
            list(horizontal),
            rows.collect::<Vec<_>>().join("\r\n")
        )
    }

    fn steps(to: f64, by: f64) -> Vec<f64> {
        (0..=(to / by).round() as usize).map(|i| i as f64 * by).collect()
    }

    #[test]
    fn candela_sum_to_lumens() {
        let even = |_: f64, _: f64| 1000.0 / (4.0 * PI);
        for horizontal in [
            vec![0.0],
            steps(90.0, 30.0),
            steps(180.0, 45.0),
            steps(360.0, 90.0),
            vec![90.0, 180.0, 270.0],
        ] {
            let (table, flux) =
                PhotometricWebTable::parse(&file(&steps(180.0, 45.0), &horizontal, even))
                    .expect("it is sound");
            assert!((flux / 1000.0 - 1.0).abs() < 1e-12, "{horizontal:?}: {flux}");
            assert!((table.relative_intensity(77.0, 200.0) - 1.0).abs() < 1e-6);
        }
        // A Lambertian disc of 100 cd gives 100 pi lumens; steps of one degree are flat to 4e-5 of
        // it.
        let disc = |v: f64, _: f64| 100.0 * v.to_radians().cos();
        let (table, flux) = PhotometricWebTable::parse(&file(&steps(90.0, 1.0), &[0.0], disc))
            .expect("it is sound");
        assert!((flux / (100.0 * PI) - 1.0).abs() < 1e-4, "{flux}");
        assert!((table.relative_intensity(60.0, 0.0) - 4.0 * 0.5).abs() < 1e-3, "g = 4 cos v");
        assert_eq!(
            table.relative_intensity(91.0, 0.0),
            0.0,
            "nothing outside of the file's angles"
        );
    }

    #[test]
    fn halves_and_quarters_are_unfolded() {
        // Twice as strong along h = 0 as along h = 90.
        let long = |_: f64, h: f64| 1.5 + 0.5 * (2.0 * h).to_radians().cos();
        let whole = PhotometricWebTable::parse(&file(&[0.0, 90.0], &steps(360.0, 15.0), long))
            .expect("it is sound");
        for horizontal in [
            steps(90.0, 15.0),
            steps(180.0, 15.0),
            steps(345.0, 15.0),
            steps(180.0, 15.0).iter().map(|h| h + 90.0).collect(),
        ] {
            let (table, flux) = PhotometricWebTable::parse(&file(&[0.0, 90.0], &horizontal, long))
                .expect("it is sound");
            assert!((flux / whole.1 - 1.0).abs() < 1e-9, "{horizontal:?}");
            for h in [0.0, 20.0, 100.0, 170.0, 260.0, 359.0] {
                assert!(
                    (table.relative_intensity(45.0, h) - whole.0.relative_intensity(45.0, h)).abs()
                        < 1e-5,
                    "{horizontal:?} at {h}"
                );
            }
        }
    }

    #[test]
    fn a_luminaire_can_be_turned() {
        let half = |_: f64, h: f64| if h < 180.0 { 2.0 } else { 0.0 };
        let (table, _) = PhotometricWebTable::parse(&file(&[0.0, 180.0], &steps(360.0, 1.0), half))
            .expect("it is sound");
        let web = PhotometricWeb { axis: Vec3::NEG_Y, side: Vec3::X, table };
        // h grows from `side` towards axis x side = -y x x = z.
        assert!(web.relative_intensity(DVec3::new(0.0, -0.1, 1.0).normalize()) > 1.9);
        assert_eq!(web.relative_intensity(DVec3::new(0.0, -0.1, -1.0).normalize()), 0.0);
    }

    #[test]
    fn messages_name_the_fault() {
        let sound = file(&[0.0, 90.0], &[0.0], |_, _| 1.0);
        for (text, wanted) in [
            (String::new(), "the line `TILT=` is missing"),
            (sound.replace("TILT=NONE", "TILT=lamp.tlt"), "got TILT=lamp.tlt"),
            (sound.replace("2 1 1 2", "2 1 2 2"), "wanted type C photometry (1), got type 2"),
            (sound.replace("0 90", "90 0"), "wanted vertical angles ascending"),
            (sound.replace("0 90", "0 nine"), "wanted vertical angles, got `nine`"),
            (sound.replace("2 1 1 2", "2 7 1 2"), "wanted horizontal angles"),
            (sound.replace("2 1 1 2", "900000 900000 1 2"), "values at most"),
            (
                sound.replace("2 1 1 2", "2.5 1 1 2"),
                "wanted the number of vertical angles, got 2.5",
            ),
            (sound.replace("\r\n1 1\r\n", "\r\n1 -1\r\n"), "wanted candela of 0 or more, got -1"),
            (
                sound.replace("\r\n1 1\r\n", "\r\n0 0\r\n"),
                "wanted a luminaire with flux above 0, got 0 lumens",
            ),
            (
                sound.replace("\r\n1 1\r\n", "\r\n1\r\n"),
                "wanted candela values, got the end of the file",
            ),
        ] {
            let message = PhotometricWebTable::parse(&text).expect_err("it is not sound");
            assert!(message.contains(wanted), "wanted {wanted:?}, got {message:?}");
        }
        let tilted = sound.replace("TILT=NONE\r\n", "TILT=INCLUDE\r\n1\r\n2\r\n0 90\r\n1 1\r\n");
        assert!(PhotometricWebTable::parse(&tilted).is_ok());
    }
}
