//! The identification exactly as the paper describes it (paper 1, Eqs. 1–4 with the erratum of METHODS section 1):
//! 4N differences to the first touch of Test 1a, boundary conditions 1–3, all differences taken as independent. It
//! serves as a gate and a comparison. The estimate of `trued` starts from the raw readings, because these
//! differences share one reference.

use faer::Mat;

use super::design::{Design, Test, Touch};
use super::fit::RANK_THRESHOLD;
use super::model::{Layout, Observation};
use super::outputs::{axis_position, dot};
use estimation::linear::{self, LinearError, LinearProblem, LinearSolution};

/// Linear system of the paper for a design. That of the paper has one probe angle φ_b in addition to 0.
pub struct PaperForm {
    pub layout: Layout,
    pub touches: Vec<Touch>,
    /// Design matrix, 4N × 4N: unknowns as in [`Layout`] without R.
    pub a: Mat<f64>,
    pub gauge: Mat<f64>,
}

impl PaperForm {
    pub fn new(design: &Design) -> Self {
        let touches: Vec<Touch> = design.cycle(false);
        let layout =
            Layout { design: design.clone(), heights: 1, drift_order: 0, gaps: Vec::new() };
        let observations: Vec<Observation> = touches.iter().map(|t| place(*t)).collect();
        let full = layout.matrix(&observations);
        let without_r = layout.unknowns() - 1;
        // The first touch of the cycle, Test 1a at C = 0, is the reference of every difference.
        let a = Mat::from_fn(full.nrows(), without_r, |i, j| full[(i, j + 1)] - full[(0, j + 1)]);
        let gauge = layout.gauge();
        let gauge = Mat::from_fn(gauge.nrows(), without_r, |i, j| gauge[(i, j + 1)]);
        Self { layout, touches, a, gauge }
    }

    /// Solves for the differences (4N, in the order of `touches`), each with the standard uncertainty `sigma`.
    pub fn solve(&self, differences: &[f64], sigma: f64) -> Result<LinearSolution, LinearError> {
        linear::solve(&LinearProblem {
            a: self.a.as_ref(),
            y: differences,
            sigma: &vec![sigma; differences.len()],
            constraints: Some(self.gauge.as_ref()),
            rank_threshold: RANK_THRESHOLD,
        })
    }

    /// E_X0C and E_Y0C (mm) as in the paper, from the first reading at each of its positions. `None` if one is
    /// missing.
    pub fn axis_position(&self, seen: &[Observation]) -> Option<[f64; 2]> {
        let radius = |t: &Touch| {
            seen.iter().find(|s| s.height == 0 && s.c == t.c && s.phi == t.phi).map(|s| s.radius)
        };
        let reference = radius(self.touches.first()?)?;
        let differences: Vec<f64> =
            self.touches.iter().map(|t| radius(t).map(|r| r - reference)).collect::<Option<_>>()?;
        let x = self.solve(&differences, 1.0).ok()?.x;
        let (cx, cy) = axis_position(&self.layout, 0);
        Some([dot(&cx[1..], &x), dot(&cy[1..], &x)])
    }
}

fn place(touch: Touch) -> Observation {
    debug_assert!(!matches!(touch.test, Test::Reference(_)));
    Observation {
        step: 0,
        height: 0,
        c: touch.c,
        phi: touch.phi,
        radius: 0.0,
        lateral: 0.0,
        time: 0.0,
    }
}
