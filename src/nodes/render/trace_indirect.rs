//! `TraceIndirect`: indirect shading by bounces on the seen surface.

use std::sync::Arc;

use glam::Vec3;

use crate::graph::{Context, Node, NodeError};
use crate::image::{Albedo, Normal, Plane, Points, Shading, luminance};
use crate::nodes::artifacts::{CellLight, ObjectLight, UnitDirect, UnitIndirect, Visibility};
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
        /// The light's direct light on the cells of the room's hidden sides; needed where
        /// `transport` has cells.
        room: Option<Arc<CellLight>>,
        /// The albedo before an edit, which sides that are not seen at all keep; without it they
        /// take `albedo`.
        unedited: Option<Arc<Albedo>>,
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
    const VERSION: u32 = 5;
    type In = TraceIndirectIn;
    type Out = TraceIndirectOut;

    fn run(&self, inputs: TraceIndirectIn, ctx: &Context) -> Result<TraceIndirectOut, NodeError> {
        let TraceIndirectIn { transport, points, normal, albedo, direct, visibility, .. } = &inputs;
        let objects = inputs.objects.as_deref();
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
        let known = objects.map_or(0, |light| light.albedo.len());
        if known != transport.probes()
            || objects.is_some_and(|o| o.probes.len() != direct.lobes.len())
        {
            let wanted = transport.probes();
            return Err(NodeError::Failed(format!(
                "`objects` has {known} probes of bodies, wanted {wanted} as in `transport`, for each lobe of `direct`"
            )));
        }
        let room = inputs.room.as_deref().map_or(&[][..], |room| &room.lobes);
        let cells = |lobe: usize| room.get(lobe).map_or(&[][..], |lobe| lobe.pixels());
        if let Some(lobe) = (0..direct.lobes.len()).find(|&i| cells(i).len() != transport.cells()) {
            let (wanted, got) = (transport.cells(), cells(lobe).len());
            return Err(NodeError::Failed(format!(
                "`room` has {got} cells for lobe {lobe}, wanted {wanted} as in `transport`"
            )));
        }
        let unedited = inputs.unedited.as_ref().unwrap_or(albedo);
        super::same_size("unedited", unedited.0.size(), "transport", size)?;
        let cell_albedo = transport.cell_albedos(albedo, unedited);
        let known = objects.map_or(&[][..], |light| light.albedo.pixels());
        let known = [known, &cell_albedo].concat();
        let lobe = |(lobe, (direct, lit)): (usize, (&Plane<f32>, &Plane<f32>))| {
            ctx.check_cancelled()?;
            super::same_size("direct", direct.size(), "transport", size)?;
            super::same_size("visibility", lit.size(), "transport", size)?;
            let arrives = super::shadowed(direct, lit);
            let of_bodies = objects.map_or(&[][..], |light| light.probes[lobe].pixels());
            let arrives_there = [of_bodies, cells(lobe)].concat();
            let probed = Probed { albedo: &known, direct: &arrives_there };
            let shaded =
                optics::indirect(transport, points, normal, albedo, &arrives, probed, bounces);
            Ok((shaded, arrives_there))
        };
        let shaded: Result<Vec<_>, NodeError> =
            direct.lobes.iter().zip(&visibility.lit).enumerate().map(lobe).collect();
        let (mut lobes, mut stderr, mut probes, mut cells) =
            (Vec::<Shading>::new(), Vec::<Plane<f32>>::new(), Vec::new(), Vec::new());
        for ((shading, error, beyond), arrives) in shaded? {
            lobes.push(shading);
            stderr.push(error);
            let (of_probes, of_cells) = beyond.split_at(transport.probes());
            if objects.is_some() {
                probes.push(Plane::new(of_probes.len(), 1, of_probes.to_vec()));
            }
            if transport.cells() > 0 {
                let shown = |cell: usize| {
                    let arrives = Vec3::splat(arrives[transport.probes() + cell]) + of_cells[cell];
                    cell_albedo[cell] * arrives
                };
                cells.push(Plane::from_fn(of_cells.len(), 1, |cell, _| shown(cell)));
            }
        }
        let value = lobes
            .iter()
            .flat_map(|l| l.0.pixels())
            .fold(0.0, |sum, &v| sum + f64::from(luminance(v)));
        let error = stderr.iter().flat_map(|s| s.pixels()).fold(0.0, |sum, &v| sum + f64::from(v));
        ctx.set_stderr(error / value.max(f64::MIN_POSITIVE));
        Ok(TraceIndirectOut { indirect: Arc::new(UnitIndirect { lobes, stderr, probes, cells }) })
    }
}
