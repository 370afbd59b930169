//! Inputs that the control has written: levels, edges, and the freshness of its `alive` register.

use std::time::{Duration, Instant};

use super::register_map::{
    ACKNOWLEDGE_COIL, ARTEFACT_IN_PLACE_COIL, AUTO_MODE_COIL, COIL_COUNT, CONTROL_IDLE_COIL, DOOR_CLOSED_COIL,
    PROBE_READY_COIL, START_COIL_BASE, START_ENABLED_COIL, STOP_COIL, TEMPERATURE_IN_RANGE_COIL,
};
use crate::service::config::MAX_CYCLES;
use crate::service::machine_state::Interlocks;
use crate::service::schedule_state::Readiness;

/// Debounce time: a coil must have been low for this long before its rising edge counts. The stop coil is not
/// debounced.
const DEBOUNCE_TIME: Duration = Duration::from_millis(50);

/// Command that a write of coils requests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CoilCommand {
    /// Start of the cycle with this number.
    StartCycleNumber(u16),
    /// Start of more than one cycle in one write; refused.
    SeveralStarts,
    /// Hold of the machine; without effect if no cycle is running or about to begin.
    HoldMachine,
    /// Acknowledgement: a person has inspected the machine.
    Acknowledge,
}

/// Coils and `alive` register as the control wrote them last, with the times that debouncing and freshness need.
#[derive(Debug)]
pub struct ControlInputs {
    /// Last written value of each coil, `false` before the first write.
    coils: [bool; COIL_COUNT],
    /// Time since which a coil is known to be low; `None`: it is high, or was never written.
    low_since: [Option<Instant>; COIL_COUNT],
    alive_register: u16,
    /// Times of the last two changes of `alive`, newest first.
    last_alive_changes: [Option<Instant>; 2],
    /// Maximum time between two changes of `alive`, and since the last one, inclusive.
    alive_timeout: Duration,
}

impl ControlInputs {
    /// Inputs before the first write: no coil is known yet, so a coil that is high at its first write is not an edge,
    /// except the stop coil.
    pub fn new(alive_timeout: Duration) -> Self {
        let (coils, low_since) = ([false; COIL_COUNT], [None; COIL_COUNT]);
        Self { coils, low_since, alive_register: 0, last_alive_changes: [None; 2], alive_timeout }
    }

    pub fn coils(&self) -> &[bool] {
        &self.coils
    }

    pub fn alive_register(&self) -> u16 {
        self.alive_register
    }

    /// Writes the `alive` register; only a changed value counts as a sign of life.
    pub fn write_alive(&mut self, value: u16, now: Instant) {
        if value != self.alive_register {
            self.alive_register = value;
            self.last_alive_changes = [Some(now), self.last_alive_changes[0]];
        }
    }

    /// Writes `values` from coil `first` on; they must fit. Returns the commands of the rising edges in the order of
    /// execution: stop, acknowledge, start.
    pub fn write_coils(&mut self, first: usize, values: &[bool], now: Instant) -> Vec<CoilCommand> {
        let mut rises = Vec::new();
        let coils = self.coils.iter_mut().zip(self.low_since.iter_mut()).enumerate().skip(first);
        for ((number, (coil, low_since)), &value) in coils.zip(values) {
            let settled = low_since.is_some_and(|since| now.duration_since(since) >= DEBOUNCE_TIME);
            let rise = value && !*coil;
            // A stop is not debounced.
            if rise && (settled || number == usize::from(STOP_COIL)) {
                rises.push(number as u16);
            }
            *low_since = if value { None } else { low_since.or(Some(now)) };
            *coil = value;
        }
        commands_of_rising_edges(&rises)
    }

    /// Interlocks of the control. They are fresh after two changes of `alive`, each in time, so that a control that
    /// reconnects does not start a cycle with old values. While they are not fresh, all of them are `false`.
    pub fn interlocks(&self, now: Instant) -> Interlocks {
        let [Some(last), Some(before)] = self.last_alive_changes else { return Interlocks::default() };
        let in_time = |from: Instant, to: Instant| to.duration_since(from) <= self.alive_timeout;
        if !in_time(last, now) || !in_time(before, last) {
            return Interlocks::default();
        }
        Interlocks {
            is_fresh: true,
            is_start_enabled: self.coil_level(START_ENABLED_COIL),
            is_auto_mode: self.coil_level(AUTO_MODE_COIL),
            is_door_closed: self.coil_level(DOOR_CLOSED_COIL),
            is_stop_set: self.coil_level(STOP_COIL),
            has_person_for_prompts: false,
        }
    }

    /// Interlocks as by [`Self::interlocks`], and the further conditions of a schedule: the last written coils, also
    /// while the interlocks are not fresh.
    pub fn readiness(&self, now: Instant) -> Readiness {
        Readiness {
            interlocks: self.interlocks(now),
            is_probe_ready: self.coil_level(PROBE_READY_COIL),
            is_artefact_in_place: self.coil_level(ARTEFACT_IN_PLACE_COIL),
            is_temperature_in_range: self.coil_level(TEMPERATURE_IN_RANGE_COIL),
            is_control_idle: self.coil_level(CONTROL_IDLE_COIL),
        }
    }

    fn coil_level(&self, number: u16) -> bool {
        self.coils.get(usize::from(number)).copied().unwrap_or(false)
    }
}

/// Commands in the order of execution: stop, acknowledge, start. Several start coils give one
/// [`CoilCommand::SeveralStarts`].
fn commands_of_rising_edges(risen_coils: &[u16]) -> Vec<CoilCommand> {
    let starts: Vec<u16> =
        risen_coils.iter().filter_map(|coil| coil.checked_sub(START_COIL_BASE)).filter(|k| *k > 0).collect();
    debug_assert!(starts.iter().all(|k| *k <= MAX_CYCLES));
    let mut commands = Vec::new();
    if risen_coils.contains(&STOP_COIL) {
        commands.push(CoilCommand::HoldMachine);
    }
    if risen_coils.contains(&ACKNOWLEDGE_COIL) {
        commands.push(CoilCommand::Acknowledge);
    }
    match starts.as_slice() {
        [] => {}
        [cycle] => commands.push(CoilCommand::StartCycleNumber(*cycle)),
        _ => commands.push(CoilCommand::SeveralStarts),
    }
    commands
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instant_after_ms(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    fn write_starts_cycle_1(inputs: &mut ControlInputs, value: bool, now: Instant) -> bool {
        inputs.write_coils(11, &[value], now) == [CoilCommand::StartCycleNumber(1)]
    }

    #[test]
    fn each_rising_edge_starts_once_and_bounces_do_not() {
        let t = Instant::now();
        let mut inputs = ControlInputs::new(Duration::from_secs(1));
        assert!(!write_starts_cycle_1(&mut inputs, true, t), "the coil was high at its first write");
        assert!(!write_starts_cycle_1(&mut inputs, false, instant_after_ms(t, 100)));
        assert!(write_starts_cycle_1(&mut inputs, true, instant_after_ms(t, 200)));
        for (at, value) in [(205, false), (210, true), (215, false), (220, true), (900, true)] {
            assert!(!write_starts_cycle_1(&mut inputs, value, instant_after_ms(t, at)), "at {at}");
        }
        assert!(!write_starts_cycle_1(&mut inputs, false, instant_after_ms(t, 1000)));
        assert!(!write_starts_cycle_1(&mut inputs, false, instant_after_ms(t, 1040)), "the coil bounced");
        assert!(write_starts_cycle_1(&mut inputs, true, instant_after_ms(t, 1060)), "the coil is low since 1000 ms");
    }

    #[test]
    fn stop_acts_at_once_and_two_start_coils_are_ambiguous() {
        let t = Instant::now();
        let mut inputs = ControlInputs::new(Duration::from_secs(1));
        assert_eq!(inputs.write_coils(3, &[true], t), [CoilCommand::HoldMachine]);
        assert_eq!(inputs.write_coils(0, &[false; COIL_COUNT], instant_after_ms(t, 10)), []);
        let mut both = [false; COIL_COUNT];
        (both[11], both[18], both[4]) = (true, true, true);
        assert_eq!(
            inputs.write_coils(0, &both, instant_after_ms(t, 100)),
            [CoilCommand::Acknowledge, CoilCommand::SeveralStarts]
        );
    }

    #[test]
    fn interlocks_count_only_after_two_timely_alive_changes() {
        let t = Instant::now();
        let mut inputs = ControlInputs::new(Duration::from_secs(1));
        inputs.write_coils(0, &[true, true, true], t);
        inputs.write_alive(1, t);
        assert!(!inputs.interlocks(instant_after_ms(t, 1)).is_start_enabled, "one change of `alive` is not enough");
        inputs.write_alive(1, instant_after_ms(t, 500));
        let interlocks = inputs.interlocks(instant_after_ms(t, 501));
        assert!(!interlocks.is_start_enabled, "the same value of `alive` is no change");
        inputs.write_alive(2, instant_after_ms(t, 900));
        let all = Interlocks {
            is_fresh: true,
            is_start_enabled: true,
            is_auto_mode: true,
            is_door_closed: true,
            is_stop_set: false,
            has_person_for_prompts: false,
        };
        assert_eq!(inputs.interlocks(instant_after_ms(t, 1900)), all);
        assert_eq!(inputs.interlocks(instant_after_ms(t, 1901)), Interlocks::default());
        inputs.write_alive(3, instant_after_ms(t, 60_000));
        assert_eq!(
            inputs.interlocks(instant_after_ms(t, 60_001)),
            Interlocks::default(),
            "one change of `alive` after a minute of silence is not enough"
        );
        inputs.write_alive(4, instant_after_ms(t, 60_500));
        assert_eq!(inputs.interlocks(instant_after_ms(t, 60_501)), all);
    }
}
