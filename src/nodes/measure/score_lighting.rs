//! `ScoreLighting`: per-pixel lighting against the truth.

use std::sync::Arc;

use crate::graph::{Context, File, Node, NodeError};
use crate::image::{NamedBytes, read_maps};
use crate::nodes::artifacts::Scores;
use crate::optics::{LightMaps, Lighting, PHIS, THETAS};
use crate::{params, ports};

params! {
    /// Measures `lighting`: the mean squared difference of log(1 + radiance) over hemispheres, as
    /// IndoorLightEditing (Li et al., ECCV 2022) defines it.
    pub struct ScoreLighting {
        /// The truth: NPY, 32-bit floats [rows, columns, 8, 16, 3], with NaN where it is unknown.
        truth: File = File::default(),
    }
}

ports! {
    pub input ScoreLightingIn {
        /// The estimated lighting.
        lighting: Arc<Lighting>,
    }
}

ports! {
    pub output ScoreLightingOut {
        /// The score `lighting` of `all lights`.
        scores: Arc<Scores>,
    }
}

impl Node for ScoreLighting {
    const KIND: &'static str = "ScoreLighting";
    const VERSION: u32 = 1;
    type In = ScoreLightingIn;
    type Out = ScoreLightingOut;

    fn check_consistency(&self) -> Result<(), String> {
        if self.truth.path.is_empty() {
            return Err("truth: wanted a file, got none; a scene names it as `truth: (lighting: \"maps.npy\")`".into());
        }
        Ok(())
    }

    fn files(&mut self) -> Vec<&mut File> {
        if self.truth.path.is_empty() { Vec::new() } else { vec![&mut self.truth] }
    }

    fn run(&self, inputs: ScoreLightingIn, ctx: &Context) -> Result<ScoreLightingOut, NodeError> {
        let bytes = ctx.read(&self.truth)?;
        let path = self.truth.location().display().to_string();
        let bad = |message: String| NodeError::BadFile { path: path.clone(), message };
        let (rows, columns, radiance) = read_maps(NamedBytes::new(&path, &bytes), [THETAS, PHIS])
            .map_err(|e| bad(e.message()))?;
        let got = &inputs.lighting;
        if (got.rows, got.columns) != (rows, columns) {
            let wanted = format!("{} rows of {} cells as estimated", got.rows, got.columns);
            return Err(bad(format!("grid: wanted {wanted}, got {rows} of {columns}")));
        }
        let error = got.maps().log_error(&LightMaps { columns, rows, radiance });
        Ok(ScoreLightingOut {
            scores: super::scores([super::score("all lights", "lighting", error)]),
        })
    }
}
