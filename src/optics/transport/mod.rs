//! Light transport: direct light, shadows and bounces.

pub(in crate::optics) mod contact;
pub(in crate::optics) mod direct;
pub(in crate::optics) mod estimate;
pub(in crate::optics) mod indirect;
pub(in crate::optics) mod light_maps;
pub(in crate::optics) mod lighting;
pub(in crate::optics) mod objects;
pub(in crate::optics) mod room_draws;
pub(in crate::optics) mod shadow;

pub use direct::{DirectEstimate, direct};
pub use estimate::{BATCHES, INTERVAL, Sampling, estimate, stream};
pub use indirect::{
    Bounces, LightTransport, Probed, RayFractions, indirect, indirect_at_receivers, trace_bounces,
};
pub use light_maps::{LightMaps, PHIS, TEXELS, THETAS};
pub use lighting::{Lighting, LocalLobe, local_frame};
pub use objects::{arriving, arriving_at_cells};
pub use room_draws::{DrawDifferences, DrawSettings, DrawnLight, DrawnRoom, GuessDraw, RoomDraws};
pub use shadow::{ShadowEstimate, ShadowQuality, shadow};

use crate::tuning::Table;

/// The constants of transported light.
pub fn tuning() -> Vec<Table> {
    vec![
        contact::ContactTuning::table(),
        estimate::NoiseTuning::table(),
        indirect::IndirectTuning::table(),
        room_draws::RoomDrawsTuning::table(),
    ]
}
