//! `TraceIndirect`: indirect shading by bounces on the seen surface.

use std::sync::Arc;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Albedo, Normal, Plane, Points, Shading, luminance};
use crate::nodes::artifacts::{ObjectLight, UnitDirect, UnitIndirect, Visibility};
use crate::optics::{self, Bounces, Probed};
use crate::{params, ports};

params! {
    /// Indirect shading of one light, per lobe of unit radiance: bounces over the rays of
    /// `Transport`, a constant ambient for the unseen part of the room. Exactly linear in the
    /// light, never negative, traces no ray.
    pub struct TraceIndirect {
        /// Bounces followed one by one, 0..=64; the remaining ones are a geometric series in the
        /// mean albedo. With 0, indirect light is zero.
        bounces: u32 = 4, in 0..=64,
        /// Radiosity of the unseen part of the room, as a multiple of the mean of the seen part,
        /// 0..1. The value 1 would make a closed room of the unseen part; a half allows for doors,
        /// panes and for a photo that shows the brighter half.
        unseen: f32 = 0.5, in 0.0..=1.0,
    }
}

ports! {
    pub input TraceIndirectIn {
        /// The hits of the gathering rays of each receiver.
        transport: Arc<optics::LightTransport>,
        /// The surface points.
        points: Arc<Points>,
        /// Their normals.
        normal: Arc<Normal>,
        /// Diffuse albedo.
        albedo: Arc<Albedo>,
        /// Unshadowed direct shading per lobe.
        direct: Arc<UnitDirect>,
        /// The lit fraction of it.
        visibility: Arc<Visibility>,
        /// The light's direct light on inserted objects, which then take part.
        objects: Option<Arc<ObjectLight>>,
    }
}

ports! {
    pub output TraceIndirectOut {
        /// Indirect shading and its standard error per lobe.
        indirect: Arc<UnitIndirect>,
    }
}

impl Node for TraceIndirect {
    const KIND: &'static str = "TraceIndirect";
    const VERSION: u32 = 4;
    type In = TraceIndirectIn;
    type Out = TraceIndirectOut;

    fn run(&self, inputs: TraceIndirectIn, ctx: &Context) -> Result<TraceIndirectOut, NodeError> {
        let TraceIndirectIn { transport, points, normal, albedo, direct, visibility, objects } =
            inputs;
        let size = transport.size();
        super::same_size("points", points.0.size(), "transport", size)?;
        super::same_size("normal", normal.0.size(), "transport", size)?;
        super::same_size("albedo", albedo.0.size(), "transport", size)?;
        if direct.lobes.len() != visibility.lit.len() {
            let (wanted, got) = (direct.lobes.len(), visibility.lit.len());
            return Err(NodeError::Failed(format!(
                "`visibility` has {got} lobes, wanted {wanted} as `direct`"
            )));
        }
        let bounces = Bounces { count: self.bounces as usize, unseen: self.unseen };
        let probed = |lobe: usize| match &objects {
            Some(light) => {
                Probed { albedo: light.albedo.pixels(), direct: light.probes[lobe].pixels() }
            }
            None => Probed::NONE,
        };
        let known = objects.as_ref().map_or(0, |light| light.albedo.len());
        if known != transport.probes()
            || objects.as_ref().is_some_and(|o| o.probes.len() != direct.lobes.len())
        {
            let wanted = transport.probes();
            return Err(NodeError::Failed(format!(
                "`objects` has {known} probes of bodies, wanted {wanted} as in `transport`, for each lobe of `direct`"
            )));
        }
        let lobe = |(lobe, (direct, lit)): (usize, (&Plane<f32>, &Plane<f32>))| {
            ctx.check_cancelled()?;
            super::same_size("direct", direct.size(), "transport", size)?;
            super::same_size("visibility", lit.size(), "transport", size)?;
            let arrives = direct.pixels().iter().zip(lit.pixels()).map(|(e, v)| e * v).collect();
            let arrives = Plane::new(size.0, size.1, arrives);
            Ok(optics::indirect(
                &transport,
                &points,
                &normal,
                &albedo,
                &arrives,
                probed(lobe),
                bounces,
            ))
        };
        let shaded: Result<Vec<_>, NodeError> =
            direct.lobes.iter().zip(&visibility.lit).enumerate().map(lobe).collect();
        let (mut lobes, mut stderr, mut probes) =
            (Vec::<Shading>::new(), Vec::<Plane<f32>>::new(), Vec::new());
        for (shading, error, of_probes) in shaded? {
            lobes.push(shading);
            stderr.push(error);
            if objects.is_some() {
                probes.push(Plane::new(of_probes.len(), 1, of_probes));
            }
        }
        let value = lobes
            .iter()
            .flat_map(|l| l.0.pixels())
            .fold(0.0, |sum, &v| sum + f64::from(luminance(v)));
        let error = stderr.iter().flat_map(|s| s.pixels()).fold(0.0, |sum, &v| sum + f64::from(v));
        ctx.set_stderr(error / value.max(f64::MIN_POSITIVE));
        Ok(TraceIndirectOut { indirect: Arc::new(UnitIndirect { lobes, stderr, probes }) })
    }
}
