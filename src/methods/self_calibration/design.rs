//! The measuring design: the grid angles that each test touches, and whether they separate the unknowns (paper 1,
//! section 2.2; METHODS section 1).
//!
//! All angles are multiples of δ = 360°/N. The touch with table index `c` and probe index `phi` contacts the part
//! at workpiece index `c + phi` (C is positive by ISO 841).

use std::f64::consts::TAU;

use super::settings::Settings;
use crate::Refused;

/// One touch on the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Touch {
    pub test: Test,
    /// Index of the table angle C.
    pub c: usize,
    /// Index of the probe angle φ in the machine frame.
    pub phi: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Test {
    /// Test 1 with the given probe angle: 0 is 1a, 1 is 1b, 2 is 1c.
    One(usize),
    /// Test 2: the probe moves around the part at rest.
    Two,
    /// Test 3: the probe follows one point of the turning part.
    Three,
    /// Drift references before (0) and after each test.
    Reference(usize),
}

impl Test {
    pub fn is_reference(self) -> bool {
        matches!(self, Test::Reference(_))
    }

    pub fn name(self) -> String {
        match self {
            Test::One(probe) => format!("1{}", char::from(b'a' + (probe % 26) as u8)),
            Test::Two => "2".to_owned(),
            Test::Three => "3".to_owned(),
            Test::Reference(number) => format!("R{number}"),
        }
    }
}

/// A well-posed design.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Design {
    pub n: usize,
    /// Probe angles of Test 1, as indices; the first is 0.
    pub probes: Vec<usize>,
}

impl Design {
    /// The design of the settings.
    ///
    /// # Errors
    /// There are fewer than five positions, probe angles off the grid, or gcd(k_b, N) ≠ 1: the rank deficiency is
    /// gcd − 1 (METHODS section 1). The refusal names a design that works.
    pub fn new(settings: &Settings) -> Result<Self, Refused> {
        let n = settings.positions;
        if !(5..=120).contains(&n) {
            return Err(Refused {
                why: format!(
                    "{n} positions: fewer than 5 cannot separate scale, squareness and axis \
                     position, more than 120 take too long"
                ),
                instead: "choose positions = 8 (5 to 120)".to_owned(),
            });
        }
        let probes = match &settings.probe_angles_deg {
            Some(angles) => {
                angles.iter().map(|deg| grid_index(*deg, n)).collect::<Result<_, _>>()?
            }
            None => default_probes(n),
        };
        let design = Self { n, probes };
        design.check()?;
        Ok(design)
    }

    fn check(&self) -> Result<(), Refused> {
        let step = 360.0 / self.n as f64;
        let instead = format!("choose probe_angles_deg = [0, {step}], or leave it out");
        if self.probes.first() != Some(&0) || self.probes.len() < 2 {
            return Err(Refused {
                why: "Test 1 needs the probe at 0° first and at one more angle".to_owned(),
                instead,
            });
        }
        let twice = |(i, k): (usize, &usize)| self.probes[..i].contains(k);
        if self.probes.iter().enumerate().any(twice) {
            return Err(Refused { why: "a probe angle stands twice".to_owned(), instead });
        }
        let common = self.probes.iter().fold(self.n, |acc, k| gcd(acc, *k));
        if common > 1 {
            return Err(Refused {
                why: format!(
                    "with {} positions and these probe angles {} unknown(s) cannot be told apart \
                     (rank deficiency gcd − 1, gcd = {common})",
                    self.n,
                    common - 1
                ),
                instead,
            });
        }
        Ok(())
    }

    /// Angle of a grid index, rad.
    pub fn angle(&self, index: usize) -> f64 {
        TAU * index as f64 / self.n as f64
    }

    /// Grid index of the workpiece angle of a touch.
    pub fn theta(&self, c: usize, phi: usize) -> usize {
        (c + phi) % self.n
    }

    /// The touches in measuring order: 1a, 1b, …, 2, 3, with references between the tests if requested.
    pub fn cycle(&self, references: bool) -> Vec<Touch> {
        let mut touches = Vec::new();
        let tests = (0..self.probes.len()).map(Test::One).chain([Test::Two, Test::Three]);
        let mut round = 0;
        for test in tests {
            if references {
                touches.extend(self.reference(round));
                round += 1;
            }
            touches.extend((0..self.n).map(|i| self.touch(test, i)));
        }
        if references {
            touches.extend(self.reference(round));
        }
        touches
    }

    fn touch(&self, test: Test, i: usize) -> Touch {
        match test {
            Test::One(probe) => Touch { test, c: i, phi: self.probes[probe] },
            Test::Three => Touch { test, c: i, phi: (self.n - i) % self.n },
            Test::Two | Test::Reference(_) => Touch { test, c: 0, phi: i },
        }
    }

    /// Reference touches at 0°, 90° and 180°, or at the nearest grid angles. One touch alone detects neither a
    /// shift in Y nor growth.
    fn reference(&self, round: usize) -> impl Iterator<Item = Touch> + '_ {
        let near = |quarter: usize| (quarter * self.n + 2) / 4 % self.n;
        [0, near(1), near(2)].into_iter().map(move |phi| Touch {
            test: Test::Reference(round),
            c: 0,
            phi,
        })
    }
}

fn default_probes(n: usize) -> Vec<usize> {
    if n.is_multiple_of(4) && n > 4 { vec![0, 1, n / 4] } else { vec![0, 1] }
}

fn grid_index(deg: f64, n: usize) -> Result<usize, Refused> {
    let index = deg / 360.0 * n as f64;
    let rounded = index.round();
    if deg.abs() > 360.0 || !index.is_finite() || (index - rounded).abs() > 1e-6 {
        return Err(Refused {
            why: format!("probe angle {deg}° is no multiple of 360°/{n}"),
            instead: format!("choose multiples of {}°", 360.0 / n as f64),
        });
    }
    Ok((rounded as i64).rem_euclid(n as i64) as usize)
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
