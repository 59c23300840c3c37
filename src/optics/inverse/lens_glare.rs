//! Glare: light of the lamps and windows in view that the lens scatters over the picture.
//!
//! A lens spreads a fraction s of the light of each point over the picture, with a density that
//! falls with a power of the distance (Talvala, Adams, Horowitz and Levoy, Veiling Glare in High
//! Dynamic Range Imaging, SIGGRAPH 2007; McCann and Rizzi, The Art and Science of HDR Imaging,
//! 2011, chapter 8). Glare does not depend on the surface that it covers: it is seen on black
//! things, too, and crosses edges. So it is told from the light of a lamp on a wall.
//!
//! The photo is `I_p = B_s E_p + sum_k a_k H_k G_kp`, with the shading E of all lights, one
//! reflectance B_s per segment and channel, the color H_k of light k and the glare G_k of the
//! kernel for a light of brightness 1. The fit eliminates B and finds the a_k >= 0 by least squares
//! with Cauchy weights.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::observations::white_of;
use crate::image::{Mask, Picture, Plane, Segments, Shading, resize};
use crate::optics::nnls::nnls;
use crate::tuning::tuning;

tuning! {
    /// Constants of glare.
    pub const LENS_GLARE: LensGlareTuning {
        /// Radius of the core of the kernel, within which its density is even.
        core: f32 = 0.004,
            unit "fraction of the picture's longer side", source Measured("a fit of cameras to photos; no page records it"),
            effect "a larger value scatters less far";
        /// Slopes that are tried: scattered light falls with the distance r as r^-(2 + slope).
        slopes: [f32; 3] = [0.4, 0.7, 1.0],
            unit "1", source Measured("a fit of cameras to photos; no page records it"), effect "a smaller value scatters farther";
        /// Longest side of the grid on which glare is computed.
        grid: usize = 160,
            unit "pixels", source Measured("run time"), effect "a larger value is slower, and finer beside a light";
        /// Standard deviation of the model error as a fraction of a pixel's value.
        relative_error: f64 = 0.15,
            unit "1", source Measured("rooms of docs/accuracy.md"), effect "a larger value trusts bright pixels less";
        /// Floor of that standard deviation.
        error_floor: f64 = 0.01,
            unit "fraction of white", source Derived("quantization of 8-bit photos"),
            effect "a larger value trusts dark pixels less";
        /// Solutions with weights from the last one.
        rounds: usize = 4,
            unit "iterations", source Taste, effect "a larger value is slower";
        /// Fraction of the pixels in reach of a light that may be darker than its glare.
        darker: f32 = 0.01,
            unit "1", source Taste, effect "a larger value gives more glare where the photo has dark specks";
        /// Glare over that at the brightest pixel, from which on a pixel is in reach of a light.
        in_reach: f32 = 0.1,
            unit "1", source Taste, effect "a smaller value lets dark corners far away limit the glare";
        /// Largest brightness of a light that scatters all of its light.
        max_amplitude: f32 = 1.0,
            unit "white", source Derived("a light 20 times white of which 5 % are scattered"),
            effect "a larger value takes more of a lit wall for glare";
    }
}

/// The density of the light that a lens scatters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GlareKernel {
    /// The light falls with the distance r as r^-(2 + slope), above 0.
    pub slope: f32,
}

impl GlareKernel {
    /// The glare of `source`, the brightness of each pixel, if all of its light were scattered: of
    /// the same size and unit. The total over an endless picture is that of `source`.
    pub fn spread(self, source: &Plane<f32>) -> Plane<f32> {
        let (w, h) = source.size();
        let coarse = |n: usize| n.div_ceil(w.max(h).div_ceil(LENS_GLARE.grid).max(1)).max(1);
        let (gw, gh) = (coarse(w), coarse(h));
        // Sources are squares of two by two pixels of the grid, whose centers lie between those of
        // the pixels: squared distances are whole in units of half a pixel.
        let cells = resize(source, gw.div_ceil(2), gh.div_ceil(2));
        let lit: Vec<(i32, i32, f32)> = (0..cells.len())
            .filter(|&i| cells.pixels()[i] > 0.0)
            .map(|i| {
                let (x, y) = ((i % cells.width()) as i32, (i / cells.width()) as i32);
                (4 * x + 1, 4 * y + 1, cells.pixels()[i])
            })
            .collect();
        let core = LENS_GLARE.core * gw.max(gh) as f32;
        let density = |squared: i32| self.density(0.25 * squared as f32, core);
        let reach = 4 * (gw * gw + gh * gh) as i32 + 16;
        // Density times the area of a cell, by squared distance.
        let table: Vec<f32> = (0..reach).map(|squared| 4.0 * density(squared)).collect();
        let glare = |i: usize| -> f32 {
            let (x, y) = (2 * (i % gw) as i32, 2 * (i / gw) as i32);
            let density = |(cx, cy): (i32, i32)| {
                let squared = (x - cx).pow(2) + (y - cy).pow(2);
                table.get(squared as usize).copied().unwrap_or(0.0)
            };
            lit.iter().map(|&(cx, cy, value)| value * density((cx, cy))).sum()
        };
        let glare: Vec<f32> = (0..gw * gh).into_par_iter().map(glare).collect();
        resize(&Plane::new(gw, gh, glare), w, h)
    }

    /// Density at the squared distance `squared`, in pixels, for a core of this radius: its
    /// integral over the plane is 1.
    fn density(self, squared: f32, core: f32) -> f32 {
        let slope = self.slope;
        let normal = slope * core.powf(slope) / std::f32::consts::TAU;
        normal * (core * core + squared).powf(-1.0 - 0.5 * slope)
    }
}

/// A light in view, as a source of glare. All planes have the size of the photo that is fitted.
pub struct GlareSource {
    /// Brightness of each pixel of the light over that of the light, 0 elsewhere.
    pub brightness: Plane<f32>,
    /// Color of the light, of luminance 1.
    pub hue: Vec3,
}

/// Result of [`fit_glare`].
pub struct GlareFit {
    /// The kernel that fits best.
    pub kernel: GlareKernel,
    /// Glare of each source, in units of the photo.
    pub glare: Vec<Plane<Vec3>>,
    /// Brightness of each source that is scattered, in units of the photo: the fraction that the
    /// lens scatters times the light's brightness.
    pub amplitude: Vec<f32>,
}

/// Fits the glare of lights in view to `photo`, linear, under the `shading` of all lights.
/// `is_used` marks the pixels that show a surface; of these, saturated ones take no part. All
/// planes have one size.
///
/// # Panics
/// The planes differ in size.
pub fn fit_glare(
    (photo, clipped): (&Picture, &Mask),
    Shading(shading): &Shading,
    segments: &Segments,
    is_used: &Plane<bool>,
    sources: &[GlareSource],
) -> GlareFit {
    let white = white_of(photo, clipped);
    let Picture(photo) = photo;
    assert_eq!(photo.size(), shading.size(), "shading of the photo's size");
    assert_eq!(photo.size(), segments.label.size(), "segments of the photo's size");
    let used: Vec<usize> =
        (0..photo.len()).filter(|&i| is_used.pixels()[i] && clipped.0.pixels()[i] <= 0.0).collect();
    let tried = LENS_GLARE.slopes.map(|slope| {
        let kernel = GlareKernel { slope };
        let spread: Vec<Plane<f32>> =
            sources.iter().map(|source| kernel.spread(&source.brightness)).collect();
        let columns: Vec<(&Plane<f32>, Vec3)> =
            spread.iter().zip(sources).map(|(plane, source)| (plane, source.hue)).collect();
        let problem = GlareProblem { photo, shading, segments, used: &used, columns, white };
        let (amplitude, loss) = problem.solve();
        (loss, kernel, spread, amplitude)
    });
    let best = tried.into_iter().reduce(|a, b| if b.0 < a.0 { b } else { a });
    let (_, kernel, spread, amplitude) = best.expect("there are slopes");
    let glare = spread.iter().zip(sources).zip(&amplitude);
    let glare = glare.map(|((plane, source), &a)| plane.map(|v| a * v * source.hue)).collect();
    GlareFit { kernel, glare, amplitude }
}

/// The least-squares problem for one kernel.
struct GlareProblem<'a> {
    photo: &'a Plane<Vec3>,
    shading: &'a Plane<Vec3>,
    segments: &'a Segments,
    /// Pixels that take part.
    used: &'a [usize],
    /// Glare of each light at brightness 1, and the color of the light.
    columns: Vec<(&'a Plane<f32>, Vec3)>,
    white: f32,
}

impl GlareProblem<'_> {
    /// The amplitudes, and the mean loss log(1 + r^2).
    fn solve(&self) -> (Vec<f32>, f64) {
        let limits: Vec<f64> = (0..self.columns.len()).map(|k| f64::from(self.limit(k))).collect();
        let mut amplitude = vec![0.0; self.columns.len()];
        for _ in 0..LENS_GLARE.rounds {
            amplitude = self.step(&amplitude);
            amplitude.iter_mut().zip(&limits).for_each(|(a, limit)| *a = a.min(*limit));
        }
        let loss: f64 = (0..3)
            .map(|c| {
                let reflectance = self.reflectance(&amplitude, c);
                let residual = |&i: &usize| {
                    let at = self.at(i, c);
                    self.residual(at, &reflectance, &amplitude, c) / self.sigma(at.photo)
                };
                self.used.iter().map(residual).map(|r| (r * r).ln_1p()).sum::<f64>()
            })
            .sum();
        (amplitude.iter().map(|&a| a as f32).collect(), loss / (3 * self.used.len().max(1)) as f64)
    }

    /// The largest amplitude of light `k` whose glare the photo does not contradict.
    fn limit(&self, k: usize) -> f32 {
        let (plane, hue) = self.columns[k];
        let most = self.used.iter().map(|&i| plane.pixels()[i]).fold(0.0, f32::max);
        let mut limits: Vec<f32> = self
            .used
            .iter()
            .filter(|&&i| plane.pixels()[i] > LENS_GLARE.in_reach * most)
            .map(|&i| {
                let glare = (plane.pixels()[i] * hue).max(Vec3::splat(f32::MIN_POSITIVE));
                (self.photo.pixels()[i].max(Vec3::ZERO) / glare).min_element()
            })
            .collect();
        if limits.is_empty() {
            return 0.0;
        }
        let at = (LENS_GLARE.darker * limits.len() as f32) as usize;
        let darkest = *limits.select_nth_unstable_by(at, f32::total_cmp).1;
        darkest.clamp(0.0, LENS_GLARE.max_amplitude * self.white)
    }

    fn at(&self, i: usize, c: usize) -> GlarePixelData {
        GlarePixelData {
            index: i,
            segment: self.segments.label.pixels()[i] as usize,
            photo: f64::from(self.photo.pixels()[i][c]),
            shading: f64::from(self.shading.pixels()[i][c]),
        }
    }

    /// Glare of light `k` of amplitude 1 at pixel `i` in channel `c`.
    fn glare(&self, k: usize, i: usize, c: usize) -> f64 {
        let (plane, hue) = self.columns[k];
        f64::from(plane.pixels()[i] * hue[c])
    }

    fn all_glare(&self, amplitude: &[f64], i: usize, c: usize) -> f64 {
        amplitude.iter().enumerate().map(|(k, a)| a * self.glare(k, i, c)).sum()
    }

    fn sigma(&self, value: f64) -> f64 {
        LENS_GLARE.relative_error * value + LENS_GLARE.error_floor * f64::from(self.white)
    }

    /// Least-squares reflectance of each segment without the glare.
    fn reflectance(&self, amplitude: &[f64], c: usize) -> Vec<f64> {
        let count = self.segments.count as usize;
        let (mut top, mut bottom) = (vec![0.0; count], vec![0.0; count]);
        for &i in self.used {
            let at = self.at(i, c);
            let weight = self.sigma(at.photo).powi(-2);
            top[at.segment] += weight * at.shading * (at.photo - self.all_glare(amplitude, i, c));
            bottom[at.segment] += weight * at.shading * at.shading;
        }
        top.iter()
            .zip(&bottom)
            .map(|(t, b)| if *b > 0.0 { (t / b).max(0.0) } else { 0.0 })
            .collect()
    }

    fn residual(
        &self,
        at: GlarePixelData,
        reflectance: &[f64],
        amplitude: &[f64],
        c: usize,
    ) -> f64 {
        at.photo - reflectance[at.segment] * at.shading - self.all_glare(amplitude, at.index, c)
    }

    /// The amplitudes that are best with the weights at `last`.
    fn step(&self, last: &[f64]) -> Vec<f64> {
        let (n, count) = (self.columns.len(), self.segments.count as usize);
        let (mut gram, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for c in 0..3 {
            let reflectance = self.reflectance(last, c);
            let weight = |at: GlarePixelData| {
                let sigma = self.sigma(at.photo);
                let r = self.residual(at, &reflectance, last, c) / sigma;
                1.0 / (sigma * sigma * (1.0 + r * r))
            };
            // Each segment's reflectance absorbs what is along its shading.
            let (mut norm, mut along) = (vec![0.0; count], vec![0.0; count * (n + 1)]);
            for &i in self.used {
                let at = self.at(i, c);
                let w = weight(at) * at.shading;
                norm[at.segment] += w * at.shading;
                let along = &mut along[at.segment * (n + 1)..][..n + 1];
                along[n] += w * at.photo;
                (0..n).for_each(|k| along[k] += w * self.glare(k, i, c));
            }
            for &i in self.used {
                let at = self.at(i, c);
                if norm[at.segment] <= 0.0 {
                    continue;
                }
                let w = weight(at);
                let along = &along[at.segment * (n + 1)..][..n + 1];
                let rest = |value: f64, k: usize| value - along[k] / norm[at.segment] * at.shading;
                let photo = rest(at.photo, n);
                let columns: Vec<f64> = (0..n).map(|k| rest(self.glare(k, i, c), k)).collect();
                for k in 0..n {
                    right[k] += w * columns[k] * photo;
                    (0..n).for_each(|j| gram[k * n + j] += w * columns[k] * columns[j]);
                }
            }
        }
        nnls(&gram, &right)
    }
}

/// One channel of a pixel.
#[derive(Clone, Copy)]
struct GlarePixelData {
    index: usize,
    segment: usize,
    photo: f64,
    shading: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_keeps_the_light_and_falls_as_its_power() {
        let source =
            Plane::from_fn(160, 160, |x, y| if x / 2 == 40 && y / 2 == 40 { 1.0 } else { 0.0 });
        for slope in LENS_GLARE.slopes {
            let kernel = GlareKernel { slope };
            let glare = kernel.spread(&source);
            // The closed form outside of a radius R is (1 + R^2 / core^2)^(-slope / 2) of all.
            let (core, center) = (LENS_GLARE.core * 160.0, 81.0);
            let ring = |least: f32, most: f32| -> f32 {
                let away = |i: usize| {
                    let (x, y) = ((i % 160) as f32 + 0.5 - center, (i / 160) as f32 + 0.5 - center);
                    x.hypot(y)
                };
                (0..160 * 160)
                    .filter(|&i| (least..most).contains(&away(i)))
                    .map(|i| glare.pixels()[i])
                    .sum()
            };
            let outside = |r: f32| (1.0 + (r / core).powi(2)).powf(-0.5 * slope);
            let want = 4.0 * (outside(10.0) - outside(60.0));
            let got = ring(10.0, 60.0);
            assert!((got / want - 1.0).abs() < 0.02, "slope {slope}: {got} for {want}");
            let [near, far] = [20, 40].map(|x| glare.get(81 + x, 81));
            let want = 2.0f32.powf(2.0 + slope);
            assert!((near / far / want - 1.0).abs() < 0.05, "slope {slope}: {}", near / far);
        }
    }

    /// A room of two walls of paint in squares, a lamp at its left, and the glare `amplitude` of
    /// the kernel of this slope.
    fn shown(slope: f32, amplitude: f32) -> (Plane<Vec3>, Plane<Vec3>, Segments, GlareSource) {
        let (w, h) = (96, 72);
        let lamp = |x: usize, y: usize| (20..32).contains(&x) && (24..40).contains(&y);
        let brightness = Plane::from_fn(w, h, |x, y| if lamp(x, y) { 1.0 } else { 0.0 });
        let hue = Vec3::new(1.3, 0.95, 0.5);
        let shading = Plane::from_fn(w, h, |x, y| {
            let away = (x as f32 - 26.0).powi(2) + (y as f32 - 32.0).powi(2);
            Vec3::new(0.3, 0.3, 0.35) + 400.0 / (800.0 + away) * hue
        });
        let paint = [0.6, 0.05, 0.35, 0.15].map(Vec3::splat);
        let label = Plane::from_fn(w, h, |x, y| ((x / 12 + 2 * (y / 12)) % 4) as u32);
        let glare = GlareKernel { slope }.spread(&brightness);
        let photo = Plane::from_fn(w, h, |x, y| {
            paint[label.get(x, y) as usize] * shading.get(x, y) + amplitude * glare.get(x, y) * hue
        });
        (photo, shading, Segments { label, count: 4 }, GlareSource { brightness, hue })
    }

    fn fitted(
        photo: Plane<Vec3>,
        shading: Plane<Vec3>,
        segments: &Segments,
        is_used: &Plane<bool>,
        sources: &[GlareSource],
    ) -> GlareFit {
        let clear = Mask(photo.map(|_| 0.0));
        fit_glare((&Picture(photo), &clear), &Shading(shading), segments, is_used, sources)
    }

    #[test]
    fn known_glare_is_found_and_none_without() {
        for (slope, amplitude) in [(0.4, 0.5), (1.0, 0.3), (0.7, 0.0)] {
            let (photo, shading, segments, source) = shown(slope, amplitude);
            let used = source.brightness.map(|b| b == 0.0);
            let fit = fitted(photo, shading, &segments, &used, &[source]);
            let got = fit.amplitude[0];
            assert!((got - amplitude).abs() < 0.02 * amplitude + 1e-4, "{got} for {amplitude}");
            if amplitude > 0.0 {
                assert_eq!(fit.kernel.slope, slope);
            }
        }
    }

    #[test]
    fn black_things_limit_the_glare() {
        // The model of the light is too weak by the falloff: what is missing looks like glare, but
        // a black square shows that it is none.
        let (photo, shading, segments, source) = shown(0.7, 0.0);
        let flat = shading.map(|_| Vec3::splat(0.3));
        let photo = Plane::from_fn(96, 72, |x, y| match segments.label.get(x, y) {
            1 => Vec3::splat(1e-4),
            _ => photo.get(x, y),
        });
        let used = source.brightness.map(|b| b == 0.0);
        let fit = fitted(photo, flat, &segments, &used, &[source]);
        assert!(fit.amplitude[0] < 0.01, "{:?}", fit.amplitude);
    }

    #[test]
    fn nothing_to_see_is_no_glare() {
        let (photo, shading, segments, source) = shown(0.7, 0.3);
        let none = photo.map(|_| false);
        let fit = fitted(photo.clone(), shading.clone(), &segments, &none, &[source]);
        assert_eq!(fit.amplitude, [0.0]);
        let fit = fitted(photo, shading, &segments, &none, &[]);
        assert!(fit.amplitude.is_empty() && fit.glare.is_empty());
    }
}
