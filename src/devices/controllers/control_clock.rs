//! Checks whether a time that a control reports can be a time of its clock. The drift of a whole run is
//! fitted over these times: one wrong value would ruin the identification long after the touch.

use crate::controllers::ControllerError;

/// Largest time of a clock, s, whatever its epoch. An `f64` of this size still resolves 0.02 ms.
const MAX_CLOCK_TIME_S: f64 = 1e11;
/// Largest time between two blocks of one preparation, s. A longer pause is for the operator: after it the control is
/// prepared again.
const MAX_TIME_BETWEEN_BLOCKS_S: f64 = 86_400.0;
/// Coarsest resolution of a clock, s: a clock may count in whole seconds, so a time may be earlier than the one
/// before by this much.
const COARSEST_CLOCK_RESOLUTION_S: f64 = 1.0;

/// Checks the times of a control's clock since the last preparation.
#[derive(Debug, Default)]
pub(in crate::controllers) struct ControlClock {
    last_accepted_time_s: Option<f64>,
}

impl ControlClock {
    /// Checks both times; returns the time of `contact`, or the time `now` if no time of a contact is reported.
    ///
    /// # Errors
    /// One of the times cannot be a time of this clock.
    pub fn check_and_select_time(
        &mut self,
        contact: ControlTimestamp,
        now: ControlTimestamp,
    ) -> Result<Option<f64>, ControllerError> {
        contact.check_plausible_after(self.last_accepted_time_s)?;
        now.check_plausible_after(self.last_accepted_time_s)?;
        if let (Some(contact_s), Some(now_s)) = (contact.t_s, now.t_s)
            && contact_s > now_s + COARSEST_CLOCK_RESOLUTION_S
        {
            return Err(
                contact.invalid_timestamp_error(contact_s, format!("later than the clock of the control, {now_s:?} s"))
            );
        }
        self.last_accepted_time_s = now.t_s.or(contact.t_s).or(self.last_accepted_time_s);
        Ok(contact.t_s.or(now.t_s))
    }
}

/// A time that a control reports.
#[derive(Debug, Clone, Copy)]
pub(in crate::controllers) struct ControlTimestamp {
    /// Name of the time in the control's reports.
    pub name: &'static str,
    /// Time, s; `None` if it is not reported.
    pub t_s: Option<f64>,
}

impl ControlTimestamp {
    /// Checks that the time is in the range of a clock and follows plausibly on `last_s`, the last accepted time.
    fn check_plausible_after(self, last_s: Option<f64>) -> Result<(), ControllerError> {
        let Some(t_s) = self.t_s else { return Ok(()) };
        if !(0.0..=MAX_CLOCK_TIME_S).contains(&t_s) {
            return Err(self.invalid_timestamp_error(t_s, "outside the range of a clock, 0 to 1e11 s".to_owned()));
        }
        let step_s = last_s.map_or(0.0, |last_s| t_s - last_s);
        if !(-COARSEST_CLOCK_RESOLUTION_S..=MAX_TIME_BETWEEN_BLOCKS_S).contains(&step_s) {
            let last_s = last_s.unwrap_or_default();
            return Err(self.invalid_timestamp_error(t_s, format!("the time reported before was {last_s:?} s")));
        }
        Ok(())
    }

    fn invalid_timestamp_error(self, t_s: f64, reason: String) -> ControllerError {
        ControllerError::InvalidTimestamp { name: self.name, t_s, reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_and_select_time(clock: &mut ControlClock, stamp_s: f64, now_s: f64) -> Result<Option<f64>, String> {
        // As in the window of registers: 0 means no time.
        let reported = |t_s: f64| (t_s != 0.0).then_some(t_s);
        let contact = ControlTimestamp { name: "latch", t_s: reported(stamp_s) };
        let now = ControlTimestamp { name: "now", t_s: reported(now_s) };
        clock.check_and_select_time(contact, now).map_err(|error| error.to_string())
    }

    #[test]
    fn ascending_time_stamps_are_accepted() {
        let mut clock = ControlClock::default();
        assert_eq!(check_and_select_time(&mut clock, 0.0, 1.7e9), Ok(Some(1.7e9)), "seconds of an epoch");
        assert_eq!(check_and_select_time(&mut clock, 1.7e9 + 12.5, 1.7e9 + 13.0), Ok(Some(1.7e9 + 12.5)));
        assert_eq!(check_and_select_time(&mut clock, 0.0, 0.0), Ok(None), "no timestamps");
        assert_eq!(check_and_select_time(&mut clock, 1.7e9 + 3600.0, 0.0), Ok(Some(1.7e9 + 3600.0)));
        let mut coarse = ControlClock::default();
        assert_eq!(check_and_select_time(&mut coarse, 8.0, 8.0), Ok(Some(8.0)));
        assert_eq!(check_and_select_time(&mut coarse, 8.0, 9.0), Ok(Some(8.0)));
    }

    #[test]
    fn implausible_time_stamps_are_refused_with_their_value() {
        for (stamp_s, now_s, named) in [
            (1e300, 101.0, "latch = 1e300 s: outside the range of a clock, 0 to 1e11 s"),
            (f64::NAN, 101.0, "latch = NaN s"),
            (-3.0, 101.0, "latch = -3.0 s"),
            (0.0, f64::INFINITY, "now = inf s"),
            (100.5, 5.0, "now = 5.0 s: the time reported before was 100.0 s"),
            (20.0, 101.0, "latch = 20.0 s: the time reported before was 100.0 s"),
            (1e6, 0.0, "latch = 1000000.0 s: the time reported before was 100.0 s"),
            (500.0, 101.0, "latch = 500.0 s: later than the clock of the control, 101.0 s"),
        ] {
            let mut clock = ControlClock::default();
            assert_eq!(check_and_select_time(&mut clock, 0.0, 100.0), Ok(Some(100.0)));
            let refused = check_and_select_time(&mut clock, stamp_s, now_s).unwrap_err();
            assert!(refused.contains(named), "{refused}");
            assert_eq!(check_and_select_time(&mut clock, 101.0, 102.0), Ok(Some(101.0)), "refused time not kept");
        }
    }
}
