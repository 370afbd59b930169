//! Settings of the method, the table `[method.laser-r-test]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;

/// What finds the sphere's centre.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum By {
    /// A displacement sensor in the spindle (paper 2).
    #[default]
    Laser,
    /// The touch probe: chase-the-ball.
    Probe,
}

/// When the sensor's samples are taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampled {
    /// While the machine stands, point by point.
    #[default]
    Dwell,
    /// On the way. The control must stamp positions; the search and the references stand all the same.
    Continuous,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    pub by: By,
    /// Name of the sensor. Empty: the first one of the machine file.
    pub sensor: String,
    /// Id of the sphere. Empty: the first one of the artefact.
    pub ball: String,
    /// Machine errors to identify, by ISO names. Empty: all location errors of the rotary axes of the
    /// table that one sphere tells apart.
    pub parameters: Vec<String>,
    /// Orders of the harmonics of the tilting axis' error motions to be identified as well, e.g. `[2]`.
    pub harmonics: Vec<u32>,
    /// Positions of the rotary axis that tilts the table and of the one that turns it, as commanded.
    /// Empty: -90 to 90 in steps of 30 and 0 to 300 in steps of 60, cut to the axes' limits.
    pub tilt_deg: Vec<f64>,
    pub turn_deg: Vec<f64>,
    /// Readings at the sphere's pole at which the beam's direction is found, three or more. Empty: the
    /// middle of the sensor's range and 0.7 of its half to either side.
    pub heights_mm: Vec<f64>,
    pub sampling: Sampled,
    /// Dwell points of each of the two lines of a cross; of a continuous scan, places that its samples
    /// are gathered at.
    pub points: usize,
    /// How far from where it is expected the sphere may be.
    pub margin_mm: f64,
    pub feed_mm_min: f64,
    /// Second feed of the continuous scans from which the sensor's latency is found: half more than
    /// `feed_mm_min` at least.
    pub fast_feed_mm_min: f64,
    /// Samples a second of a continuous scan; of a faster sensor some are left out.
    pub rate_hz: f64,
    /// Rest at a point before the first of its samples.
    pub dwell_s: f64,
    pub samples: u32,
    /// Standard uncertainty of the sphere's stated radius.
    pub radius_u_um: f64,
    /// Standard deviation of the sphere's form about its mean sphere, along any direction.
    pub form_u_um: f64,
    /// Largest less smallest residual of one scan beyond which a warning is due.
    pub form_limit_um: f64,
    /// Trials of the Monte Carlo propagation; 0 lets JCGM 101, 7.9 decide.
    pub monte_carlo_trials: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            by: By::Laser,
            sensor: String::new(),
            ball: String::new(),
            parameters: Vec::new(),
            harmonics: Vec::new(),
            tilt_deg: Vec::new(),
            turn_deg: Vec::new(),
            heights_mm: Vec::new(),
            sampling: Sampled::Dwell,
            points: 13,
            margin_mm: 0.8,
            feed_mm_min: 600.0,
            fast_feed_mm_min: 1800.0,
            rate_hz: 1000.0,
            dwell_s: 0.1,
            samples: 20,
            radius_u_um: 0.5,
            form_u_um: 0.0,
            form_limit_um: 10.0,
            monte_carlo_trials: 0,
        }
    }
}

/// The two feeds of the latency are in this ratio at least.
const FEEDS: f64 = 1.5;
/// Two readings at the pole nearer than this are one height, mm.
pub const ONE_HEIGHT_MM: f64 = 0.5;

/// Bounds that nobody meets who does not slip by a digit or a unit.
const MOST_SAMPLES: u32 = 10_000;
const LONGEST_DWELL_S: f64 = 60.0;
/// Beyond it no table of poses tells anything.
const MOST_ORDER: u32 = 36;

impl Settings {
    /// What would fail on the way, refused before the first move.
    pub fn check(&self) -> Result<(), Refused> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        Refused::unless(
            (3..=1000).contains(&self.points),
            format!("{} points on a line do not show where a sphere is highest", self.points),
            "choose points = 13",
        )?;
        Refused::unless(
            positive(self.margin_mm) && positive(self.feed_mm_min) && self.samples > 0,
            "margin_mm, feed_mm_min and samples must be greater than 0",
            "leave them out, or choose about 0.8, 600 and 20",
        )?;
        self.check_continuous()?;
        Refused::unless(
            self.samples <= MOST_SAMPLES,
            format!("{} samples at each dwell point are more than {MOST_SAMPLES}", self.samples),
            "choose about 20: the machine drifts while it stands there for longer",
        )?;
        Refused::unless(
            (0.0..=LONGEST_DWELL_S).contains(&self.dwell_s)
                && self.radius_u_um >= 0.0
                && self.form_u_um >= 0.0,
            format!(
                "dwell_s lies between 0 and {LONGEST_DWELL_S}; radius_u_um and form_u_um must not be negative"
            ),
            "leave them out, or choose about 0.1 and 0.5",
        )?;
        self.check_orders()?;
        Refused::unless(
            positive(self.form_limit_um),
            "form_limit_um must be greater than 0",
            "leave it out, or choose about 10",
        )?;
        self.check_heights()?;
        Refused::check_trials(self.monte_carlo_trials)
    }

    fn check_heights(&self) -> Result<(), Refused> {
        let count = heights(&self.heights_mm);
        if self.heights_mm.is_empty() || count >= 3 {
            return Ok(());
        }
        Err(Refused {
            why: format!(
                "heights_mm names {count} heights; one height or two leave the beam's direction nearly \
                 unknown"
            ),
            instead: "name three heights or more, well apart within the sensor's range, or leave heights_mm out"
                .to_owned(),
        })
    }

    fn check_continuous(&self) -> Result<(), Refused> {
        let refused =
            |why: String, instead: &str| Err(Refused { why, instead: instead.to_owned() });
        let (feed, fast) = (self.feed_mm_min, self.fast_feed_mm_min);
        match self.sampling {
            Sampled::Dwell => Ok(()),
            Sampled::Continuous if self.by == By::Probe => refused(
                "sampling = \"continuous\", and a touch probe takes no samples".to_owned(),
                "leave sampling out, or measure by = \"laser\"",
            ),
            Sampled::Continuous if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) => refused(
                format!("rate_hz is {}: that takes no samples", self.rate_hz),
                "leave it out, or choose what the sensor gives, about 1000",
            ),
            Sampled::Continuous if !(fast.is_finite() && fast >= FEEDS * feed) => refused(
                format!(
                    "fast_feed_mm_min is {fast}, feed_mm_min {feed}: at feeds so near each other the \
                     sensor's latency is not told from what the axes lose where they turn round"
                ),
                "choose fast_feed_mm_min about three times feed_mm_min",
            ),
            Sampled::Continuous => Ok(()),
        }
    }
}

impl Settings {
    fn check_orders(&self) -> Result<(), Refused> {
        let orders = || self.harmonics.iter().enumerate();
        let twice =
            |(at, order): &(usize, &u32)| self.harmonics.iter().take(*at).any(|o| o == *order);
        let beyond = |order: &&u32| !(1..=MOST_ORDER).contains(*order);
        let (why, instead) = match (self.harmonics.iter().find(beyond), orders().find(twice)) {
            (Some(order), _) => (
                format!("harmonics names order {order}; it lies between 1 and {MOST_ORDER}"),
                "name orders that the positions of tilt_deg can tell apart, e.g. harmonics = [2]",
            ),
            (None, Some((_, order))) => {
                (format!("harmonics names order {order} twice"), "name each order once")
            }
            (None, None) => return Ok(()),
        };
        Err(Refused { why, instead: instead.to_owned() })
    }
}

/// How many heights these readings at the pole are.
pub fn heights(poles_mm: &[f64]) -> usize {
    let mut sorted = poles_mm.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut count = 0;
    let mut last = f64::NEG_INFINITY;
    for pole in sorted.into_iter().filter(|pole| pole.is_finite()) {
        if pole - last > ONE_HEIGHT_MM {
            count += 1;
            last = pole;
        }
    }
    count
}
