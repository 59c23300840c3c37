//! Prior of the light fit: the weights of each column by its role.
//!
//! `InitLights`, `RefineLights` and `FitLights` minimize the same misfit; they differ in the values
//! of a [`LightPrior`].

use glam::Vec3;

use crate::optics::Shape;

/// Role of a column in the fit. It selects the column's weights in [`LightPrior`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A lobe of a light that the photo shows.
    Visible,
    /// A lobe of a light that the photo shows, and that seems to be off.
    Unlit,
    /// A lobe of a light outside of the photo.
    OutOfView,
    /// The sun in a window, whether the photo shows the window or not.
    Sun,
    /// The constant ambient light, which takes the residual that no light explains.
    Ambient,
}

impl Role {
    /// Role of lobe `lobe` of a light: the first lobe of a window is its sun, and `in_view` decides
    /// the role of all others.
    pub fn of_lobe(shape: &Shape, lobe: usize, in_view: bool) -> Role {
        match (shape, lobe) {
            (Shape::Window(_), 0) => Role::Sun,
            _ if in_view => Role::Visible,
            _ => Role::OutOfView,
        }
    }
}

/// Weights of the prior terms of the light fit.
///
/// An L1 weight is the cost of explaining the whole photo by one column. The unit of all weights is
/// the photo's weighted energy, so that neither exposure nor size matter; each is >= 0, and 0 turns
/// its term off. Visible lights have no L1 cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightPrior {
    /// L1 weight of the lobes of lights in view that seem to be off.
    pub unlit: f64,
    /// L1 weight of the lobes of lights out of view.
    pub out_of_view: f64,
    /// L1 weight of the sun in a window.
    pub sun: f64,
    /// L1 weight of the constant ambient light.
    pub ambient: f64,
    /// Tikhonov weight of the guess that all lobes contribute equally. The ambient light and lights
    /// that seem to be off take no part in the guess.
    pub tikhonov_weight: f64,
    /// Weight of the guess that all lights have the color of their mean. The ambient light takes no
    /// part in it.
    pub hue_weight: f64,
    /// Weight of the ambient's fraction of the modeled light in
    /// [`selection_loss`](super::RadianceFit::selection_loss).
    pub residual_weight: f64,
}

impl LightPrior {
    /// L1 weight of a column of this role.
    pub fn l1_weight(&self, role: Role) -> f64 {
        match role {
            Role::Visible => 0.0,
            Role::Unlit => self.unlit,
            Role::OutOfView => self.out_of_view,
            Role::Sun => self.sun,
            Role::Ambient => self.ambient,
        }
    }

    /// Tikhonov weight of a column of this role.
    pub fn tikhonov_weight(&self, role: Role) -> f64 {
        match role {
            Role::Unlit | Role::Ambient => 0.0,
            Role::Visible | Role::OutOfView | Role::Sun => self.tikhonov_weight,
        }
    }

    /// Hue weight of a column of this role.
    pub fn hue_weight(&self, role: Role) -> f64 {
        if role == Role::Ambient { 0.0 } else { self.hue_weight }
    }
}

/// Unit layer of one lobe on the pixels of [`Observations`](super::Observations), and its role in
/// the fit.
#[derive(Clone, Copy, Debug)]
pub struct Column<'a> {
    /// The role, which selects the weights of the prior.
    pub role: Role,
    /// Shading per unit radiance, one value per pixel, linear RGB, >= 0.
    pub layer: &'a [Vec3],
}

impl<'a> Column<'a> {
    /// The column of a unit layer.
    pub fn new(role: Role, layer: &'a [Vec3]) -> Column<'a> {
        Column { role, layer }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Lamp, RectLamp, Window};

    #[test]
    fn the_first_lobe_of_a_window_is_its_sun() {
        let (center, x, y) = (Vec3::NEG_Z, Vec3::X, Vec3::Y);
        let window =
            Shape::Window(Window { center, x, y, lobes: Window::daylight(Vec3::Z, Vec3::Y) });
        let lamp = Shape::Lamp(Lamp::Rect(RectLamp { center, x, y }));
        for (in_view, other) in [(true, Role::Visible), (false, Role::OutOfView)] {
            assert_eq!(
                [0, 1, 2].map(|lobe| Role::of_lobe(&window, lobe, in_view)),
                [Role::Sun, other, other]
            );
            assert_eq!(Role::of_lobe(&lamp, 0, in_view), other);
        }
    }

    #[test]
    fn a_role_selects_its_weights() {
        let prior = LightPrior {
            unlit: 0.5,
            out_of_view: 1.0,
            sun: 2.0,
            ambient: 3.0,
            tikhonov_weight: 4.0,
            hue_weight: 5.0,
            ..LightPrior::default()
        };
        let roles = [Role::Visible, Role::Unlit, Role::OutOfView, Role::Sun, Role::Ambient];
        assert_eq!(roles.map(|role| prior.l1_weight(role)), [0.0, 0.5, 1.0, 2.0, 3.0]);
        assert_eq!(roles.map(|role| prior.tikhonov_weight(role)), [4.0, 0.0, 4.0, 4.0, 0.0]);
        assert_eq!(roles.map(|role| prior.hue_weight(role)), [5.0, 5.0, 5.0, 5.0, 0.0]);
    }
}
