//! Information about the machine from a choice of measurements: the inverse of its information matrix,
//! updated with each measurement. Balls without a certified length are eliminated.

use nalgebra::{Matrix3, Vector3};

use crate::samba::settings::OptimalityCriterion;
use machine::Axis;

/// Unit of linear errors, offsets and coordinates, mm: their required uncertainty at a noise of 1 µm (METHODS
/// section 4, G4).
pub const REQUIRED_OFFSET_U_MM: f64 = 0.8e-3;
/// Initial variance of the unknowns in their units, so large that it contributes no information.
const INITIAL_VARIANCE: f64 = 1e6;

/// A measurement of one ball at one indexation: ∂(tip on the table)/∂(machine errors, then tool), each column
/// in the unit of its unknown, divided by the standard uncertainty of a centre.
#[derive(Debug, Clone)]
pub struct CandidateMeasurement {
    pub indexation_index: usize,
    pub ball_index: usize,
    pub scaled_derivatives: Vec<Vector3<f64>>,
}

/// A certified distance: its balls, the direction from one to the other, and its standard uncertainty.
#[derive(Debug, Clone, Copy)]
pub struct LengthBar {
    pub ball_indices: [usize; 2],
    /// Unit vector from the first to the second ball, table frame.
    pub direction: Vector3<f64>,
    pub u_mm: f64,
}

/// Inverse of an information matrix, square, row by row.
#[derive(Debug, Clone)]
struct InverseInformation {
    size: usize,
    entries: Vec<f64>,
}

/// Terms of the update of an inverse P by three rows W: P·Wᵀ, and I + W·P·Wᵀ.
struct UpdateTerms {
    cross_covariance: Vec<Vector3<f64>>,
    innovation_covariance: Matrix3<f64>,
}

impl UpdateTerms {
    /// (I + W·P·Wᵀ)⁻¹. It exists because P is positive definite.
    fn innovation_covariance_inverse(&self) -> Matrix3<f64> {
        self.innovation_covariance.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    }
}

impl InverseInformation {
    /// Start without information: independent unknowns with the variance [`INITIAL_VARIANCE`].
    fn new(size: usize) -> Self {
        let diagonal = |i: usize| if i.is_multiple_of(size + 1) { INITIAL_VARIANCE } else { 0.0 };
        Self { size, entries: (0..size * size).map(diagonal).collect() }
    }

    /// `columns`: columns of W, one for each unknown.
    fn update_terms(&self, columns: &[Vector3<f64>]) -> UpdateTerms {
        let rows = self.entries.chunks_exact(self.size);
        let along: Vec<Vector3<f64>> = rows.map(|row| row.iter().zip(columns).map(|(p, w)| *w * *p).sum()).collect();
        let parts = columns.iter().zip(&along).map(|(w, pw)| w * pw.transpose());
        let core = Matrix3::identity() + parts.sum::<Matrix3<f64>>();
        UpdateTerms { cross_covariance: along, innovation_covariance: core }
    }

    /// Adds three rows, given as one column for each unknown (Woodbury identity).
    fn add_rows(&mut self, columns: &[Vector3<f64>]) {
        let effect = self.update_terms(columns);
        let (along, solved) = (&effect.cross_covariance, effect.innovation_covariance_inverse());
        for (row, left) in self.entries.chunks_exact_mut(self.size).zip(along) {
            let left = solved * left;
            row.iter_mut().zip(along).for_each(|(entry, right)| *entry -= left.dot(right));
        }
    }
}

/// Information about the machine's parameters, after elimination of tool and balls.
#[derive(Debug, Clone)]
pub struct MachineInformation {
    /// Number of machine parameters, which are the first unknowns.
    machine_parameter_count: usize,
    /// Index of the first coordinate of each ball among the unknowns; `None`: the ball is eliminated.
    ball_unknowns: Vec<Option<usize>>,
    /// Number of measurements of each ball so far, and the mean of their scaled derivatives.
    measurement_counts_and_means: Vec<(f64, Vec<Vector3<f64>>)>,
    /// Inverse for machine, tool and the balls that are not eliminated.
    inverse_with_machine: InverseInformation,
    /// Inverse for tool and the balls that are not eliminated, with the machine known.
    inverse_without_machine: InverseInformation,
    /// Unit of a ball coordinate divided by the standard uncertainty of a centre.
    ball_unit_per_centre_u: f64,
}

impl MachineInformation {
    /// `machine_count`: number of machine parameters; `shared_count`: number of machine parameters and tool
    /// coordinates; `centre_u_mm`: standard uncertainty of a coordinate of a centre. Balls with a certified length
    /// remain among the unknowns.
    pub fn new(
        machine_count: usize,
        shared_count: usize,
        ball_count: usize,
        bars: &[LengthBar],
        centre_u_mm: f64,
    ) -> Self {
        let mut size = shared_count;
        let mut ball_unknowns = vec![None; ball_count];
        for ball in bars.iter().flat_map(|bar| bar.ball_indices) {
            if let Some(slot @ None) = ball_unknowns.get_mut(ball) {
                *slot = Some(size);
                size += 3;
            }
        }
        let mut information = Self {
            machine_parameter_count: machine_count,
            ball_unknowns,
            measurement_counts_and_means: vec![(0.0, vec![Vector3::zeros(); shared_count]); ball_count],
            inverse_with_machine: InverseInformation::new(size),
            inverse_without_machine: InverseInformation::new(size - machine_count),
            ball_unit_per_centre_u: REQUIRED_OFFSET_U_MM / centre_u_mm,
        };
        bars.iter().for_each(|bar| information.add_length(bar));
        information
    }

    /// Adds the certified length to the information, as one row in the direction of the length.
    fn add_length(&mut self, bar: &LengthBar) {
        let mut columns = vec![Vector3::zeros(); self.inverse_with_machine.size];
        let weight = REQUIRED_OFFSET_U_MM / bar.u_mm;
        for (ball, sign) in bar.ball_indices.into_iter().zip([-1.0, 1.0]) {
            let Some(slot) = self.ball_unknowns.get(ball).copied().flatten() else { continue };
            for (column, part) in columns.iter_mut().skip(slot).zip(&bar.direction) {
                *column = Vector3::new(sign * weight * part, 0.0, 0.0);
            }
        }
        self.add_rows(&columns);
    }

    fn add_rows(&mut self, columns: &[Vector3<f64>]) {
        self.inverse_with_machine.add_rows(columns);
        self.inverse_without_machine.add_rows(columns.get(self.machine_parameter_count..).unwrap_or_default());
    }

    /// The three rows (X, Y, Z) that the measurement adds, as one column for each unknown. For an eliminated
    /// ball, the information about the ball itself is removed: n/(n+1) of the difference from the mean of the n
    /// earlier measurements remains.
    fn reduced_columns(&self, candidate: &CandidateMeasurement) -> Vec<Vector3<f64>> {
        let slot = self.ball_unknowns.get(candidate.ball_index).copied().flatten();
        let mut columns = match (slot, self.measurement_counts_and_means.get(candidate.ball_index)) {
            (None, Some((count, mean))) => {
                let share = (count / (count + 1.0)).sqrt();
                candidate.scaled_derivatives.iter().zip(mean).map(|(new, mean)| (*new - *mean) * share).collect()
            }
            _ => candidate.scaled_derivatives.clone(),
        };
        columns.resize(self.inverse_with_machine.size, Vector3::zeros());
        if let Some(slot) = slot {
            let axes = Axis::LINEAR.map(|axis| -self.ball_unit_per_centre_u * axis.nominal_direction());
            columns.iter_mut().skip(slot).zip(axes).for_each(|(column, to)| *column = to);
        }
        columns
    }

    /// Information gain of the measurement. Both criteria count the machine parameters only. D: increase of the
    /// logarithm of det(information); A: decrease of the sum of variances.
    pub fn information_gain(&self, candidate: &CandidateMeasurement, criterion: OptimalityCriterion) -> f64 {
        let columns = self.reduced_columns(candidate);
        let full = self.inverse_with_machine.update_terms(&columns);
        match criterion {
            OptimalityCriterion::D => {
                let without_machine = columns.get(self.machine_parameter_count..).unwrap_or_default();
                let partial = self.inverse_without_machine.update_terms(without_machine);
                full.innovation_covariance.determinant().ln() - partial.innovation_covariance.determinant().ln()
            }
            OptimalityCriterion::A => {
                let solved = full.innovation_covariance_inverse();
                full.cross_covariance
                    .iter()
                    .take(self.machine_parameter_count)
                    .map(|along| along.dot(&(solved * *along)))
                    .sum()
            }
        }
    }

    /// Adds the measurement.
    pub fn add_measurement(&mut self, candidate: &CandidateMeasurement) {
        let columns = self.reduced_columns(candidate);
        self.add_rows(&columns);
        if let Some((count, mean)) = self.measurement_counts_and_means.get_mut(candidate.ball_index) {
            *count += 1.0;
            for (mean, new) in mean.iter_mut().zip(&candidate.scaled_derivatives) {
                *mean += (*new - *mean) / *count;
            }
        }
    }
}
