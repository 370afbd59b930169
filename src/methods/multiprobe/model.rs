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

use estimation::revolutions::ChannelAtMounting;
use faer::{Mat, c64};
use machine::Axis;

/// Surface that a sensor measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MeasuredSurface {
    /// Cross section, measured radially: index in [`ProbeLayout::section_z_mm`].
    Section(usize),
    /// Face, measured axially at a distance from the axis.
    Face { radius_mm: f64 },
}

/// A sensor of the layout.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorChannel {
    pub name: String,
    pub surface: MeasuredSurface,
    /// γ, the angle of the sensor about +Z, counter-clockwise from +X of the machine, rad.
    pub angle_rad: f64,
}

/// Error motion or form of the artefact: an unknown function over one revolution. Each of its harmonics is one complex
/// unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionOrForm {
    /// Radial error motion of the rotary axis along X, at the reference height.
    X,
    /// Radial error motion along Y, at the reference height.
    Y,
    /// Tilt error motion about X.
    A,
    /// Tilt error motion about Y.
    B,
    /// Axial error motion along Z.
    Z,
    /// Roundness of a section, by its index.
    Roundness(usize),
    /// Form of the face.
    FaceForm,
}

impl MotionOrForm {
    /// Whether the component is a property of the artefact.
    pub fn is_artefact_form(self) -> bool {
        matches!(self, Self::Roundness(_) | MotionOrForm::FaceForm)
    }

    /// Symbol in the results. `rotary_axis`: the measured axis.
    pub fn symbol(self, rotary_axis: Axis) -> String {
        match self {
            Self::X | Self::Y | Self::Z | Self::A | Self::B => format!("E{self:?}{rotary_axis}"),
            Self::Roundness(section) => format!("R{}", section + 1),
            MotionOrForm::FaceForm => "F".to_owned(),
        }
    }
}

/// Sensors, cross sections and index angles of a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct ProbeLayout {
    pub channels: Vec<SensorChannel>,
    /// Heights of the cross sections, machine frame, in the order of the section indices: one, or two for the tilt
    /// error motions. 0 in a layout reduced to one section.
    pub section_z_mm: Vec<f64>,
    /// z0, the height at which X and Y are given, machine frame. With one section, its height.
    pub reference_z_mm: f64,
    /// φn of each mounting: angle of the artefact on the table relative to the first mounting, counter-clockwise seen
    /// from +Z, rad.
    pub index_angles_rad: Vec<f64>,
    /// The table's axis.
    pub measured_axis: Axis,
    /// σ: +1 if a positive command turns the table counter-clockwise seen from +Z, −1 for C of ISO 841, where the tool
    /// turns counter-clockwise relative to the workpiece.
    pub turn_sign: f64,
}

impl ProbeLayout {
    /// Unknown functions, in the order of the columns. One section does not determine the tilt.
    pub fn components(&self) -> Vec<MotionOrForm> {
        let mut components = vec![MotionOrForm::X, MotionOrForm::Y];
        if self.section_z_mm.len() > 1 {
            components.extend([MotionOrForm::A, MotionOrForm::B]);
        }
        components.extend((0..self.section_z_mm.len()).map(MotionOrForm::Roundness));
        if self.channels.iter().any(|channel| matches!(channel.surface, MeasuredSurface::Face { .. })) {
            components.extend([MotionOrForm::Z, MotionOrForm::FaceForm]);
        }
        components
    }

    /// Layout of one section with radial sensors, and equal index steps of the artefact.
    pub fn with_radial_sensors(angles_deg: &[f64], index_count: usize) -> Self {
        let channel = |angle_deg: &f64| SensorChannel {
            name: format!("{angle_deg}°"),
            surface: MeasuredSurface::Section(0),
            angle_rad: angle_deg.to_radians(),
        };
        Self {
            channels: angles_deg.iter().map(channel).collect(),
            section_z_mm: vec![0.0],
            reference_z_mm: 0.0,
            index_angles_rad: equal_index_angles_rad(index_count),
            measured_axis: Axis::C,
            turn_sign: 1.0,
        }
    }

    /// Layout with the radial sensors of the first section only, its height set to 0.
    pub fn reduced_to_first_section(&self) -> Self {
        let mut layout = Self { section_z_mm: vec![0.0], reference_z_mm: 0.0, ..self.clone() };
        layout.channels.retain(|channel| channel.surface == MeasuredSurface::Section(0));
        layout
    }

    /// Keys of the rows of every channel at every index.
    pub fn all_row_keys(&self) -> Vec<ChannelAtMounting> {
        let channels = 0..self.channels.len();
        let indexes = 0..self.index_angles_rad.len();
        indexes
            .flat_map(|index| {
                channels.clone().map(move |channel| ChannelAtMounting { mounting_index: index, channel_index: channel })
            })
            .collect()
    }

    /// Complex factor of the harmonic `order` of the component in the harmonic M of the row.
    fn harmonic_coefficient(&self, row: ChannelAtMounting, order: usize, component: MotionOrForm) -> c64 {
        let SensorChannel { surface, angle_rad, .. } = &self.channels[row.channel_index];
        let (sin, cos) = angle_rad.sin_cos();
        let artefact_angle = angle_rad - self.index_angles_rad[row.mounting_index];
        let form = c64::cis(-self.turn_sign * order as f64 * artefact_angle);
        let real = |value: f64| c64::new(value, 0.0);
        let lever = |section: usize| self.section_z_mm[section] - self.reference_z_mm;
        match (*surface, component) {
            (MeasuredSurface::Section(_), MotionOrForm::X) => real(cos),
            (MeasuredSurface::Section(_), MotionOrForm::Y) => real(sin),
            (MeasuredSurface::Section(section), MotionOrForm::A) => real(-lever(section) * sin),
            (MeasuredSurface::Section(section), MotionOrForm::B) => real(lever(section) * cos),
            (MeasuredSurface::Section(own), MotionOrForm::Roundness(section)) if own == section => form,
            (MeasuredSurface::Face { radius_mm }, MotionOrForm::A) => real(radius_mm * sin),
            (MeasuredSurface::Face { radius_mm }, MotionOrForm::B) => real(-radius_mm * cos),
            (MeasuredSurface::Face { .. }, MotionOrForm::Z) => real(1.0),
            (MeasuredSurface::Face { .. }, MotionOrForm::FaceForm) => form,
            _ => c64::ZERO,
        }
    }

    /// Design matrix of the harmonic `order`. Rows: the cosine parts of all `rows`, then the sine parts. Columns:
    /// cosine and sine part of each component.
    pub fn design_matrix(&self, rows: &[ChannelAtMounting], order: usize) -> Mat<f64> {
        let components = self.components();
        let mut design = Mat::zeros(2 * rows.len(), 2 * components.len());
        for (i, row) in rows.iter().enumerate() {
            for (j, component) in components.iter().enumerate() {
                // g·(c − i·s) = (re·c + im·s) − i·(re·s − im·c)
                let g = self.harmonic_coefficient(*row, order, *component);
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
        let name = |component: MotionOrForm, part| format!("{}_{part}{order}", component.symbol(self.measured_axis));
        self.components().into_iter().flat_map(|c| ["c", "s"].map(|part| name(c, part))).collect()
    }
}

/// The motions (cos σq, sin σq) and (−sin σq, cos σq) of a pair of components, as vectors over all unknowns of the
/// first harmonic. No directions are returned if the layout does not have both components.
pub fn co_rotating_directions(layout: &ProbeLayout, first: MotionOrForm, second: MotionOrForm) -> Vec<Vec<f64>> {
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
