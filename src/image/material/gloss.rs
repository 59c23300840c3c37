//! Parameters of specular reflection.

use std::ops::{AddAssign, Div};

use bytemuck::{Pod, Zeroable};

/// Parameters of the specular reflection at a position of a surface, each 0..=1; by default, those
/// of a mirror without a reflectance.
///
/// Burley, Physically Based Shading at Disney, SIGGRAPH 2012.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Gloss {
    /// GGX roughness: 0 is a mirror, 1 is diffuse.
    pub roughness: f32,
    /// Specular level: reflectance of a dielectric at normal incidence, in units of 0.08.
    pub specular: f32,
    /// 0 is a dielectric, 1 a metal.
    pub metallic: f32,
}

impl AddAssign for Gloss {
    fn add_assign(&mut self, other: Gloss) {
        self.roughness += other.roughness;
        self.specular += other.specular;
        self.metallic += other.metallic;
    }
}

impl Div<f32> for Gloss {
    type Output = Gloss;

    fn div(self, by: f32) -> Gloss {
        Gloss {
            roughness: self.roughness / by,
            specular: self.specular / by,
            metallic: self.metallic / by,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_is_that_of_each_parameter() {
        let mut mean = Gloss::default();
        mean += Gloss { roughness: 1.0, specular: 0.5, metallic: 0.0 } / 2.0;
        mean += Gloss { roughness: 0.0, specular: 0.5, metallic: 1.0 } / 2.0;
        assert_eq!(mean, Gloss { roughness: 0.5, specular: 0.5, metallic: 0.5 });
    }
}
