//! MixLayers: the picture of a finished run with its lights dimmed, colored or brightened.
//!
//! picture = light_rest + sum_i w_i light_i, per channel in linear light, w_i being the factor of
//! light i's radiance: the layers of `picture.exr` hold each light's share of the picture, direct,
//! indirect and its own pixels, and every one of them is linear in its radiance.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;

use super::{SavedRun, encoding_lines, read_run};
use crate::graph::{Context, File, Node, NodeError, nearest};
use crate::image::{
    Compression, ExrLayers, Layer, Picture, PngSamples, Transfer, first_not_finite, weighted_sum,
};
use crate::nodes::artifacts::{Encoding, Files, REST};
use crate::{params, ports};

params! {
    /// Weights the light layers that `Write` wrote, and writes the picture that they make. What
    /// `relight mix` runs.
    pub struct MixLayers {
        /// The `picture.exr` of a run.
        layers: File = File::default(),
        /// Factor of each light, linear (r, g, b), 0 or more; a light without one stays as it is.
        weights: BTreeMap<String, [f32; 3]> = BTreeMap::new(), in 0.0..,
        /// Whether `picture.exr` is made, beside `picture.png`.
        layered: bool = true,
        /// Compression of picture.exr: None, Rle, Zips, Zip or Piz. All are lossless.
        compression: Compression = Compression::Zip,
    }
}

ports! { pub input MixLayersIn {} }
ports! {
    pub output MixLayersOut {
        /// `picture.png`, encoded as the photo is, and `picture.exr`, the picture and its light
        /// layers.
        files: Arc<Files>,
    }
}

impl Node for MixLayers {
    const KIND: &'static str = "MixLayers";
    const VERSION: u32 = 2;
    type In = MixLayersIn;
    type Out = MixLayersOut;

    fn files(&mut self) -> Vec<&mut File> {
        vec![&mut self.layers]
    }

    fn run(&self, _: MixLayersIn, ctx: &Context) -> Result<MixLayersOut, NodeError> {
        let run = read_run(&self.layers, ctx, |_| false)?;
        for id in self.weights.keys() {
            if !run.lights.iter().any(|(light, _)| light == id) {
                return Err(NodeError::BadParameter(unknown(
                    id,
                    run.lights.iter().map(|(light, _)| light.as_str()),
                )));
            }
        }
        let SavedRun { encoding, lights, rest, .. } = run;
        let mut layers: Vec<(&str, &Arc<Layer>, Vec3)> = Vec::new();
        for (id, layer) in &lights {
            let weight = self.weights.get(id).map_or(Vec3::ONE, |weight| Vec3::from_array(*weight));
            if weight != Vec3::ONE && layer.is_black() {
                ctx.warn(format!("{id} is off in this run: its weight has no effect"));
            }
            layers.push((id, layer, weight));
        }
        layers.push((REST, &rest, Vec3::ONE));

        let parts: Vec<_> = layers.iter().map(|(_, layer, weight)| (&***layer, *weight)).collect();
        let picture = Picture(weighted_sum(&parts));
        if let Some(at) = first_not_finite(&picture.0) {
            let (x, y, got) =
                (at % picture.0.width(), at / picture.0.width(), picture.0.pixels()[at]);
            return Err(NodeError::BadParameter(format!(
                "weights: wanted a picture of finite numbers, got {got} at pixel ({x}, {y})"
            )));
        }
        let Encoding { transfer, sixteen_bit, ref exif, .. } = encoding;
        let png = || PngSamples::new(&picture, transfer, sixteen_bit).into_file(exif);
        let exr = || {
            let mut file = ExrLayers::new(picture.0.width(), picture.0.height());
            file.rgb("", &picture.0);
            file.opaque();
            for &(id, layer, weight) in &layers {
                let layer = match weight == Vec3::ONE {
                    true => layer.clone(),
                    false => Arc::new(Layer::new(weighted_sum(&[(layer, weight)]))),
                };
                file.layer(&format!("light_{id}"), layer);
            }
            encoding_lines(&encoding).iter().for_each(|line| file.comment(line));
            file.write(self.compression).map_err(NodeError::Failed)
        };
        let (png, exr) = match self.layered {
            true => rayon::join(png, || exr().map(Some)),
            false => (png(), Ok(None)),
        };
        let exr = exr?.map(|exr| ("picture.exr".into(), exr));
        Ok(MixLayersOut {
            files: Arc::new(Files([("picture.png".into(), png)].into_iter().chain(exr).collect())),
        })
    }
}

/// Six hexadecimal digits, as people name colors, in linear light.
pub fn srgb(digits: &str) -> Option<[f32; 3]> {
    if digits.len() != 6 || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    let stored = u32::from_str_radix(digits, 16).ok()?;
    Some([16, 8, 0].map(|shift| Transfer::Srgb.decode((stored >> shift & 255) as f32 / 255.0)))
}

fn unknown<'a>(id: &str, known: impl Iterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.collect();
    let hint = match nearest(id, known.iter().copied()) {
        Some(name) => format!("did you mean `{name}`?"),
        None => format!("it has {}", known.join(", ")),
    };
    format!("weights: the run has no light `{id}`: {hint}")
}
