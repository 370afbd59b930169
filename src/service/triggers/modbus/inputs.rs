//! What the control has written: levels, edges, and whether it lives.

use std::time::{Duration, Instant};

use super::map::{
    ACKNOWLEDGE, ARTEFACT, AUTO, COILS, DOOR, ENABLE, IDLE, PROBE, START, STOP, TEMPERATURE,
};
use crate::service::board::Said;
use crate::service::config::MAX_CYCLES;
use crate::service::rota::Told;

/// A coil must have been low for this long before its rise counts: contacts bounce.
const DEBOUNCE: Duration = Duration::from_millis(50);

/// What a write asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wish {
    Start(u16),
    /// More than one start in one write.
    Several,
    Stop,
    Acknowledge,
}

#[derive(Debug)]
pub struct Inputs {
    coils: [bool; COILS],
    /// Since when a coil is known to be low; `None`: it is high, or was never seen.
    low: [Option<Instant>; COILS],
    alive: u16,
    /// The last two changes of `alive`, newest first.
    changed: [Option<Instant>; 2],
    fresh: Duration,
}

impl Inputs {
    /// Nothing is known yet: a coil that is high from the first is no edge.
    pub fn new(fresh: Duration) -> Self {
        let (coils, low) = ([false; COILS], [None; COILS]);
        Self { coils, low, alive: 0, changed: [None; 2], fresh }
    }

    pub fn coils(&self) -> &[bool] {
        &self.coils
    }

    pub fn alive(&self) -> u16 {
        self.alive
    }

    pub fn write_alive(&mut self, value: u16, now: Instant) {
        if value != self.alive {
            self.alive = value;
            self.changed = [Some(now), self.changed[0]];
        }
    }

    /// `values` from coil `first` on, which must fit. In the order in which they are to be done.
    pub fn write(&mut self, first: usize, values: &[bool], now: Instant) -> Vec<Wish> {
        let mut rises = Vec::new();
        let coils = self.coils.iter_mut().zip(self.low.iter_mut()).enumerate().skip(first);
        for ((number, (coil, low)), &value) in coils.zip(values) {
            let settled = low.is_some_and(|since| now.duration_since(since) >= DEBOUNCE);
            let rise = value && !*coil;
            // A stop needs no such care.
            if rise && (settled || number == usize::from(STOP)) {
                rises.push(number as u16);
            }
            *low = if value { None } else { low.or(Some(now)) };
            *coil = value;
        }
        wishes(&rises)
    }

    /// Fresh after two changes of `alive`, each in time: a control that comes back does not start with
    /// what it wrote long ago.
    pub fn said(&self, now: Instant) -> Said {
        let [Some(last), Some(before)] = self.changed else { return Said::default() };
        let in_time = |from: Instant, to: Instant| to.duration_since(from) <= self.fresh;
        if !in_time(last, now) || !in_time(before, last) {
            return Said::default();
        }
        Said {
            fresh: true,
            enable: self.coil(ENABLE),
            auto: self.coil(AUTO),
            door: self.coil(DOOR),
            stop: self.coil(STOP),
            person: false,
        }
    }

    /// As [`Self::said`], with what only a schedule asks for.
    pub fn told(&self, now: Instant) -> Told {
        Told {
            said: self.said(now),
            probe: self.coil(PROBE),
            artefact: self.coil(ARTEFACT),
            temperature: self.coil(TEMPERATURE),
            idle: self.coil(IDLE),
        }
    }

    fn coil(&self, number: u16) -> bool {
        self.coils.get(usize::from(number)).copied().unwrap_or(false)
    }
}

fn wishes(rises: &[u16]) -> Vec<Wish> {
    let starts: Vec<u16> =
        rises.iter().filter_map(|coil| coil.checked_sub(START)).filter(|k| *k > 0).collect();
    debug_assert!(starts.iter().all(|k| *k <= MAX_CYCLES));
    let mut wishes = Vec::new();
    if rises.contains(&STOP) {
        wishes.push(Wish::Stop);
    }
    if rises.contains(&ACKNOWLEDGE) {
        wishes.push(Wish::Acknowledge);
    }
    match starts.as_slice() {
        [] => {}
        [cycle] => wishes.push(Wish::Start(*cycle)),
        _ => wishes.push(Wish::Several),
    }
    wishes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    fn starts(inputs: &mut Inputs, value: bool, now: Instant) -> bool {
        inputs.write(11, &[value], now) == [Wish::Start(1)]
    }

    #[test]
    fn one_start_a_rise_and_bounces_are_none() {
        let t = Instant::now();
        let mut inputs = Inputs::new(Duration::from_secs(1));
        assert!(!starts(&mut inputs, true, t), "high from the first");
        assert!(!starts(&mut inputs, false, ms(t, 100)));
        assert!(starts(&mut inputs, true, ms(t, 200)));
        for (at, value) in [(205, false), (210, true), (215, false), (220, true), (900, true)] {
            assert!(!starts(&mut inputs, value, ms(t, at)), "at {at}");
        }
        assert!(!starts(&mut inputs, false, ms(t, 1000)));
        assert!(!starts(&mut inputs, false, ms(t, 1040)), "low again and again");
        assert!(starts(&mut inputs, true, ms(t, 1060)), "low since 1000");
    }

    #[test]
    fn a_stop_counts_at_once_and_two_starts_are_several() {
        let t = Instant::now();
        let mut inputs = Inputs::new(Duration::from_secs(1));
        assert_eq!(inputs.write(3, &[true], t), [Wish::Stop]);
        assert_eq!(inputs.write(0, &[false; COILS], ms(t, 10)), []);
        let mut both = [false; COILS];
        (both[11], both[18], both[4]) = (true, true, true);
        assert_eq!(inputs.write(0, &both, ms(t, 100)), [Wish::Acknowledge, Wish::Several]);
    }

    #[test]
    fn nothing_counts_that_is_not_fresh() {
        let t = Instant::now();
        let mut inputs = Inputs::new(Duration::from_secs(1));
        inputs.write(0, &[true, true, true], t);
        inputs.write_alive(1, t);
        assert!(!inputs.said(ms(t, 1)).enable, "one change is none");
        inputs.write_alive(1, ms(t, 500));
        assert!(!inputs.said(ms(t, 501)).enable, "the same again is no change");
        inputs.write_alive(2, ms(t, 900));
        let all =
            Said { fresh: true, enable: true, auto: true, door: true, stop: false, person: false };
        assert_eq!(inputs.said(ms(t, 1900)), all);
        assert_eq!(inputs.said(ms(t, 1901)), Said::default());
        inputs.write_alive(3, ms(t, 60_000));
        assert_eq!(inputs.said(ms(t, 60_001)), Said::default(), "back after a minute");
        inputs.write_alive(4, ms(t, 60_500));
        assert_eq!(inputs.said(ms(t, 60_501)), all);
    }
}
