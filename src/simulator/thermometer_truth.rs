//! True temperatures at the thermometers.

use serde::{Deserialize, Serialize};

use super::random_draws::{RandomSource, draw_normal, equilibrium_share};
use super::{SimulatedWorld, SimulatedWorldError};

/// One `[[simulated.thermometer]]`: the temperature approaches thermal equilibrium with the time constant of the
/// drift.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermometerTruth {
    /// Name of the `[[thermometer]]` to which this temperature applies.
    pub name: String,
    /// Temperature when the world is created.
    pub begins_c: f64,
    /// Temperature rise until equilibrium.
    pub warms_k: f64,
    /// Standard deviation of a reading; the noise is drawn anew each second.
    pub noise_k: f64,
}

impl Default for ThermometerTruth {
    fn default() -> Self {
        Self { name: String::new(), begins_c: 20.0, warms_k: 1.5, noise_k: 0.02 }
    }
}

/// Resolution of a reading, in counts per kelvin.
const COUNTS_PER_K: f64 = 100.0;

impl ThermometerTruth {
    /// Whether all numbers are finite and the noise is not negative.
    fn is_valid(&self) -> bool {
        let all = [self.begins_c, self.warms_k, self.noise_k];
        all.into_iter().all(f64::is_finite) && self.noise_k >= 0.0
    }

    /// Reading at the simulated time `t_s`, °C, with noise and rounded to the resolution.
    fn reading_c(&self, t_s: f64, seed: u64, thermometer_index: usize) -> f64 {
        // The noise changes once per second.
        let key = [thermometer_index as u64, t_s.max(0.0) as u64];
        let noise = self.noise_k * draw_normal(seed, RandomSource::ThermometerNoise, &key);
        let celsius = self.begins_c + self.warms_k * equilibrium_share(t_s) + noise;
        (celsius * COUNTS_PER_K).round() / COUNTS_PER_K
    }
}

impl SimulatedWorld {
    /// Adds thermometers of these names, each with the temperature of its `[[simulated.thermometer]]`, or without one
    /// of `ThermometerTruth::default`.
    ///
    /// # Errors
    /// The name in a `[[simulated.thermometer]]` is unknown or occurs twice, or a number is impossible.
    pub fn with_thermometers(mut self, names: &[&str]) -> Result<Self, SimulatedWorldError> {
        let stated = std::mem::take(&mut self.thermometers);
        let count = |name: &str| stated.iter().filter(|stated| stated.name == name).count();
        for ThermometerTruth { name, .. } in &stated {
            if !names.contains(&name.as_str()) || count(name) > 1 {
                return Err(SimulatedWorldError::UnknownOrDuplicateThermometer { name: name.clone() });
            }
        }
        if let Some(invalid) = stated.iter().find(|stated| !stated.is_valid()) {
            return Err(SimulatedWorldError::InvalidThermometer { name: invalid.name.clone() });
        }
        let truth_for_name = |name: &&str| {
            let default_truth = || ThermometerTruth { name: (*name).to_owned(), ..ThermometerTruth::default() };
            stated.iter().find(|stated| stated.name == *name).cloned().unwrap_or_else(default_truth)
        };
        self.thermometers = names.iter().map(truth_for_name).collect();
        Ok(self)
    }

    /// Reading of the thermometer `name` now, °C; `None`: there is no such thermometer.
    pub fn temperature_c(&self, name: &str) -> Option<f64> {
        let number = self.thermometers.iter().position(|thermometer| thermometer.name == name)?;
        Some(self.thermometers.get(number)?.reading_c(self.simulated_time_s, self.seed, number))
    }
}
