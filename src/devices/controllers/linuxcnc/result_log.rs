//! The result log that a program writes, line by line.

use crate::controllers::ControllerError;
use crate::finite_numbers::parse_finite_numbers;
use machine::{Axis, Position};
use planning::gcode::ProbeFault;

/// Smallest distance of a contact from the start of its move, mm. At a smaller distance the probe was closed before the
/// move, and the touch is invalid.
const MIN_CONTACT_DISTANCE_FROM_START_MM: f64 = 0.000_1;

/// Axes of the parameters #5061 to #5066.
const LOGGED_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// Content of the log so far.
#[derive(Debug, Default, PartialEq)]
pub(super) struct ResultLog {
    /// Number of complete lines, which shows whether the log grows.
    pub line_count: usize,
    /// Whether the log has its last line, `END`.
    pub is_complete: bool,
    /// `None`: the log has no touch, no contact of a guarded move and no fault.
    pub result: Option<ProgramResult>,
    /// Numbers of the log line `state`: version, spindle on, G59.3 offsets, tool offset, pins, kinematics.
    pub state_values: Vec<f64>,
    /// Numbers of the log line `axes`: positions of the axes X, Y, Z, A, B, C, mm and degrees.
    pub axis_values: Vec<f64>,
    /// Numbers of the log lines `kinematics`: `motion.switchkins-type`.
    pub kinematics_values: Vec<f64>,
    /// Numbers of the log line `tool_centre`: X, Y, Z, selected work offset, G59.3 offsets.
    pub tool_centre_values: Vec<f64>,
}

#[derive(Debug, PartialEq)]
pub(super) enum ProgramResult {
    /// Touch, with the position at the trigger.
    Touch(Position),
    NoContact,
    /// Contact during a guarded move.
    UnexpectedContact,
    /// Contact before the move began.
    ProbeClosedAtStart,
    /// The work offset slot of the programs, G59.3, is not zero: it was set during the run.
    ProgramOffsetSlotNotZero,
    /// Fault that the probe reports on an input.
    ProbeFault(ProbeFault),
}

impl ResultLog {
    /// Parses what the block of `step` has written; a last line without a line end is still incomplete. The lines
    /// `from`, `guarded` and `touch` have the step, the index of the motion in its block, the contact (1 or 0; not in
    /// `from`) and the position.
    pub fn parse(text: &str, step: u32) -> Result<Self, ControllerError> {
        let mut log = Self::default();
        let mut from = Vec::new();
        for line in text.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
            log.line_count += 1;
            let (kind, rest) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
            let garbled = || ControllerError::UnreadableReply { text: line.trim().to_owned() };
            let numbers = parse_finite_numbers(rest.split_whitespace()).ok_or_else(garbled)?;
            match (kind, numbers.as_slice()) {
                ("END", []) => log.is_complete = true,
                ("offset", []) => log.result = Some(ProgramResult::ProgramOffsetSlotNotZero),
                ("probe_error", []) => log.result = Some(ProgramResult::ProbeFault(ProbeFault::ErrorReported)),
                ("probe_battery", []) => log.result = Some(ProgramResult::ProbeFault(ProbeFault::LowBattery)),
                ("state", _) => log.state_values = numbers,
                ("kinematics", [mode]) => log.kinematics_values.push(*mode),
                ("axes", _) => log.axis_values = numbers,
                ("tool_centre", _) => log.tool_centre_values = numbers,
                (_, [n, _, ..]) if *n != f64::from(step) => return Err(garbled()),
                ("from", [_, _, at @ ..]) => from = at.to_vec(),
                ("guarded", [_, _, touched, at @ ..]) if at.len() >= 3 => {
                    if *touched != 0.0 {
                        log.result = Some(contact_result(&from, at, ProgramResult::UnexpectedContact));
                    }
                }
                ("touch", [_, _, touched, at @ ..]) if at.len() == LOGGED_AXES.len() => {
                    log.result = Some(match *touched == 0.0 {
                        true => ProgramResult::NoContact,
                        false => contact_result(&from, at, ProgramResult::Touch(parse_position(at))),
                    });
                }
                _ => return Err(garbled()),
            }
        }
        Ok(log)
    }
}

/// Result of a contact at `at` in a move from `from`: `result`, unless the probe was closed before the move.
fn contact_result(from: &[f64], at: &[f64], result: ProgramResult) -> ProgramResult {
    let is_at_start = xyz_distance_mm(from, at) < MIN_CONTACT_DISTANCE_FROM_START_MM;
    if is_at_start { ProgramResult::ProbeClosedAtStart } else { result }
}

/// Distance between the first three coordinates; infinite if there are fewer.
fn xyz_distance_mm(from: &[f64], to: &[f64]) -> f64 {
    if from.len() < 3 {
        return f64::INFINITY;
    }
    from.iter().zip(to).take(3).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Position from values in the order of `LOGGED_AXES`, mm and degrees.
pub(super) fn parse_position(mm_and_deg: &[f64]) -> Position {
    LOGGED_AXES.iter().zip(mm_and_deg).map(|(axis, value)| (*axis, axis.to_mm_or_rad(*value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM_LINE: &str = "from 17 4 50.000000 0.000000 60.000000\n";

    fn parse_result(text: &str) -> Option<ProgramResult> {
        ResultLog::parse(&format!("{FROM_LINE}{text}"), 17).unwrap().result
    }

    #[test]
    fn touch_result_has_the_position_of_all_axes() {
        let text = "touch 17 4 1.000000 47.9 0.0 60.0 0.0 0.0 90.0\nEND\n";
        let log = ResultLog::parse(&format!("{FROM_LINE}{text}"), 17).unwrap();
        assert!(log.is_complete && log.line_count == 3);
        let Some(ProgramResult::Touch(at)) = log.result else { panic!("{log:?}") };
        assert_eq!(at.get_or_zero(Axis::X), 47.9);
        assert!((at.get_or_zero(Axis::C) - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn target_of_a_missed_touch_is_not_a_contact() {
        assert_eq!(parse_result("touch 17 4 0.0 40.0 0.0 60.0 0.0 0.0 0.0\n"), Some(ProgramResult::NoContact));
    }

    #[test]
    fn touch_at_its_start_means_a_closed_probe() {
        assert_eq!(parse_result("touch 17 4 1.0 50.0 0.0 60.0 0.0 0.0 0.0\n"), Some(ProgramResult::ProbeClosedAtStart));
        assert_eq!(parse_result("guarded 17 4 1.0 50.0 0.0 60.0\n"), Some(ProgramResult::ProbeClosedAtStart));
    }

    #[test]
    fn contact_in_a_guarded_move_is_an_error() {
        assert_eq!(parse_result("guarded 17 4 0.0 40.0 0.0 60.0\n"), None);
        assert_eq!(parse_result("guarded 17 4 1.0 45.0 0.0 60.0\n"), Some(ProgramResult::UnexpectedContact));
    }

    #[test]
    fn incomplete_line_is_ignored_and_unknown_line_is_refused() {
        assert_eq!(parse_result("touch 17 4 1.0 47.9 0.0 60.0 0.0 0."), None);
        for text in ["touch 18 4 1 1 1 1 1 1 1\n", "touch 17 4 1 1\n", "hm 17 4\n", "touch x\n"] {
            assert!(ResultLog::parse(text, 17).is_err(), "{text}");
        }
    }
}
