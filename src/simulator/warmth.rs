//! How warm it is where the thermometers sit.

use serde::{Deserialize, Serialize};

use super::{World, WorldError, drawn};

/// One `[[simulated.thermometer]]`: from where it begins it goes on to a new balance, as the drift does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Warmth {
    /// Of the `[[thermometer]]` that is so.
    pub name: String,
    /// When the world was made.
    pub begins_c: f64,
    /// By how much it is warmer in the end.
    pub warms_k: f64,
    /// Standard deviation of what it says.
    pub noise_k: f64,
}

impl Default for Warmth {
    fn default() -> Self {
        Self { name: String::new(), begins_c: 20.0, warms_k: 1.5, noise_k: 0.02 }
    }
}

/// Digits of what is said.
const COUNTS_PER_K: f64 = 100.0;

impl Warmth {
    fn sound(&self) -> bool {
        let all = [self.begins_c, self.warms_k, self.noise_k];
        all.into_iter().all(f64::is_finite) && self.noise_k >= 0.0
    }

    fn at(&self, t_s: f64, seed: u64, number: usize) -> f64 {
        // It says something new each second.
        let noise = self.noise_k * drawn::thermometer_deviate(seed, number, t_s.max(0.0) as u64);
        let celsius = self.begins_c + self.warms_k * drawn::settled(t_s) + noise;
        (celsius * COUNTS_PER_K).round() / COUNTS_PER_K
    }
}

impl World {
    /// With thermometers of these names, each as its `[[simulated.thermometer]]` says.
    ///
    /// # Errors
    /// A `[[simulated.thermometer]]` of no thermometer, or of one that has it already; numbers that no
    /// place has.
    pub fn with_thermometers(mut self, names: &[&str]) -> Result<Self, WorldError> {
        let stated = std::mem::take(&mut self.warmths);
        let count = |name: &str| stated.iter().filter(|stated| stated.name == name).count();
        for Warmth { name, .. } in &stated {
            if !names.contains(&name.as_str()) || count(name) > 1 {
                return Err(WorldError::NoThermometer { name: name.clone() });
            }
        }
        if let Some(bad) = stated.iter().find(|stated| !stated.sound()) {
            return Err(WorldError::Thermometer { name: bad.name.clone() });
        }
        let of = |name: &&str| {
            let usual = || Warmth { name: (*name).to_owned(), ..Warmth::default() };
            stated.iter().find(|stated| stated.name == *name).cloned().unwrap_or_else(usual)
        };
        self.warmths = names.iter().map(of).collect();
        Ok(self)
    }

    /// What the thermometer `name` says now, °C; `None`: there is none.
    pub fn temperature_c(&self, name: &str) -> Option<f64> {
        let number = self.warmths.iter().position(|warmth| warmth.name == name)?;
        Some(self.warmths.get(number)?.at(self.t_s, self.seed, number))
    }
}
