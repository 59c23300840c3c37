//! Edits of roughness and specular level.

use serde::{Deserialize, Serialize};

use crate::image::{Plane, Roughness};
use crate::tuning::tuning;

tuning! {
    /// Constants of edits of roughness and specular level.
    pub const SPECULAR_EDIT: SpecularEditTuning {
        /// Specular level of every surface before an edit: a usual dielectric of index of
        /// refraction 1.5.
        dielectric: f32 = 0.5,
            unit "reflectance at normal incidence over 0.08",
            source Paper("Burley, Physically Based Shading at Disney, SIGGRAPH 2012"),
            effect "a larger value subtracts more of the old reflection";
    }
}

/// New roughness and specular level of parts of a photo; by default of none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecularEdit {
    /// Fraction of each photo pixel that is edited, 0..=1; empty without any edit.
    pub share: Plane<f32>,
    /// GGX roughness and specular level after the edit, each 0..=1; unchanged where the fraction is
    /// 0.
    pub gloss: Plane<[f32; 2]>,
    /// GGX roughness before the edit, 0..=1, working size.
    pub was: Roughness,
}

impl Default for SpecularEdit {
    fn default() -> SpecularEdit {
        let none = || Plane::new(0, 0, Vec::new());
        SpecularEdit { share: none(), gloss: Plane::new(0, 0, Vec::new()), was: Roughness(none()) }
    }
}

impl SpecularEdit {
    /// Checks that both planes of the photo's size have one size.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self) -> Result<(), String> {
        crate::image::rule(self.share.size() == self.gloss.size(), "share and gloss of one size")
    }

    /// Memory held, in bytes.
    pub fn bytes(&self) -> usize {
        self.share.bytes() + self.gloss.bytes() + self.was.0.bytes()
    }

    /// Roughness and specular level at photo pixel (x, y) before the edit.
    pub fn before(&self, x: usize, y: usize) -> [f32; 2] {
        let ((w, h), (full_w, full_h)) = (self.was.0.size(), self.share.size());
        [self.was.0.get(x * w / full_w, y * h / full_h), SPECULAR_EDIT.dielectric]
    }

    /// The edit changes photo pixel (x, y).
    pub fn changes(&self, x: usize, y: usize) -> bool {
        self.share.get(x, y) > 0.0 && self.gloss.get(x, y) != self.before(x, y)
    }

    /// Lays new values over those that are there, on the fraction `share` of each photo pixel;
    /// `None` keeps a value. `was` is the roughness before the edit.
    pub fn lay(
        &mut self,
        share: &Plane<f32>,
        [roughness, specular]: [Option<f32>; 2],
        was: &Roughness,
    ) {
        if self.share.is_empty() {
            let (w, h) = share.size();
            *self = SpecularEdit {
                share: Plane::filled(w, h, 0.0),
                gloss: Plane::filled(w, h, [0.0; 2]),
                was: was.clone(),
            };
            self.gloss = Plane::from_fn(w, h, |x, y| self.before(x, y));
        }
        let values =
            self.share.pixels_mut().iter_mut().zip(self.gloss.pixels_mut()).zip(share.pixels());
        for ((covered, gloss), &share) in values.filter(|(_, share)| **share > 0.0) {
            // In a pixel that it shares with the photo's surface, the new one has its own finish,
            // not a mean.
            let part = if *covered > 0.0 { share } else { 1.0 };
            for (value, new) in gloss.iter_mut().zip([roughness, specular]) {
                *value = new.map_or(*value, |new| {
                    if part < 1.0 { *value + part * (new - *value) } else { new }
                });
            }
            *covered = 1.0 - (1.0 - *covered) * (1.0 - share);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shared_pixel_has_its_surface_whole_and_later_ones_lie_over_earlier_ones() {
        let was = Roughness(Plane::new(2, 1, vec![0.6, 0.8]));
        let mut finish = SpecularEdit::default();
        finish.lay(&Plane::new(4, 1, vec![1.0, 0.3, 0.0, 1.0]), [Some(0.2), None], &was);
        assert_eq!(finish.share.pixels(), [1.0, 0.3, 0.0, 1.0]);
        assert_eq!(finish.gloss.pixels(), [[0.2, 0.5], [0.2, 0.5], [0.8, 0.5], [0.2, 0.5]]);
        finish.lay(&Plane::new(4, 1, vec![1.0, 1.0, 1.0, 0.5]), [None, Some(1.0)], &was);
        assert_eq!(finish.gloss.pixels(), [[0.2, 1.0], [0.2, 1.0], [0.8, 1.0], [0.2, 0.75]]);
        assert_eq!(finish.share.pixels(), [1.0; 4]);
    }

    #[test]
    fn what_it_had_is_no_change() {
        let was = Roughness(Plane::new(2, 1, vec![0.6, 0.8]));
        let mut finish = SpecularEdit::default();
        finish.lay(&Plane::filled(4, 1, 1.0), [Some(0.6), Some(0.5)], &was);
        assert_eq!([0, 1, 2, 3].map(|x| finish.changes(x, 0)), [false, false, true, true]);
    }
}
