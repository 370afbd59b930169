//! Sensor layout and observation equation of one harmonic (paper 3, Eq. (1), for all sensors at once).
//!
//! Conventions. A sensor measures the distance from its zero point along its direction to the surface: a surface
//! that moves towards the sensor decreases the value. The *deviation* m = −value is therefore the displacement of
//! the surface towards the sensor: outwards along n(γ) = (cos γ, sin γ) for a radial sensor at the angle γ, along
//! +Z for an axial sensor above the face. γ is counter-clockwise seen from +Z.
//!
//! A function of the commanded angle q is Re Σ M_k e^(ikq), so M_k = c − i·s for c·cos kq + s·sin kq. The table turns
//! counter-clockwise by σq ([`ProbeLayout::turn_sign`]), the artefact on the table by the index angle φn (also
//! counter-clockwise). The surface w(ψ) under the sensor is at ψ = γ − σq − φn, and R_k is the harmonic of w(−σq):
//! - radial, section at height z: M = (X + (z−z0)B) cos γ + (Y − (z−z0)A) sin γ + R e^(−iσk(γ−φn));
//! - axial, radius ρ: M = Z + ρ(A sin γ − B cos γ) + F e^(−iσk(γ−φn)).
//!
//! X and Y are given at the reference height z0. With X1, X2 of two sections at the distance d this gives B =
//! (X2−X1)/d, A = −(Y2−Y1)/d.

use estimation::revolutions::ChannelAtIndex;
use faer::{Mat, c64};
use machine::Axis;

/// Surface that a sensor measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// Cross section, measured radially: index in [`ProbeLayout::section_z_mm`].
    Section(usize),
    /// Face, measured axially at a distance from the axis.
    Face { radius_mm: f64 },
}

#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    pub name: String,
    pub surface: Surface,
    /// γ, the angle of the sensor, rad.
    pub angle_rad: f64,
}

/// Unknown function over one revolution. Each of its harmonics is one complex unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Component {
    X,
    Y,
    A,
    B,
    Z,
    /// Roundness of a section, by its index.
    Roundness(usize),
    /// Form of the face.
    Face,
}

impl Component {
    /// Whether the component is a property of the artefact.
    pub fn is_artefact_form(self) -> bool {
        matches!(self, Self::Roundness(_) | Self::Face)
    }

    /// Symbol in the results of a table axis with the letter `axis`.
    pub fn symbol(self, axis: Axis) -> String {
        match self {
            Self::X | Self::Y | Self::Z | Self::A | Self::B => format!("E{self:?}{axis}"),
            Self::Roundness(section) => format!("R{}", section + 1),
            Self::Face => "F".to_owned(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct ProbeLayout {
    pub channels: Vec<Channel>,
    /// Heights of the cross sections: one, or two for the tilt error motions.
    pub section_z_mm: Vec<f64>,
    /// z0, the height at which X and Y are given. With one section, its height.
    pub reference_z_mm: f64,
    /// φn, cumulative from the first mounting, rad.
    pub index_angles_rad: Vec<f64>,
    /// The table's axis, and σ: +1 if a positive command turns the table counter-clockwise seen from +Z, −1 for C
    /// of ISO 841, where the tool turns counter-clockwise relative to the workpiece.
    pub axis: Axis,
    pub turn_sign: f64,
}

impl ProbeLayout {
    /// Unknown functions, in the order of the columns. One section does not determine the tilt.
    pub fn components(&self) -> Vec<Component> {
        let mut components = vec![Component::X, Component::Y];
        if self.section_z_mm.len() > 1 {
            components.extend([Component::A, Component::B]);
        }
        components.extend((0..self.section_z_mm.len()).map(Component::Roundness));
        if self.channels.iter().any(|channel| matches!(channel.surface, Surface::Face { .. })) {
            components.extend([Component::Z, Component::Face]);
        }
        components
    }

    /// Layout of one section with radial sensors, and equal index steps of the artefact.
    pub fn with_radial_sensors(angles_deg: &[f64], indexes: usize) -> Self {
        let channel = |angle_deg: &f64| Channel {
            name: format!("{angle_deg}°"),
            surface: Surface::Section(0),
            angle_rad: angle_deg.to_radians(),
        };
        Self {
            channels: angles_deg.iter().map(channel).collect(),
            section_z_mm: vec![0.0],
            reference_z_mm: 0.0,
            index_angles_rad: equal_index_angles_rad(indexes),
            axis: Axis::C,
            turn_sign: 1.0,
        }
    }

    /// Layout reduced to the first section.
    pub fn first_section(&self) -> Self {
        let mut layout = Self { section_z_mm: vec![0.0], reference_z_mm: 0.0, ..self.clone() };
        layout.channels.retain(|channel| channel.surface == Surface::Section(0));
        layout
    }

    /// Rows of every channel at every index.
    pub fn all_row_keys(&self) -> Vec<ChannelAtIndex> {
        let channels = 0..self.channels.len();
        let indexes = 0..self.index_angles_rad.len();
        indexes.flat_map(|index| channels.clone().map(move |channel| ChannelAtIndex { index, channel })).collect()
    }

    /// Derivative of M by the harmonic `order` of the component.
    fn motion_coefficient(&self, row: ChannelAtIndex, order: usize, component: Component) -> c64 {
        let Channel { surface, angle_rad, .. } = &self.channels[row.channel];
        let (sin, cos) = angle_rad.sin_cos();
        let artefact_angle = angle_rad - self.index_angles_rad[row.index];
        let form = c64::cis(-self.turn_sign * order as f64 * artefact_angle);
        let real = |value: f64| c64::new(value, 0.0);
        let lever = |section: usize| self.section_z_mm[section] - self.reference_z_mm;
        match (*surface, component) {
            (Surface::Section(_), Component::X) => real(cos),
            (Surface::Section(_), Component::Y) => real(sin),
            (Surface::Section(section), Component::A) => real(-lever(section) * sin),
            (Surface::Section(section), Component::B) => real(lever(section) * cos),
            (Surface::Section(own), Component::Roundness(section)) if own == section => form,
            (Surface::Face { radius_mm }, Component::A) => real(radius_mm * sin),
            (Surface::Face { radius_mm }, Component::B) => real(-radius_mm * cos),
            (Surface::Face { .. }, Component::Z) => real(1.0),
            (Surface::Face { .. }, Component::Face) => form,
            _ => c64::ZERO,
        }
    }

    /// Design matrix of the harmonic `order`. Rows: the cosine parts of all `rows`, then the sine parts. Columns:
    /// cosine and sine part of each component.
    pub fn design_matrix(&self, rows: &[ChannelAtIndex], order: usize) -> Mat<f64> {
        let components = self.components();
        let mut design = Mat::zeros(2 * rows.len(), 2 * components.len());
        for (i, row) in rows.iter().enumerate() {
            for (j, component) in components.iter().enumerate() {
                // g·(c − i·s) = (re·c + im·s) − i·(re·s − im·c)
                let g = self.motion_coefficient(*row, order, *component);
                design[(i, 2 * j)] = g.re;
                design[(i, 2 * j + 1)] = g.im;
                design[(rows.len() + i, 2 * j)] = -g.im;
                design[(rows.len() + i, 2 * j + 1)] = g.re;
            }
        }
        design
    }

    /// Names of the columns of [`design_matrix`](Self::design_matrix).
    pub fn unknown_names(&self, order: usize) -> Vec<String> {
        let name = |component: Component, part| format!("{}_{part}{order}", component.symbol(self.axis));
        self.components().into_iter().flat_map(|c| ["c", "s"].map(|part| name(c, part))).collect()
    }
}

/// The motions (cos σq, sin σq) and (−sin σq, cos σq) of a pair of components, as unknowns of the first harmonic.
/// Empty if the layout does not have both components.
pub fn co_rotating_directions(layout: &ProbeLayout, first: Component, second: Component) -> Vec<Vec<f64>> {
    let components = layout.components();
    let position = |component| components.iter().position(|c| *c == component);
    let (Some(i), Some(j)) = (position(first), position(second)) else { return Vec::new() };
    let sign = layout.turn_sign;
    // (cosine part, sine part) of the first and of the second component.
    let direction = |parts: [[f64; 2]; 2]| {
        let mut direction = vec![0.0; 2 * components.len()];
        direction[2 * i..2 * i + 2].copy_from_slice(&parts[0]);
        direction[2 * j..2 * j + 2].copy_from_slice(&parts[1]);
        direction
    };
    vec![direction([[1.0, 0.0], [0.0, sign]]), direction([[0.0, -sign], [1.0, 0.0]])]
}

/// Angles of `count` equal steps of one revolution, from 0 on.
pub fn equal_index_angles_rad(count: usize) -> Vec<f64> {
    let count = count.max(1);
    (0..count).map(|n| (n as f64 * 360.0 / count as f64).to_radians()).collect()
}
