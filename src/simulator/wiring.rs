//! True wiring of the machine, which is hidden from the control: which motor is connected to which drive, its
//! direction, its travel per commanded unit, and the wiring of the probe. The control displays its own positions;
//! the true motion from the initial position follows the wiring.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use machine::{Axis, Position};

/// `[simulated.wiring]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wiring {
    /// Pairs of axes whose motors are exchanged (1 mm for 1°).
    pub swapped: Vec<[Axis; 2]>,
    /// Axes whose motors turn in the opposite direction.
    pub reversed: Vec<Axis>,
    /// True travel of an axis for each mm or degree commanded to its motor; an axis without a value has 1.
    pub gain: BTreeMap<Axis, f64>,
    pub probe: ProbeWiring,
}

/// Wiring of the probe input.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProbeWiring {
    #[default]
    #[serde(rename = "right")]
    Correct,
    /// Closed where the probe is open, and open where it is closed.
    Inverted,
    /// Always open.
    Dead,
    /// Always closed.
    Stuck,
}

impl Wiring {
    pub fn is_correct(&self) -> bool {
        *self == Self::default()
    }
}

/// True wiring, relative to the position `origin` at which the simulated machine was created.
#[derive(Debug, Clone)]
pub(super) struct TrueWiring {
    /// Wrong wiring, and the position at which the machine was built. `None`: the wiring is correct.
    wrong_wiring_and_origin: Option<(Wiring, Position)>,
}

impl TrueWiring {
    pub fn new(wiring: &Wiring, origin: &Position) -> Self {
        let wrong_wiring = (!wiring.is_correct()).then(|| (wiring.clone(), origin.clone()));
        Self { wrong_wiring_and_origin: wrong_wiring }
    }

    /// True axis positions where the control displays `displayed`.
    pub fn true_position(&self, displayed: Position) -> Position {
        let Some((wiring, origin)) = &self.wrong_wiring_and_origin else { return displayed };
        let mut actual = displayed.clone();
        for (drive, position) in displayed.iter() {
            let motor = wiring.motor_of_drive(drive);
            let travelled = drive.to_mm_or_deg(position - origin.get_or_zero(drive)) * wiring.signed_motor_gain(motor);
            if displayed.get(motor).is_some() {
                actual.set(motor, origin.get_or_zero(motor) + motor.to_mm_or_rad(travelled));
            }
        }
        actual
    }

    /// Upper bound of the ratio of true to commanded travel.
    pub fn max_true_travel_ratio(&self) -> f64 {
        let Some((wiring, _)) = &self.wrong_wiring_and_origin else { return 1.0 };
        let mixed = |pair: &[Axis; 2]| pair[0].is_linear() != pair[1].is_linear();
        // A degree may replace a millimetre, or the reverse. Without such a pair, exchanged axes may still increase
        // the distance of the ball from the axis that turns.
        let exchange_factor = if wiring.swapped.iter().any(mixed) { 180.0 } else { 3.0 };
        wiring.gain.values().fold(1.0_f64, |most, gain| most.max(gain.abs())) * exchange_factor
    }

    /// Whether the probe input is closed, for the true state of the probe.
    pub fn is_probe_input_closed(&self, is_probe_closed: bool) -> bool {
        match self.probe_wiring() {
            ProbeWiring::Correct => is_probe_closed,
            ProbeWiring::Inverted => !is_probe_closed,
            ProbeWiring::Dead => false,
            ProbeWiring::Stuck => true,
        }
    }

    /// Whether a contact changes the probe input.
    pub fn probe_input_reacts_to_contact(&self) -> bool {
        matches!(self.probe_wiring(), ProbeWiring::Correct | ProbeWiring::Inverted)
    }

    fn probe_wiring(&self) -> ProbeWiring {
        self.wrong_wiring_and_origin.as_ref().map_or(ProbeWiring::Correct, |(wiring, _)| wiring.probe)
    }
}

impl Wiring {
    /// The axis that truly moves when `drive` is commanded.
    fn motor_of_drive(&self, drive: Axis) -> Axis {
        let other = self.swapped.iter().find_map(|[one, other]| match drive {
            axis if axis == *one => Some(*other),
            axis if axis == *other => Some(*one),
            _ => None,
        });
        other.unwrap_or(drive)
    }

    /// True travel of the axis `motor` for each commanded mm or degree; negative if the motor is reversed.
    fn signed_motor_gain(&self, motor: Axis) -> f64 {
        let sense = if self.reversed.contains(&motor) { -1.0 } else { 1.0 };
        sense * self.gain.get(&motor).copied().unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn true_wiring_from_origin(wiring: Wiring) -> TrueWiring {
        TrueWiring::new(&wiring, &Position::new().with(Axis::X, 0.0).with(Axis::Y, 0.0).with(Axis::Z, 450.0))
    }

    #[test]
    fn wrong_wiring_moves_the_machine_differently_from_the_display() {
        let displayed = Position::new().with(Axis::X, 2.0).with(Axis::Y, -3.0).with(Axis::Z, 440.0);
        let true_position = |wiring| true_wiring_from_origin(wiring).true_position(displayed.clone());
        assert_eq!(true_position(Wiring::default()), displayed);
        let swapped = Wiring { swapped: vec![[Axis::X, Axis::Y]], ..Wiring::default() };
        assert_eq!(true_position(swapped), displayed.clone().with(Axis::X, -3.0).with(Axis::Y, 2.0));
        let reversed = Wiring { reversed: vec![Axis::Z], ..Wiring::default() };
        assert_eq!(true_position(reversed), displayed.clone().with(Axis::Z, 460.0));
        let gain = Wiring { gain: [(Axis::X, 25.4)].into(), ..Wiring::default() };
        assert_eq!(true_position(gain), displayed.clone().with(Axis::X, 50.8));
        // Both at once: the motor of X is connected to the drive of Y, and turns in the opposite direction.
        let both = Wiring { swapped: vec![[Axis::X, Axis::Y]], reversed: vec![Axis::X], ..Wiring::default() };
        assert_eq!(true_position(both), displayed.with(Axis::X, 3.0).with(Axis::Y, 2.0));
    }

    #[test]
    fn probe_input_follows_its_wiring() {
        let input_states = |probe| {
            let true_wiring = true_wiring_from_origin(Wiring { probe, ..Wiring::default() });
            (
                [true_wiring.is_probe_input_closed(false), true_wiring.is_probe_input_closed(true)],
                true_wiring.probe_input_reacts_to_contact(),
            )
        };
        assert_eq!(input_states(ProbeWiring::Correct), ([false, true], true));
        assert_eq!(input_states(ProbeWiring::Inverted), ([true, false], true));
        assert_eq!(input_states(ProbeWiring::Dead), ([false, false], false));
        assert_eq!(input_states(ProbeWiring::Stuck), ([true, true], false));
    }
}
