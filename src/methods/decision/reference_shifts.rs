//! Reference check after a stop: the references are measured again, and each is compared with its last value
//! before the stop.

use estimation::coverage;
use machine::record::plan::{Plan, Step, StepKind};

/// Probability that an unchanged machine stays within the limits of all its references, whatever their
/// number. A false refusal in 1.1 % of stops is rare enough to keep the operator's trust. Each of four
/// references (0°, 90°, 180°, Z) then has limits of ±3 standard deviations, each of the 26 points of a scan
/// ±3.5.
const ALL_REFERENCES_AGREE_PROBABILITY: f64 = 0.989_244_470_5;
/// Maximum allowance for drift, as a multiple of the standard deviation of the touch difference. A reference that may
/// drift further gives no information: after so long a stop a new run is needed.
const DRIFT_ALLOWANCE_CAP_RATIO: f64 = 3.0;

/// Measurements of one reference before and after the stop.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferencePair {
    pub label: String,
    /// Outward position before and after, mm: position of the linear axes against the direction of the touch, or
    /// minus the distance that a sensor measured. Only the difference has a meaning.
    pub position_before_after_mm: [f64; 2],
    /// Times of the two touches, s.
    pub times_in_run_before_after_s: [f64; 2],
    /// One step of the displayed position along the normal, mm.
    pub resolution_mm: f64,
}

/// Knowledge of the scatter of one touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TouchScatter {
    /// Declared standard uncertainty, mm.
    Declared { u_mm: f64 },
    /// Standard uncertainty, mm, pooled over the repeated measurements of the references before the stop, and over
    /// those after it; `dof`: number of successive differences.
    Pooled { u_mm: f64, dof: u32 },
    /// Only the resolution is known.
    Unknown,
}

impl TouchScatter {
    /// The declared scatter, or else the scatter from `series`: for each reference its values before the stop in
    /// order, and, as a separate series, those after it, mm. It is computed from successive differences, so that slow
    /// drift does not count as scatter, nor the shift at the stop.
    pub fn from_series(declared_mm: Option<f64>, series: &[Vec<f64>]) -> Self {
        if let Some(u_mm) = declared_mm {
            return Self::Declared { u_mm };
        }
        let differences = series.iter().flat_map(|values| values.windows(2));
        let squares: Vec<f64> = differences.map(|pair| (pair[1] - pair[0]).powi(2) / 2.0).collect();
        match squares.len() {
            0 => Self::Unknown,
            count => Self::Pooled { u_mm: (squares.iter().sum::<f64>() / count as f64).sqrt(), dof: count as u32 },
        }
    }

    /// Text on the origin of the limit.
    pub fn describe(self) -> String {
        match self {
            Self::Declared { u_mm } => {
                format!("declared repeatability of one touch: {:.2} µm", u_mm * 1e3)
            }
            Self::Pooled { u_mm, dof } => {
                format!("repeatability of one touch: {:.2} µm, from {dof} repeated references", u_mm * 1e3)
            }
            Self::Unknown => {
                "the repeatability of a touch is unknown ([probe] repeatability_um is missing): the limit \
                follows from resolution and drift alone"
                    .to_owned()
            }
        }
    }
}

/// Limits for the shift of the references.
#[derive(Debug, Clone, Copy)]
pub struct ShiftLimits {
    /// Standard uncertainty of one touch, mm.
    touch_std_u_mm: f64,
    /// Coverage factor of one reference among all that are compared.
    coverage_factor: f64,
    drift_rate_sd_mm_per_s: f64,
}

impl ShiftLimits {
    /// Limits for `reference_count` references that are compared together, so that all of them agree with probability
    /// [`ALL_REFERENCES_AGREE_PROBABILITY`]. Scatter that comes from the references themselves makes false refusals
    /// even rarer. `drift_rate_sd_mm_per_s` is the declared standard deviation of the drift rate.
    pub fn new(scatter: TouchScatter, reference_count: usize, drift_rate_sd_mm_per_s: f64) -> Self {
        let (touch_std_u_mm, dof) = match scatter {
            TouchScatter::Declared { u_mm } => (u_mm, f64::INFINITY),
            TouchScatter::Pooled { u_mm, dof } => (u_mm, f64::from(dof)),
            TouchScatter::Unknown => (0.0, f64::INFINITY),
        };
        let inside = ALL_REFERENCES_AGREE_PROBABILITY.powf(1.0 / reference_count.max(1) as f64);
        let coverage_factor = coverage::two_sided_t_factor(inside, dof);
        Self { touch_std_u_mm, coverage_factor, drift_rate_sd_mm_per_s }
    }

    /// k·√(2·u_touch² + u_drift²) plus one step of resolution, mm; u_drift is bounded.
    fn limit_mm(&self, pair: &ReferencePair) -> f64 {
        let rounding = pair.resolution_mm / 12f64.sqrt();
        let [before, after] = pair.times_in_run_before_after_s;
        let touches = (2.0 * (self.touch_std_u_mm.powi(2) + rounding.powi(2))).sqrt();
        let drift = (self.drift_rate_sd_mm_per_s * (after - before).max(0.0)).min(DRIFT_ALLOWANCE_CAP_RATIO * touches);
        self.coverage_factor * touches.hypot(drift) + pair.resolution_mm
    }
}

/// Number of reference points that a plan compares: those of the first stage with references. Each point of a scan
/// counts once, whatever the number of its sensors.
pub fn compared_reference_point_count(plan: &Plan) -> usize {
    let references = || plan.steps.iter().filter(|step| step.kind == StepKind::Reference);
    let first = references().next().map(|step| step.stage);
    let together = references().filter(|step| Some(step.stage) == first);
    let points = |step: &Step| step.scan.as_ref().map_or(1, |scan| scan.path.len());
    together.map(points).sum()
}

/// Shift of one reference, and its limit.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceShift {
    pub label: String,
    /// Shift along the outward normal, mm.
    pub shift_mm: f64,
    /// Limit of the magnitude of `shift_mm`, inclusive.
    pub limit_mm: f64,
}

impl ReferenceShift {
    pub fn from_pair(pair: &ReferencePair, limits: &ShiftLimits) -> Self {
        let [old, new] = pair.position_before_after_mm;
        Self { label: pair.label.clone(), shift_mm: new - old, limit_mm: limits.limit_mm(pair) }
    }

    pub fn is_within_limit(&self) -> bool {
        self.shift_mm.abs() <= self.limit_mm
    }
}

/// Maximum number of shifts that a message lists.
const MAX_LISTED_SHIFTS: usize = 4;

/// Lists all shifts if there are few, otherwise the largest relative to their limits.
pub fn describe_shifts(shifts: &[ReferenceShift]) -> String {
    let mut listed: Vec<&ReferenceShift> = shifts.iter().collect();
    if listed.len() > MAX_LISTED_SHIFTS {
        let part = |shift: &ReferenceShift| shift.shift_mm.abs() / shift.limit_mm;
        listed.sort_by(|one, other| part(other).total_cmp(&part(one)));
        listed.truncate(MAX_LISTED_SHIFTS);
    }
    let more = shifts.len() - listed.len();
    let mut texts: Vec<String> = listed.into_iter().map(ReferenceShift::to_string).collect();
    texts.extend((more > 0).then(|| format!("{more} more")));
    texts.join(", ")
}

impl std::fmt::Display for ReferenceShift {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [shift, limit] = [self.shift_mm, self.limit_mm].map(|mm| mm * 1e3);
        write!(f, "{} moved by {shift:+.1} µm (limit {limit:.1} µm)", self.label)
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt as _;
    use rand_distr::StandardNormal;

    use super::*;

    fn reference_pair(shift_mm: f64, seconds: f64) -> ReferencePair {
        ReferencePair {
            label: "R1/P090".to_owned(),
            position_before_after_mm: [48.0, 48.0 + shift_mm],
            times_in_run_before_after_s: [100.0, 100.0 + seconds],
            resolution_mm: 0.0,
        }
    }

    #[test]
    fn shift_limit_of_four_references_is_three_standard_deviations() {
        let declared =
            |um_per_h: f64| ShiftLimits::new(TouchScatter::from_series(Some(0.5e-3), &[]), 4, um_per_h * 1e-3 / 3600.0);
        let shift = ReferenceShift::from_pair(&reference_pair(2.0e-3, 0.0), &declared(0.0));
        assert!((shift.limit_mm - 3.0 * 0.5e-3 * 2f64.sqrt()).abs() < 1e-9);
        assert!(
            shift.is_within_limit()
                && !ReferenceShift::from_pair(&reference_pair(-2.2e-3, 0.0), &declared(0.0)).is_within_limit()
        );
        // Drift of 5 µm/h over a quarter of an hour: 3·1.25 µm in addition to the touches.
        let slow = ReferenceShift::from_pair(&reference_pair(0.0, 900.0), &declared(5.0));
        assert!((slow.limit_mm - 3.0 * (0.5e-6f64 + 1.25e-3f64.powi(2)).sqrt()).abs() < 1e-9);
        // Over a weekend a part that moved by 20 µm is still detected.
        let weekend = ReferenceShift::from_pair(&reference_pair(20e-3, 200_000.0), &declared(5.0));
        assert!((weekend.limit_mm - 3.0 * (0.5e-6f64 * 10.0).sqrt()).abs() < 1e-9);
        assert!(!weekend.is_within_limit());
        assert_eq!(shift.to_string(), "R1/P090 moved by +2.0 µm (limit 2.1 µm)");
    }

    /// Share of refused stops, out of `stops`, for a machine that has moved by `shift` standard deviations of
    /// a touch: with declared scatter, and with scatter pooled from two rounds before the stop and two after
    /// it.
    fn refused_stop_shares(reference_count: usize, shift: f64, stops: u32) -> [f64; 2] {
        const TOUCH_STD_U_MM: f64 = 1e-3;
        let mut rng = estimation::random::seeded_stream(5, &[reference_count as u64]);
        let declared = ShiftLimits::new(TouchScatter::from_series(Some(TOUCH_STD_U_MM), &[]), reference_count, 0.0);
        // The factor depends only on the number of references, so it is computed once, as in a run.
        let pooled =
            ShiftLimits::new(TouchScatter::Pooled { u_mm: 1.0, dof: 2 * reference_count as u32 }, reference_count, 0.0);
        let mut alarms = [0_u32; 2];
        for _ in 0..stops {
            let mut draw = |at: f64| TOUCH_STD_U_MM * (at + rng.sample::<f64, _>(StandardNormal));
            let mut round = |at| (0..reference_count).map(|_| vec![draw(at), draw(at)]).collect::<Vec<_>>();
            let (before, after) = (round(0.0), round(shift));
            let TouchScatter::Pooled { u_mm, dof } =
                TouchScatter::from_series(None, &[before.as_slice(), &after].concat())
            else {
                panic!("no scatter")
            };
            assert_eq!(dof, 2 * reference_count as u32);
            for (alarms, limits) in alarms.iter_mut().zip([declared, ShiftLimits { touch_std_u_mm: u_mm, ..pooled }]) {
                let moved = |(before, after): (&Vec<f64>, &Vec<f64>)| {
                    let pair =
                        ReferencePair { position_before_after_mm: [before[1], after[0]], ..reference_pair(0.0, 0.0) };
                    !ReferenceShift::from_pair(&pair, &limits).is_within_limit()
                };
                *alarms += u32::from(before.iter().zip(&after).any(moved));
            }
        }
        alarms.map(|count| f64::from(count) / f64::from(stops))
    }

    /// Simulated stops: the false alarm rate of 1.1 % of stops does not grow with the number of references, and a
    /// relevant shift is detected.
    #[test]
    fn false_alarm_rate_is_independent_of_the_number_of_references() {
        for reference_count in [1, 4, 26] {
            let [declared, pooled] = refused_stop_shares(reference_count, 0.0, 20_000);
            println!("{reference_count} places: {declared} of stops, {pooled} with pooled scatter");
            // Tolerance of the comparison: four standard deviations of the count.
            assert!(
                (declared - (1.0 - ALL_REFERENCES_AGREE_PROBABILITY)).abs() < 0.003,
                "{reference_count}: {declared}"
            );
            // With pooled scatter, a shift between the rounds also increases the scatter.
            assert!((0.002..0.0138).contains(&pooled), "{reference_count}: {pooled}");
        }
        // A shift of 8 standard deviations of a touch (4 µm with a usual probe) is nearly always detected.
        for reference_count in [4, 26] {
            let [declared, pooled] = refused_stop_shares(reference_count, 8.0, 500);
            assert!(declared > 0.999 && pooled > 0.97, "{reference_count}: {declared} {pooled}");
        }
    }

    #[test]
    fn largest_shifts_are_listed() {
        let limits = ShiftLimits::new(TouchScatter::from_series(Some(0.5e-3), &[]), 26, 0.0);
        let shift = |um: f64| ReferenceShift::from_pair(&reference_pair(um * 1e-3, 0.0), &limits);
        let few: Vec<ReferenceShift> = [1.0, -3.0, 2.0].map(shift).into();
        let texts = describe_shifts(&few);
        assert!(texts.starts_with("R1/P090 moved by +1.0 µm (limit 2.5 µm), "), "{texts}");
        assert_eq!(texts.matches("moved").count(), 3);
        let many: Vec<ReferenceShift> = (0..26).map(|place| shift(f64::from(place - 20))).collect();
        let texts = describe_shifts(&many);
        assert!(texts.starts_with("R1/P090 moved by -20.0 µm"), "{texts}");
        assert!(texts.ends_with("moved by -17.0 µm (limit 2.5 µm), 22 more"), "{texts}");
    }

    #[test]
    fn unknown_scatter_is_reported_and_limits_by_resolution() {
        assert_eq!(TouchScatter::from_series(None, &[vec![1.0], vec![2.0]]), TouchScatter::Unknown);
        assert!(TouchScatter::Unknown.describe().contains("repeatability_um is missing"));
        let coarse = ReferencePair { resolution_mm: 1e-3, ..reference_pair(1.5e-3, 0.0) };
        let unknown = ShiftLimits::new(TouchScatter::Unknown, 1, 0.0);
        assert!(ReferenceShift::from_pair(&coarse, &unknown).is_within_limit());
        assert!(
            !ReferenceShift::from_pair(&ReferencePair { resolution_mm: 1e-4, ..coarse }, &unknown).is_within_limit()
        );
    }
}
