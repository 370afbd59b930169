//! Whether a machine stands as it stood: the references measured again after a stop, each against
//! its last value before.

use crate::estimation::coverage;

/// An honest machine stays within the limit of one reference with this probability: ±3 standard
/// deviations. Of four references (0°, 90°, 180°, Z) one is then refused falsely in 1.1 % of stops:
/// seldom enough not to teach people to distrust the refusal, and the limit stays narrow.
const INSIDE: f64 = 0.9973;
const INSIDE_FACTOR: f64 = 3.0;
/// Drift is granted up to so many times what the touches themselves may differ by. A reference that
/// may move by more tells nothing any more: after so long a stop a new run is the honest way.
const DRIFT_GRANTED: f64 = 3.0;

/// A reference before the stop and after it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    pub label: String,
    /// Ball centre along the outward normal, before and after, mm.
    pub position_mm: [f64; 2],
    /// Times of the two touches, s.
    pub t_s: [f64; 2],
    /// One step of the displayed position along the normal, mm.
    pub resolution_mm: f64,
}

/// What is known of the scatter of one touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scatter {
    /// Declared standard uncertainty, mm.
    Declared { u_mm: f64 },
    /// From the references themselves, touched again and again before the stop.
    Pooled { u_mm: f64, dof: u32 },
    /// Nothing but the resolution.
    Unknown,
}

impl Scatter {
    /// The declared value; without one, from `series`: per reference all its values before the
    /// stop in order, mm. Successive differences, so that slow drift does not count as scatter.
    pub fn of(declared_mm: Option<f64>, series: &[Vec<f64>]) -> Self {
        if let Some(u_mm) = declared_mm {
            return Self::Declared { u_mm };
        }
        let differences = series.iter().flat_map(|values| values.windows(2));
        let squares: Vec<f64> = differences.map(|pair| (pair[1] - pair[0]).powi(2) / 2.0).collect();
        match squares.len() {
            0 => Self::Unknown,
            count => Self::Pooled {
                u_mm: (squares.iter().sum::<f64>() / count as f64).sqrt(),
                dof: count as u32,
            },
        }
    }

    /// Where the limit comes from, in words.
    pub fn in_words(self) -> String {
        match self {
            Self::Declared { u_mm } => {
                format!("one touch is declared to repeat within {:.2} µm", u_mm * 1e3)
            }
            Self::Pooled { u_mm, dof } => format!(
                "one touch repeats within {:.2} µm, from {dof} repeated references",
                u_mm * 1e3
            ),
            Self::Unknown => "nothing is known of how touches repeat ([probe] repeatability_um is \
                              missing): the limit follows from resolution and drift alone"
                .to_owned(),
        }
    }
}

/// How far one reference lies from where it was, and how far it may.
#[derive(Debug, Clone, PartialEq)]
pub struct Shift {
    pub label: String,
    /// Along the outward normal.
    pub shift_mm: f64,
    pub limit_mm: f64,
}

impl Shift {
    /// The pair's shift against k·√(2·u_touch² + u_drift²) and one step of resolution; u_drift is
    /// bounded. `drift_mm_per_s` is the declared standard deviation of the drift's rate.
    pub fn of(pair: &Pair, scatter: Scatter, drift_mm_per_s: f64) -> Self {
        let (touch, factor) = match scatter {
            Scatter::Declared { u_mm } => (u_mm, INSIDE_FACTOR),
            Scatter::Pooled { u_mm, dof } => (u_mm, coverage::two_sided(INSIDE, f64::from(dof))),
            Scatter::Unknown => (0.0, INSIDE_FACTOR),
        };
        let rounding = pair.resolution_mm / 12f64.sqrt();
        let [before, after] = pair.t_s;
        let touches = (2.0 * (touch.powi(2) + rounding.powi(2))).sqrt();
        let drift = (drift_mm_per_s * (after - before).max(0.0)).min(DRIFT_GRANTED * touches);
        let combined = touches.hypot(drift);
        let [old, new] = pair.position_mm;
        Self {
            label: pair.label.clone(),
            shift_mm: new - old,
            limit_mm: factor * combined + pair.resolution_mm,
        }
    }

    pub fn agrees(&self) -> bool {
        self.shift_mm.abs() <= self.limit_mm
    }
}

impl std::fmt::Display for Shift {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [shift, limit] = [self.shift_mm, self.limit_mm].map(|mm| mm * 1e3);
        write!(f, "{} moved by {shift:+.1} µm (limit {limit:.1} µm)", self.label)
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn pair(shift_mm: f64, seconds: f64) -> Pair {
        Pair {
            label: "R1/P090".to_owned(),
            position_mm: [48.0, 48.0 + shift_mm],
            t_s: [100.0, 100.0 + seconds],
            resolution_mm: 0.0,
        }
    }

    #[test]
    fn the_limit_is_three_standard_deviations_of_the_difference() {
        let declared = Scatter::of(Some(0.5e-3), &[]);
        let shift = Shift::of(&pair(2.0e-3, 0.0), declared, 0.0);
        assert!((shift.limit_mm - 3.0 * 0.5e-3 * 2f64.sqrt()).abs() < 1e-12);
        assert!(shift.agrees() && !Shift::of(&pair(-2.2e-3, 0.0), declared, 0.0).agrees());
        // 5 µm/h over a quarter of an hour: 3·1.25 µm beside the touches.
        let slow = Shift::of(&pair(0.0, 900.0), declared, 5e-3 / 3600.0);
        assert!((slow.limit_mm - 3.0 * (0.5e-6f64 + 1.25e-3f64.powi(2)).sqrt()).abs() < 1e-12);
        // Over a weekend: a part that moved by 20 µm is still found out.
        let weekend = Shift::of(&pair(20e-3, 200_000.0), declared, 5e-3 / 3600.0);
        assert!((weekend.limit_mm - 3.0 * (0.5e-6f64 * 10.0).sqrt()).abs() < 1e-12);
        assert!(!weekend.agrees());
        assert_eq!(shift.to_string(), "R1/P090 moved by +2.0 µm (limit 2.1 µm)");
    }

    /// By drawing: four references of an honest machine, refused falsely in about 1.1 % of stops,
    /// whether the scatter is declared or pooled from three rounds.
    #[test]
    fn false_alarms_are_as_rare_as_promised() {
        let mut rng = crate::base::random::stream(5, &[1]);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let (mut alarms, stops) = ([0, 0], 20_000);
        for _ in 0..stops {
            let rounds: Vec<Vec<f64>> =
                (0..4).map(|_| (0..4).map(|_| 1e-3 * draw()).collect()).collect();
            let before: Vec<Vec<f64>> = rounds.iter().map(|values| values[..3].to_vec()).collect();
            for (which, scatter) in [Scatter::of(Some(1e-3), &before), Scatter::of(None, &before)]
                .into_iter()
                .enumerate()
            {
                let moved = |values: &Vec<f64>| {
                    let pair = Pair { position_mm: [values[2], values[3]], ..pair(0.0, 0.0) };
                    !Shift::of(&pair, scatter, 0.0).agrees()
                };
                alarms[which] += usize::from(rounds.iter().any(moved));
            }
        }
        let rate = alarms.map(|count| f64::from(count as u32) / f64::from(stops));
        assert!((0.008..0.013).contains(&rate[0]), "declared: {rate:?}");
        // The references share their limit, and successive differences overlap.
        assert!((0.005..0.03).contains(&rate[1]), "pooled: {rate:?}");
    }

    #[test]
    fn an_unknown_scatter_is_said() {
        assert_eq!(Scatter::of(None, &[vec![1.0], vec![2.0]]), Scatter::Unknown);
        assert!(Scatter::Unknown.in_words().contains("repeatability_um is missing"));
        let coarse = Pair { resolution_mm: 1e-3, ..pair(1.5e-3, 0.0) };
        assert!(Shift::of(&coarse, Scatter::Unknown, 0.0).agrees());
        assert!(
            !Shift::of(&Pair { resolution_mm: 1e-4, ..coarse }, Scatter::Unknown, 0.0).agrees()
        );
    }
}
