//! `Direct`: what each lobe of a light with unit radiance does to the room, shadows apart.

use std::sync::Arc;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Points};
use crate::nodes::artifacts::UnitDirect;
use crate::optics::{self, Shape};
use crate::{params, ports};

params! {
    /// Unshadowed direct shading of one light, per lobe of unit radiance.
    ///
    /// E = (1/pi) integral of L cos(theta) over the directions in which the light is seen, cut at the horizon. Exact for
    /// spheres, rectangles and boxes, and for plates and convex meshes up to 512 pieces; windows and larger lamps are sampled.
    pub struct Direct {
        /// Samples per pixel where there is no closed form, 1..4096.
        samples: u32 = 32,
        /// Another seed gives other noise.
        seed: u64 = 0,
    }
}

ports! {
    pub input DirectIn {
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// The light.
        shape: Arc<Shape>,
    }
}

ports! {
    pub output DirectOut {
        /// Shading and standard error per lobe.
        direct: Arc<UnitDirect>,
    }
}

impl Node for Direct {
    const KIND: &'static str = "Direct";
    const VERSION: u32 = 2;
    type In = DirectIn;
    type Out = DirectOut;

    fn check(&self) -> Result<(), String> {
        if (1..=4096).contains(&self.samples) {
            Ok(())
        } else {
            Err(format!("samples: wanted 1..4096, got {}", self.samples))
        }
    }

    fn run(&self, inputs: DirectIn, ctx: &Context) -> Result<DirectOut, NodeError> {
        super::same_size("points", inputs.points.0.size(), "normal", inputs.normal.0.size())?;
        let direct = optics::direct(&inputs.points, &inputs.normal, &inputs.shape, self.samples as usize, self.seed);
        ctx.set_stderr(direct.relative_error());
        Ok(DirectOut { direct: Arc::new(UnitDirect { lobes: direct.lobes, stderr: direct.stderr }) })
    }
}
