//! The identification exactly as the paper describes it (paper 1, Eqs. 1–4 with the erratum of METHODS section 1): 4N
//! differences to the first touch of Test 1a, boundary conditions 1–3, all differences taken as independent. It
//! serves as a test gate and as a comparison with the estimate. The estimate of `trued` starts from the raw readings,
//! because these differences share one reference.

use faer::Mat;

use super::design::{AngleGridDesign, AngleGridTouch};
use super::fit::SELF_CALIBRATION_RANK_THRESHOLD;
use super::model::{RadiusObservation, UnknownsLayout};
use super::outputs::axis_position_coefficients;
use crate::identification::dot_product;
use estimation::linear_least_squares::{self, LinearError, LinearProblem, LinearSolution};

/// Linear system of the paper for a design. The paper's own design has one probe angle φ_b in addition to 0.
pub struct PaperSystem {
    /// Layout of the unknowns with R: the column of an unknown in this system is its index in the layout minus 1.
    pub layout: UnknownsLayout,
    /// Touches of the cycle in measuring order, without references. The first is the reference of all differences.
    pub touches: Vec<AngleGridTouch>,
    /// Design matrix, 4N × 4N: unknowns as in [`UnknownsLayout`] without R.
    pub design_matrix: Mat<f64>,
    /// Gauge conditions as rows of C·x = 0, for the unknowns of the design matrix.
    pub gauge: Mat<f64>,
}

impl PaperSystem {
    pub fn new(design: &AngleGridDesign) -> Self {
        let touches: Vec<AngleGridTouch> = design.cycle_touches(false);
        let layout =
            UnknownsLayout { design: design.clone(), height_count: 1, drift_order: 0, interruption_times: Vec::new() };
        let observations: Vec<RadiusObservation> = touches.iter().map(|t| unmeasured_observation(*t)).collect();
        let full = layout.design_matrix(&observations);
        let without_r = layout.unknown_count() - 1;
        // The first touch of the grid, Test 1a at C = 0, is the reference of every difference.
        let a = Mat::from_fn(full.nrows(), without_r, |i, j| full[(i, j + 1)] - full[(0, j + 1)]);
        let gauge = layout.gauge_matrix();
        let gauge = Mat::from_fn(gauge.nrows(), without_r, |i, j| gauge[(i, j + 1)]);
        Self { layout, touches, design_matrix: a, gauge }
    }

    /// Solves for the differences (4N, in the order of `touches`), each with the standard uncertainty `sigma`.
    pub fn solve(&self, differences: &[f64], sigma: f64) -> Result<LinearSolution, LinearError> {
        linear_least_squares::solve_least_squares(&LinearProblem {
            a: self.design_matrix.as_ref(),
            y: differences,
            sigma: &vec![sigma; differences.len()],
            constraints: Some(self.gauge.as_ref()),
            rank_threshold: SELF_CALIBRATION_RANK_THRESHOLD,
        })
    }

    /// E_X0C and E_Y0C (mm) as in the paper, from the first reading at each of its positions at the first height.
    /// `None`: a position has no reading, or the system is not solvable.
    pub fn axis_position(&self, observations: &[RadiusObservation]) -> Option<[f64; 2]> {
        let radius = |t: &AngleGridTouch| {
            let is_same =
                |s: &&RadiusObservation| (s.height_index, s.c_index, s.phi_index) == (0, t.c_index, t.phi_index);
            observations.iter().find(is_same).map(|s| s.along_ray_mm)
        };
        let reference = radius(self.touches.first()?)?;
        let differences: Vec<f64> =
            self.touches.iter().map(|t| radius(t).map(|r| r - reference)).collect::<Option<_>>()?;
        let x = self.solve(&differences, 1.0).ok()?.x;
        let (cx, cy) = axis_position_coefficients(&self.layout, 0);
        Some([dot_product(&cx[1..], &x), dot_product(&cy[1..], &x)])
    }
}

fn unmeasured_observation(touch: AngleGridTouch) -> RadiusObservation {
    RadiusObservation {
        step_id: 0,
        height_index: 0,
        c_index: touch.c_index,
        phi_index: touch.phi_index,
        along_ray_mm: 0.0,
        across_ray_mm: 0.0,
        time_s: 0.0,
        relative_time: 0.0,
    }
}
