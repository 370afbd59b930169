//! A displacement sensor as it truly is.

use serde::{Deserialize, Serialize};

use super::WorldError;

/// One `[[simulated.sensor]]`. What is declared by magnitude only in its `[[sensor]]` (noise,
/// linearity) is drawn from the seed unless it stands here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorTruth {
    /// Of the `[[sensor]]` that is so.
    pub name: String,
    /// True zero point less the stated one, spindle frame.
    pub zero_offset_um: [f64; 3],
    /// By how much the beam leans towards the two axes of the spindle frame across its stated
    /// direction: X and Y where it looks along Z, X and Z along Y, Y and Z along X.
    pub tilt_urad: [f64; 2],
    /// What it says per true distance.
    pub gain: f64,
    /// What it says beyond a straight line, in place of what is drawn.
    pub linearity: Option<Vec<Wave>>,
    /// Standard deviation of one sample, in place of the declared one.
    pub noise_um: Option<f64>,
    /// Diameter of the light spot; what is said is the mean over it.
    pub spot_mm: f64,
    /// How much farther a surface seems that stands at 45° to the beam; as the squared tangent.
    pub incidence_um: f64,
    /// The same of its lean along the two axes of `tilt_urad`; as the tangent, with its sign: positive
    /// where the surface recedes along the axis.
    pub lean_um: [f64; 2],
    /// At a greater angle between beam and surface normal no light comes back.
    pub echo_limit_deg: f64,
    /// At a smaller one the receiver is dazzled.
    pub dazzled_deg: f64,
    /// Distances beyond are reported as the nearer of these two, mm: its electronics are saturated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clips_mm: Option<[f64; 2]>,
    /// By how much its clock is slow: a second of its own lasts so much longer.
    pub clock_slow_ppm: f64,
    /// Standard deviation of the moment of one sample about what its clock says.
    pub clock_jitter_us: f64,
    /// What it says at a moment it saw so long before.
    pub clock_late_ms: f64,
}

/// `amplitude·sin(2π·d/period + phase)` over the distance d.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wave {
    pub amplitude_um: f64,
    pub period_mm: f64,
    #[serde(default)]
    pub phase_deg: f64,
}

impl Default for SensorTruth {
    /// Ideal but for the angle at which it sees nothing any more, that of paper 2's kind of sensor.
    fn default() -> Self {
        Self {
            name: String::new(),
            zero_offset_um: [0.0; 3],
            tilt_urad: [0.0; 2],
            gain: 1.0,
            linearity: None,
            noise_um: None,
            spot_mm: 0.0,
            incidence_um: 0.0,
            lean_um: [0.0; 2],
            echo_limit_deg: 40.0,
            dazzled_deg: 0.0,
            clips_mm: None,
            clock_slow_ppm: 0.0,
            clock_jitter_us: 0.0,
            clock_late_ms: 0.0,
        }
    }
}

impl SensorTruth {
    /// # Errors
    /// The first key that no sensor has so.
    pub(super) fn check(&self) -> Result<(), WorldError> {
        let waves = self.linearity.iter().flatten();
        let curve = waves.clone().flat_map(|w| [w.amplitude_um, w.phase_deg]);
        let rules = [
            ("zero_offset_um", self.zero_offset_um.iter().all(|v| v.is_finite())),
            ("tilt_urad", self.tilt_urad.iter().all(|v| v.abs() < MOST_TILT_URAD)),
            ("gain", self.gain > 0.0 && self.gain.is_finite()),
            ("linearity", waves.clone().all(|w| w.period_mm > 0.0)),
            ("linearity", curve.into_iter().all(f64::is_finite)),
            ("noise_um", sound(self.noise_um.unwrap_or_default())),
            ("spot_mm", sound(self.spot_mm)),
            ("incidence_um", self.incidence_um.is_finite()),
            ("lean_um", self.lean_um.iter().all(|v| v.is_finite())),
            ("echo_limit_deg", self.echo_limit_deg > 0.0 && self.echo_limit_deg < 90.0),
            ("clock_slow_ppm", self.clock_slow_ppm.abs() < MOST_PPM),
            ("clock_jitter_us", sound(self.clock_jitter_us)),
            ("clock_late_ms", (0.0..=MOST_LATE_MS).contains(&self.clock_late_ms)),
            ("clips_mm", self.clips_mm.is_none_or(|[low, high]| low < high)),
            ("dazzled_deg", sound(self.dazzled_deg) && self.dazzled_deg < self.echo_limit_deg),
        ];
        match rules.into_iter().find(|(_, holds)| !holds) {
            None => Ok(()),
            Some((key, _)) => Err(WorldError::Sensor { name: self.name.clone(), key }),
        }
    }
}

/// A second.
const MOST_LATE_MS: f64 = 1000.0;
/// A quarter.
const MOST_PPM: f64 = 250_000.0;
/// Half a radian.
const MOST_TILT_URAD: f64 = 500_000.0;

fn sound(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}
