//! Checks whether a time that a control reports can be a time of its clock. The drift of a whole run is
//! fitted over these times: one wrong value would ruin the identification long after the touch.

use crate::controllers::ControllerError;

/// Largest time of a clock, s, whatever its epoch. An `f64` of this size still resolves 0.02 ms.
const MAX_TIME_S: f64 = 1e11;
/// Largest time between two blocks of one preparation, s: after an operator was at the machine, it is
/// prepared again.
const MAX_STEP_S: f64 = 86_400.0;
/// Coarsest resolution of a clock, s: it may count in whole seconds.
const RESOLUTION_S: f64 = 1.0;

/// Clock of a control since the preparation.
#[derive(Debug, Default)]
pub(in crate::controllers) struct ControlClock {
    last_s: Option<f64>,
}

impl ControlClock {
    /// Returns the time of `contact`, or else the time `now`, which is later.
    ///
    /// # Errors
    /// One of the times cannot be a time of this clock.
    pub fn checked(
        &mut self,
        contact: ReportedTime,
        now: ReportedTime,
    ) -> Result<Option<f64>, ControllerError> {
        contact.follows(self.last_s)?;
        now.follows(self.last_s)?;
        if let (Some(contact_s), Some(now_s)) = (contact.t_s, now.t_s)
            && contact_s > now_s + RESOLUTION_S
        {
            return Err(contact.refused(contact_s, format!("its clock shows only {now_s:?} s")));
        }
        self.last_s = now.t_s.or(contact.t_s).or(self.last_s);
        Ok(contact.t_s.or(now.t_s))
    }
}

/// A time that a control reports.
#[derive(Debug, Clone, Copy)]
pub(in crate::controllers) struct ReportedTime {
    /// Name of the time in the control's reports.
    pub name: &'static str,
    /// Time, s; `None` if it is not reported.
    pub t_s: Option<f64>,
}

impl ReportedTime {
    /// Checks that a clock can report the time, and that it is not far from `last_s`, the time before.
    fn follows(self, last_s: Option<f64>) -> Result<(), ControllerError> {
        let Some(t_s) = self.t_s else { return Ok(()) };
        if !(0.0..=MAX_TIME_S).contains(&t_s) {
            return Err(self.refused(t_s, "no clock shows that".to_owned()));
        }
        let step_s = last_s.map_or(0.0, |last_s| t_s - last_s);
        if !(-RESOLUTION_S..=MAX_STEP_S).contains(&step_s) {
            let last_s = last_s.unwrap_or_default();
            return Err(self.refused(t_s, format!("just before it was {last_s:?} s")));
        }
        Ok(())
    }

    fn refused(self, t_s: f64, why: String) -> ControllerError {
        ControllerError::Stamp { name: self.name, t_s, why }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(clock: &mut ControlClock, stamp_s: f64, now_s: f64) -> Result<Option<f64>, String> {
        // As in the window of registers: 0 means no time.
        let told = |t_s: f64| (t_s != 0.0).then_some(t_s);
        let contact = ReportedTime { name: "latch", t_s: told(stamp_s) };
        let now = ReportedTime { name: "now", t_s: told(now_s) };
        clock.checked(contact, now).map_err(|error| error.to_string())
    }

    #[test]
    fn times_that_follow_each_other_are_taken() {
        let mut clock = ControlClock::default();
        assert_eq!(checked(&mut clock, 0.0, 1.7e9), Ok(Some(1.7e9)), "seconds of an epoch");
        assert_eq!(checked(&mut clock, 1.7e9 + 12.5, 1.7e9 + 13.0), Ok(Some(1.7e9 + 12.5)));
        assert_eq!(checked(&mut clock, 0.0, 0.0), Ok(None), "it does not stamp");
        assert_eq!(checked(&mut clock, 1.7e9 + 3600.0, 0.0), Ok(Some(1.7e9 + 3600.0)));
        let mut coarse = ControlClock::default();
        assert_eq!(checked(&mut coarse, 8.0, 8.0), Ok(Some(8.0)));
        assert_eq!(checked(&mut coarse, 8.0, 9.0), Ok(Some(8.0)));
    }

    #[test]
    fn times_that_cannot_be_are_refused_with_their_value() {
        for (stamp_s, now_s, named) in [
            (1e300, 101.0, "latch = 1e300 s: no clock shows that"),
            (f64::NAN, 101.0, "latch = NaN s"),
            (-3.0, 101.0, "latch = -3.0 s"),
            (0.0, f64::INFINITY, "now = inf s"),
            (100.5, 5.0, "now = 5.0 s: just before it was 100.0 s"),
            (20.0, 101.0, "latch = 20.0 s: just before it was 100.0 s"),
            (1e6, 0.0, "latch = 1000000.0 s: just before it was 100.0 s"),
            (500.0, 101.0, "latch = 500.0 s: its clock shows only 101.0 s"),
        ] {
            let mut clock = ControlClock::default();
            assert_eq!(checked(&mut clock, 0.0, 100.0), Ok(Some(100.0)));
            let refused = checked(&mut clock, stamp_s, now_s).unwrap_err();
            assert!(refused.contains(named), "{refused}");
            assert_eq!(checked(&mut clock, 101.0, 102.0), Ok(Some(101.0)), "it is forgotten");
        }
    }
}
