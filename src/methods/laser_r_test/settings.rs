//! Settings of the method, the table `[method.laser-r-test]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;

/// Device that measures the sphere.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeasuringDevice {
    /// A displacement sensor in the spindle (paper 2).
    #[default]
    Laser,
    /// The touch probe: chase-the-ball.
    Probe,
}

/// Sampling mode of the sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SamplingMode {
    /// At standstill, point by point.
    #[default]
    Dwell,
    /// In motion. The control must stamp positions. The search and the references still use dwell points.
    Continuous,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    pub by: MeasuringDevice,
    /// Name of the sensor. Empty: the first one of the machine file.
    pub sensor: String,
    /// Id of the sphere. Empty: the first one of the artefact.
    pub ball: String,
    /// Machine errors to identify, by ISO names. Empty: all location errors of the table's rotary axes that one
    /// sphere separates.
    pub parameters: Vec<String>,
    /// Orders of the harmonics of the tilting axis' error motions to be identified as well, e.g. `[2]`.
    pub harmonics: Vec<u32>,
    /// Commanded positions of the rotary axis that tilts the table and of the one that turns it. Empty: -90 to 90
    /// in steps of 30 and 0 to 300 in steps of 60, limited to the axes' limits.
    pub tilt_deg: Vec<f64>,
    pub turn_deg: Vec<f64>,
    /// Readings at the sphere's pole for the measurement of the beam's direction, three or more. Empty: the middle
    /// of the sensor's range and 0.7 of half the range to either side.
    pub heights_mm: Vec<f64>,
    pub sampling: SamplingMode,
    /// Dwell points on each of the two lines of a cross. For a continuous scan, number of cells over the longest
    /// side of the scan.
    pub points: usize,
    /// Largest distance of the sphere from its expected position, mm.
    pub margin_mm: f64,
    pub feed_mm_min: f64,
    /// Second feed of the continuous scans that determine the sensor's latency, at least 1.5 times `feed_mm_min`.
    pub fast_feed_mm_min: f64,
    /// Samples per second of a continuous scan. Of a faster sensor some samples are skipped.
    pub rate_hz: f64,
    /// Dwell time at a point before its first sample.
    pub dwell_s: f64,
    pub samples: u32,
    /// Standard uncertainty of the sphere's stated radius.
    pub radius_u_um: f64,
    /// Standard deviation of the sphere's form about its mean sphere, along any direction.
    pub form_u_um: f64,
    /// Largest less smallest residual of one scan above which a warning is issued.
    pub form_limit_um: f64,
    /// Number of Monte Carlo trials. 0: adaptive as in JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            by: MeasuringDevice::Laser,
            sensor: String::new(),
            ball: String::new(),
            parameters: Vec::new(),
            harmonics: Vec::new(),
            tilt_deg: Vec::new(),
            turn_deg: Vec::new(),
            heights_mm: Vec::new(),
            sampling: SamplingMode::Dwell,
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

/// Minimum ratio of the two feeds for the latency.
const FEEDS: f64 = 1.5;
/// Readings at the pole that differ by less than this count as one height, mm.
pub const ONE_HEIGHT_MM: f64 = 0.5;

/// Upper bounds that detect a wrong digit or unit in the machine file.
const MOST_SAMPLES: u32 = 10_000;
const LONGEST_DWELL_S: f64 = 60.0;
/// Highest harmonic order. No set of poses determines higher ones.
const MOST_ORDER: u32 = 36;

impl Settings {
    /// Rejects settings that would fail during the run.
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
            SamplingMode::Dwell => Ok(()),
            SamplingMode::Continuous if self.by == MeasuringDevice::Probe => refused(
                "sampling = \"continuous\", and a touch probe takes no samples".to_owned(),
                "leave sampling out, or measure by = \"laser\"",
            ),
            SamplingMode::Continuous if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) => {
                refused(
                    format!("rate_hz is {}: that takes no samples", self.rate_hz),
                    "leave it out, or choose what the sensor gives, about 1000",
                )
            }
            SamplingMode::Continuous if !(fast.is_finite() && fast >= FEEDS * feed) => refused(
                format!(
                    "fast_feed_mm_min is {fast}, feed_mm_min {feed}: at feeds so near each other the \
                     sensor's latency is not told from what the axes lose where they turn round"
                ),
                "choose fast_feed_mm_min about three times feed_mm_min",
            ),
            SamplingMode::Continuous => Ok(()),
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

/// Number of different heights among these readings at the pole.
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
