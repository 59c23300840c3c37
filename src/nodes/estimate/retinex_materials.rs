//! `RetinexMaterials`: materials without a network, the baseline of learned stages.

use std::sync::Arc;

use crate::graph::{Context, Node, NodeError, above};
use crate::image::{Albedo, Normal, Picture, Roughness, Segments, Steps, retinex, segment};
use crate::{params, ports};

params! {
    /// Segments a photo into regions of one albedo each by color Retinex, without a network: the
    /// baseline for learned estimates.
    ///
    /// Neighboring blocks of pixels without a sharp step of intensity or chromaticity between them
    /// form a segment. The albedos of segments follow from the steps along their boundaries (Grosse
    /// et al., ICCV 2009, on regions). The photo's mean hue is light for the most part, and the
    /// mean albedo slightly warm. Roughness is a constant, as one photo does not determine it this
    /// way.
    pub struct RetinexMaterials {
        /// Side of the compared blocks, working pixels.
        stride: usize = 4, in 1..=16,
        /// Step of log chromaticity that separates two materials.
        chroma_step: f32 = 0.06, in above(0.0),
        /// Step of log intensity that separates two materials.
        intensity_step: f32 = 0.12, in above(0.0),
        /// Luminance of the albedo at the 90th percentile of the room, as most rooms have white
        /// walls or ceilings.
        bright: f32 = 0.75, in above(0.0),
        /// Roughness of every pixel.
        roughness: f32 = 0.8, in 0.0..=1.0,
    }
}

ports! {
    pub input RetinexMaterialsIn {
        /// The linear photo at working size.
        photo: Arc<Picture>,
        /// Normals, which separate creases, where shading may jump, from paint.
        normal: Arc<Normal>,
    }
}

ports! {
    pub output RetinexMaterialsOut {
        /// One albedo per segment, in 0.02..=0.95.
        albedo: Arc<Albedo>,
        /// Constant roughness.
        roughness: Arc<Roughness>,
        /// Label of each pixel: pixels of one label share an albedo.
        segments: Arc<Segments>,
    }
}

impl Node for RetinexMaterials {
    const KIND: &'static str = "RetinexMaterials";
    const VERSION: u32 = 3;
    type In = RetinexMaterialsIn;
    type Out = RetinexMaterialsOut;

    fn run(
        &self,
        inputs: RetinexMaterialsIn,
        _: &Context,
    ) -> Result<RetinexMaterialsOut, NodeError> {
        let steps = Steps { chroma: self.chroma_step, intensity: self.intensity_step };
        let segments = segment(&inputs.photo, self.stride, steps);
        let albedo = retinex(&inputs.photo, &inputs.normal, &segments, self.stride, self.bright);
        let roughness = Roughness(inputs.photo.0.map(|_| self.roughness));
        Ok(RetinexMaterialsOut {
            albedo: Arc::new(albedo),
            roughness: Arc::new(roughness),
            segments: Arc::new(segments),
        })
    }
}
