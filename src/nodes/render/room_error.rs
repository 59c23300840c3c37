//! `RoomError`: the standard error of a light's layer by guesses about the unseen room.

use std::sync::Arc;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Points, Shading, luminance};
use crate::nodes::artifacts::LayerError;
use crate::optics::{DrawDifferences, Radiance};
use crate::{params, ports};

params! {
    /// Standard error of one light's shading by guesses about the unseen room: the lobes of each
    /// draw are summed with their radiances, and the standard deviation over the draws is
    /// interpolated along surfaces. Linear in a common factor of the radiances; traces no ray.
    pub struct RoomError {}
}

ports! {
    pub input RoomErrorIn {
        /// Differences of the draws from their mean, per lobe of unit radiance.
        differences: Arc<DrawDifferences>,
        /// Radiance of the light, one color per lobe.
        radiance: Arc<Radiance>,
        /// Shading by the light, of which the error is reported as a fraction.
        light: Arc<Shading>,
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
    }
}

ports! {
    pub output RoomErrorOut {
        /// Standard error of the luminance of the shading, irradiance / pi.
        error: Arc<LayerError>,
    }
}

impl Node for RoomError {
    const KIND: &'static str = "RoomError";
    const VERSION: u32 = 1;
    type In = RoomErrorIn;
    type Out = RoomErrorOut;

    fn run(&self, inputs: RoomErrorIn, ctx: &Context) -> Result<RoomErrorOut, NodeError> {
        let RoomErrorIn { differences, radiance, light, points, normal } = inputs;
        let size = points.0.size();
        super::same_size("normal", normal.0.size(), "points", size)?;
        super::same_size("light", light.0.size(), "points", size)?;
        differences.grid.check(size).map_err(|rule| {
            NodeError::Failed(format!("differences: wanted {rule}, as `points`, got another size"))
        })?;
        let (wanted, got) = (differences.lobes.len(), radiance.0.len());
        if wanted != got {
            return Err(NodeError::Failed(format!(
                "`radiance` has {got} lobes, wanted {wanted} as `differences`"
            )));
        }
        let stderr = differences.standard_error(&points, &normal, &radiance);
        let sum = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>();
        let error = sum(&mut stderr.pixels().iter().copied());
        let value = sum(&mut light.0.pixels().iter().map(|&v| luminance(v)));
        ctx.set_stderr(error / value.max(f64::MIN_POSITIVE));
        Ok(RoomErrorOut { error: Arc::new(LayerError { stderr }) })
    }
}
