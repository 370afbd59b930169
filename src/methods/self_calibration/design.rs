//! The measuring design: the grid angles that each test touches, and whether they separate the unknowns (paper 1,
//! section 2.2; METHODS section 1).
//!
//! All angles are multiples of δ = 360°/N. The touch with table index `c` and probe index `phi` contacts the part
//! at workpiece index `c + phi` (C is positive by ISO 841).

use std::f64::consts::TAU;

use super::settings::SelfCalibrationSettings;
use crate::MethodRefusal;

/// One touch: its test, and its table and probe angle as indices of the N equal angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AngleGridTouch {
    pub test: CalibrationTest,
    /// Index of the table angle C: positive if the table turns clockwise seen from +Z (ISO 841).
    pub c_index: usize,
    /// Index of the probe angle φ in the machine frame.
    pub phi_index: usize,
}

/// Part of the cycle to which a touch belongs: a test of paper 1, or a round of drift references.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CalibrationTest {
    /// Test 1: the part turns, the probe stays at the probe angle with this index in
    /// [`AngleGridDesign::probe_angle_indices`]. 0 is 1a, 1 is 1b, 2 is 1c.
    Test1(usize),
    /// Test 2: the probe moves around the part at rest.
    Test2,
    /// Test 3: the probe follows one point of the turning part.
    Test3,
    /// Drift references after this number of tests: 0 is before the first.
    ReferenceAfterTests(usize),
}

impl CalibrationTest {
    pub fn is_reference(self) -> bool {
        matches!(self, CalibrationTest::ReferenceAfterTests(_))
    }

    /// Name in labels of steps: `1a`, `1b` and so on, `2`, `3`; `R0` for the references before the first test.
    pub fn name(self) -> String {
        match self {
            CalibrationTest::Test1(probe) => format!("1{}", char::from(b'a' + (probe % 26) as u8)),
            CalibrationTest::Test2 => "2".to_owned(),
            CalibrationTest::Test3 => "3".to_owned(),
            CalibrationTest::ReferenceAfterTests(number) => format!("R{number}"),
        }
    }
}

/// The angles that each test touches; they separate the unknowns.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AngleGridDesign {
    /// Number N of equal angles in one revolution, for table and probe alike.
    pub angle_count: usize,
    /// Probe angles of Test 1, as grid indices; the first is 0. Each is one series of N touches.
    pub probe_angle_indices: Vec<usize>,
}

impl AngleGridDesign {
    /// The design of the settings.
    ///
    /// # Errors
    /// There are fewer than 5 or more than 120 positions, a probe angle is off the grid or occurs twice, there are
    /// fewer than two probe angles or the first is not 0°, or gcd(k_b, N) ≠ 1 (rank deficiency gcd − 1, METHODS section
    /// 1). The refusal names a design that works.
    pub fn new(settings: &SelfCalibrationSettings) -> Result<Self, MethodRefusal> {
        let n = settings.positions;
        MethodRefusal::require(
            (5..=120).contains(&n),
            format!(
                "{n} positions: fewer than 5 cannot separate scale, squareness and axis \
                     position, more than 120 take too long"
            ),
            "choose positions = 8 (5 to 120)",
        )?;
        let probes = match &settings.probe_angles_deg {
            Some(angles) => angles.iter().map(|deg| angle_index_from_deg(*deg, n)).collect::<Result<_, _>>()?,
            None => default_probe_angle_indices(n),
        };
        let design = Self { angle_count: n, probe_angle_indices: probes };
        design.check_separability()?;
        Ok(design)
    }

    fn check_separability(&self) -> Result<(), MethodRefusal> {
        let step = 360.0 / self.angle_count as f64;
        let remedy = format!("choose probe_angles_deg = [0, {step}], or remove probe_angles_deg");
        MethodRefusal::require(
            self.probe_angle_indices.first() == Some(&0) && self.probe_angle_indices.len() >= 2,
            "the first of the probe_angles_deg of Test 1 must be 0°, followed by at least one more angle",
            &remedy,
        )?;
        let twice = |(i, k): (usize, &usize)| self.probe_angle_indices[..i].contains(k);
        MethodRefusal::require(
            !self.probe_angle_indices.iter().enumerate().any(twice),
            "probe_angles_deg contains an angle twice",
            &remedy,
        )?;
        let common = self.probe_angle_indices.iter().fold(self.angle_count, |acc, k| gcd(acc, *k));
        MethodRefusal::require(
            common == 1,
            format!(
                "with {} positions and these probe angles {} unknown(s) are inseparable (rank \
                    deficiency gcd − 1, gcd = {common})",
                self.angle_count,
                common - 1
            ),
            remedy,
        )
    }

    /// Angle of a grid index, rad.
    pub fn grid_angle_rad(&self, index: usize) -> f64 {
        TAU * index as f64 / self.angle_count as f64
    }

    /// Grid index of the workpiece angle of a touch, from the indices of table and probe angle.
    pub fn theta_index(&self, c: usize, phi: usize) -> usize {
        (c + phi) % self.angle_count
    }

    /// The touches in measuring order: 1a, 1b, …, 2, 3, with references between the tests if requested.
    pub fn cycle_touches(&self, with_references: bool) -> Vec<AngleGridTouch> {
        let first = (0..self.probe_angle_indices.len()).map(CalibrationTest::Test1);
        let tests = first.chain([CalibrationTest::Test2, CalibrationTest::Test3]);
        let reference_touches = |round| with_references.then(|| self.reference_touches(round)).into_iter().flatten();
        let mut touches: Vec<AngleGridTouch> = reference_touches(0).collect();
        for (round, test) in (1..).zip(tests) {
            touches.extend((0..self.angle_count).map(|i| self.touch_at_position(test, i)));
            touches.extend(reference_touches(round));
        }
        touches
    }

    /// The touch number `i`, from 0, of a test; of a reference the touch at probe index `i`.
    fn touch_at_position(&self, test: CalibrationTest, i: usize) -> AngleGridTouch {
        let (c_index, phi_index) = match test {
            CalibrationTest::Test1(probe) => (i, self.probe_angle_indices[probe]),
            CalibrationTest::Test3 => (i, (self.angle_count - i) % self.angle_count),
            CalibrationTest::Test2 | CalibrationTest::ReferenceAfterTests(_) => (0, i),
        };
        AngleGridTouch { test, c_index, phi_index }
    }

    /// Reference touches at 0°, 90° and 180°, or at the nearest grid angles. One touch alone detects neither a
    /// shift in Y nor growth.
    fn reference_touches(&self, round: usize) -> impl Iterator<Item = AngleGridTouch> + '_ {
        let near = |quarter: usize| (quarter * self.angle_count + 2) / 4 % self.angle_count;
        let test = CalibrationTest::ReferenceAfterTests(round);
        [0, near(1), near(2)].into_iter().map(move |phi| self.touch_at_position(test, phi))
    }
}

/// 0 and one grid step; also 90° if `n` is a multiple of 4 above 4.
fn default_probe_angle_indices(n: usize) -> Vec<usize> {
    if n.is_multiple_of(4) && n > 4 { vec![0, 1, n / 4] } else { vec![0, 1] }
}

fn angle_index_from_deg(deg: f64, n: usize) -> Result<usize, MethodRefusal> {
    let index = deg / 360.0 * n as f64;
    let rounded = index.round();
    MethodRefusal::require(
        deg.abs() <= 360.0 && index.is_finite() && (index - rounded).abs() <= 1e-6,
        format!("the probe angle {deg}° is not a multiple of 360°/{n}"),
        format!("choose multiples of {}°", 360.0 / n as f64),
    )?;
    Ok((rounded as i64).rem_euclid(n as i64) as usize)
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
