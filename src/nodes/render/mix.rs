//! `Mix`: the sum over lights.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::Camera;
use crate::graph::{Context, Gather, Node, NodeError, Scatter};
use crate::image::{Plane, Shading};
use crate::nodes::artifacts::{UnitDirect, UnitIndirect, Visibility};
use crate::optics::Radiance;
use crate::{params, ports};

params! {
    /// Weights each light's unit layers by its radiance: E = sum over lobes of w (direct x lit +
    /// indirect), per channel.
    ///
    /// Linear in the radiances, so that switching, dimming or coloring a light is this sum alone.
    pub struct Mix {}
}

ports! {
    pub input MixIn {
        /// The camera at working size; it gives the size of the shading without any light.
        camera: Arc<Camera>,
        /// Unshadowed unit shading of each light.
        direct: Gather<UnitDirect>,
        /// Visibility of each light.
        visibility: Gather<Visibility>,
        /// Unit indirect shading of each light.
        indirect: Gather<UnitIndirect>,
        /// Radiance of each light.
        radiance: Gather<Radiance>,
    }
}

ports! {
    pub output MixOut {
        /// Shading by each light alone.
        light: Scatter<Shading>,
    }
}

impl Node for Mix {
    const KIND: &'static str = "Mix";
    const VERSION: u32 = 2;
    type In = MixIn;
    type Out = MixOut;

    fn run(&self, inputs: MixIn, _: &Context) -> Result<MixOut, NodeError> {
        let size = (inputs.camera.width, inputs.camera.height);
        let mut light = Vec::new();
        for (id, radiance) in inputs.radiance.iter() {
            let missing = |what: &str| {
                NodeError::Failed(format!("light {id:?} has a radiance but no {what}"))
            };
            let direct = inputs.direct.get(id).ok_or_else(|| missing("direct shading"))?;
            let visibility = inputs.visibility.get(id).ok_or_else(|| missing("visibility"))?;
            let indirect = inputs.indirect.get(id).ok_or_else(|| missing("indirect shading"))?;
            let planes = direct.lobes.iter().chain(&visibility.lit).map(Plane::size);
            for got in planes.chain(indirect.lobes.iter().map(|lobe| lobe.0.size())) {
                super::same_size(id, got, "camera", size)?;
            }
            light.push((
                id.to_string(),
                Arc::new(shading(size, direct, visibility, indirect, radiance)),
            ));
        }
        Ok(MixOut { light: Scatter(light) })
    }
}

fn shading(
    (width, height): (usize, usize),
    direct: &UnitDirect,
    visibility: &Visibility,
    indirect: &UnitIndirect,
    radiance: &Radiance,
) -> Shading {
    let mut sum = Plane::filled(width, height, Vec3::ZERO);
    for (lobe, &w) in radiance.0.iter().enumerate() {
        if w == Vec3::ZERO {
            continue;
        }
        let (direct, lit) = (direct.lobes[lobe].pixels(), visibility.lit[lobe].pixels());
        let indirect = indirect.lobes[lobe].0.pixels();
        for (p, sum) in sum.pixels_mut().iter_mut().enumerate() {
            *sum += w * (indirect[p] + Vec3::splat(direct[p] * lit[p]));
        }
    }
    Shading(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_light_is_its_lobes_weighted() {
        let plane = |v: f32| Plane::filled(2, 1, v);
        let direct = Arc::new(UnitDirect {
            lobes: vec![plane(0.5), plane(2.0)],
            stderr: vec![plane(0.0); 2],
        });
        let visibility = Arc::new(Visibility {
            lit: vec![plane(1.0), plane(0.25)],
            stderr: vec![plane(0.0); 2],
            unknown: vec![plane(0.0); 2],
        });
        let indirect = Arc::new(UnitIndirect {
            lobes: vec![
                Shading(Plane::filled(2, 1, Vec3::new(0.1, 0.2, 0.3))),
                Shading(Plane::filled(2, 1, Vec3::ZERO)),
            ],
            stderr: vec![plane(0.0); 2],
            probes: vec![],
            cells: vec![],
        });
        let one = |radiance: Vec<Vec3>| {
            let inputs = MixIn {
                camera: Arc::new(Camera::from_fov_x(2, 1, 60.0)),
                direct: Gather(vec![("a".into(), direct.clone())]),
                visibility: Gather(vec![("a".into(), visibility.clone())]),
                indirect: Gather(vec![("a".into(), indirect.clone())]),
                radiance: Gather(vec![("a".into(), Arc::new(Radiance(radiance)))]),
            };
            Mix {}.run(inputs, &Context::default()).expect("runs").light.0[0].1.0.get(1, 0)
        };
        let got = one(vec![Vec3::new(1.0, 2.0, 0.0), Vec3::new(3.0, 0.0, 1.0)]);
        let want = Vec3::new(0.6 + 1.5, 2.0 * 0.7, 0.5);
        assert!((got - want).abs().max_element() < 1e-6, "{got} against {want}");
        assert_eq!(one(vec![Vec3::ZERO; 2]), Vec3::ZERO);
    }

    #[test]
    fn a_light_that_is_not_there_is_black_at_full_size() {
        let id = || "a".to_string();
        let inputs = MixIn {
            camera: Arc::new(Camera::from_fov_x(3, 2, 60.0)),
            direct: Gather(vec![(id(), Arc::new(UnitDirect { lobes: vec![], stderr: vec![] }))]),
            visibility: Gather(vec![(
                id(),
                Arc::new(Visibility { lit: vec![], stderr: vec![], unknown: vec![] }),
            )]),
            indirect: Gather(vec![(
                id(),
                Arc::new(UnitIndirect {
                    lobes: vec![],
                    stderr: vec![],
                    probes: vec![],
                    cells: vec![],
                }),
            )]),
            radiance: Gather(vec![(id(), Arc::new(Radiance(vec![])))]),
        };
        let out = Mix {}.run(inputs, &Context::default()).expect("runs");
        assert_eq!(out.light.0[0].1.0, Plane::filled(3, 2, Vec3::ZERO));
    }
}
