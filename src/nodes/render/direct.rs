//! `Direct`: direct shading of each lobe of a light with unit radiance, without shadows.

use std::sync::Arc;

use super::SAMPLES;
use crate::graph::{Context, Node, NodeError};
use crate::image::{Normal, Plane, Points};
use crate::nodes::artifacts::{Sunlight, UnitDirect};
use crate::optics::{self, Shape, Strategy};
use crate::{params, ports};

params! {
    /// Computes the unshadowed direct shading of one light, per lobe of unit radiance.
    ///
    /// E = (1/pi) integral of L cos(theta) over the solid angle of the light above the horizon.
    /// Exact for spheres, rectangles and boxes, and for surfels and convex meshes up to 512 pieces;
    /// windows and larger lamps are sampled.
    pub struct Direct {
        /// Samples per pixel and lobe without a closed form, 1..65536; with a target, the least.
        samples: u32 = 32, in SAMPLES,
        /// Mean standard error over the mean shading of the lobe that is good enough, 0..1; each
        /// tile of 16 x 16 pixels takes more samples until it gets there. 0 takes `samples`
        /// everywhere.
        target_error: f32 = 0.0, in 0.0..1.0,
        /// Upper bound of the samples per pixel and lobe, with a target.
        max_samples: u32 = 4096, in SAMPLES,
        /// Seed of the random numbers.
        seed: u64 = 0,
        /// Strategy of the samples of a window: `Best`, or, to compare, `Area`, `Lobe`, `Balance`,
        /// `BalanceOneSample`, `Power`, `PowerOneSample`.
        sampling: Strategy = Strategy::Best,
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
        /// The light as it was estimated from the photo.
        estimated: Option<Arc<Shape>>,
        /// Sunlight that the photo shows through this window.
        sunlight: Option<Arc<Sunlight>>,
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
    const VERSION: u32 = 5;
    type In = DirectIn;
    type Out = DirectOut;

    fn run(&self, inputs: DirectIn, ctx: &Context) -> Result<DirectOut, NodeError> {
        super::same_size("normal", inputs.normal.0.size(), "points", inputs.points.0.size())?;
        let sampling = super::sampling(
            ctx,
            self.sampling,
            self.samples,
            self.target_error,
            self.max_samples,
            self.seed,
        );
        let stop = || ctx.out_of_time();
        let mut direct =
            optics::direct(&inputs.points, &inputs.normal, &inputs.shape, &sampling, &stop);
        let sunlight = inputs.sunlight.as_ref();
        if let Some(sun) =
            sunlight.and_then(|sun| sun.shown(&inputs.shape, inputs.estimated.as_deref()))
        {
            // The photo shows where the sun shines, also through glass that is out of view.
            direct.lobes[0] = inputs.normal.0.map(|normal| sun.distant_irradiance(normal));
            direct.stderr[0] =
                Plane::filled(direct.lobes[0].width(), direct.lobes[0].height(), 0.0);
        }
        ctx.check_cancelled()?;
        ctx.set_stderr(direct.relative_error());
        let pixels = direct.lobes.iter().map(|lobe| lobe.len()).sum::<usize>();
        ctx.set_samples(direct.samples as f64 / pixels.max(1) as f64);
        Ok(DirectOut {
            direct: Arc::new(UnitDirect { lobes: direct.lobes, stderr: direct.stderr }),
        })
    }
}
