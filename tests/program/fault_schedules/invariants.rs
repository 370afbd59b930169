//! Invariants that hold under every fault.

use std::collections::VecDeque;

use devices::controllers::ControllerError;
use machine::Axis;
use machine::record::event::RunEvent;
use machine::record::reading::Reading;
use trued::run::RunError;
use trued::store::RunState;

use super::faulty_run::EndedRun;
use super::wire_recording::{Direction, RecordedLine, is_motion_line, n_word_of_line};

/// The control's buffer, bytes.
const RX_BUFFER_BYTES: usize = 1024;
const FIRMWARE_BANNER: &str = "GrblHAL 1.1f [";
/// Axes in the order of the control's reports.
const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

/// Every violation, as text.
pub fn invariant_violations(ended: &EndedRun) -> Vec<String> {
    let mut all = Vec::new();
    all.extend(find_motion_after_fault(ended));
    all.extend(find_unmatched_reading(ended));
    all.extend(find_lost_reading(ended));
    all.extend(find_window_violation(&ended.driver_side_tape));
    all.extend(find_wrong_state(ended));
    all
}

fn is_fault_line(line: &str) -> bool {
    let numbered = |start: &str| line.strip_prefix(start).is_some_and(|code| code.parse::<u32>().is_ok());
    let state = ["<Alarm", "<Hold", "<Door", "<Tool"].iter().any(|state| line.starts_with(state));
    state || numbered("ALARM:") || numbered("error:") || line.starts_with(FIRMWARE_BANNER)
}

/// Finds a motion that was sent after a fault was received or after the end of the run.
fn find_motion_after_fault(ended: &EndedRun) -> Option<String> {
    let near = &ended.driver_side_tape;
    let sent = |entry: &RecordedLine| entry.direction == Direction::ToControl;
    let first = near.iter().position(|entry| sent(entry) && is_motion_line(&entry.line))?;
    let fault =
        near[first..].iter().position(|entry| if sent(entry) { entry.line == "!" } else { is_fault_line(&entry.line) });
    let late = |from: usize, what: &str| {
        let after = near[from..].iter().find(|entry| sent(entry) && is_motion_line(&entry.line));
        after.map(|entry| format!("`{}` was sent after {what}", entry.line))
    };
    fault
        .and_then(|fault| late(first + fault, &format!("`{}`", near[first + fault].line)))
        .or_else(|| late(ended.driver_side_tape_length_at_end, "the end of the run"))
}

/// A contact as the control reports it, before the wire: line, position, time.
struct ReportedContact {
    sent_line: String,
    position: String,
    time_stamp: String,
}

fn reported_contacts(ended: &EndedRun) -> Vec<ReportedContact> {
    let mut contacts = Vec::new();
    let mut asked = "";
    let mut lines = ended.control_side_tape.iter().peekable();
    while let Some(entry) = lines.next() {
        if entry.direction == Direction::ToControl {
            asked = &entry.line;
            continue;
        }
        let told = entry.line.strip_prefix("[PRB:").and_then(|rest| rest.strip_suffix(":1]"));
        // `$#` repeats the last contact.
        let Some(position) = told.filter(|_| !asked.contains('$')) else { continue };
        let stamp = lines.find(|entry| entry.direction == Direction::FromControl);
        let stamp = stamp.map_or(String::new(), |entry| entry.line.clone());
        contacts.push(ReportedContact {
            sent_line: asked.to_owned(),
            position: position.to_owned(),
            time_stamp: stamp,
        });
    }
    contacts
}

fn position_and_stamp_text(reading: &Reading) -> (String, String) {
    let value = |axis: Axis| {
        let text = format!("{:.3}", axis.to_mm_or_deg(reading.position.get_or_zero(axis)));
        if text == "-0.000" { "0.000".to_owned() } else { text }
    };
    (AXES.map(value).join(","), format!("[TIME:{}]", reading.t_s))
}

/// Finds a reading that is duplicated, invented or not of its step.
fn find_unmatched_reading(ended: &EndedRun) -> Option<String> {
    let mut contacts = reported_contacts(ended).into_iter();
    for (place, reading) in ended.stored.readings.iter().enumerate() {
        if (reading.step, reading.repeat) != (place as u32, 0) {
            return Some(format!("reading {place} is of step {}", reading.step));
        }
        // Each reading needs a contact of the control, in the order in which they occurred, each used at most once.
        let told = position_and_stamp_text(reading);
        let Some(contact) = contacts.find(|contact| (&contact.position, &contact.time_stamp) == (&told.0, &told.1))
        else {
            return Some(format!("the control never told {told:?}, step {}", reading.step));
        };
        let as_sent = ended
            .driver_side_tape
            .iter()
            .any(|entry| entry.direction == Direction::ToControl && entry.line == contact.sent_line);
        if as_sent && n_word_of_line(&contact.sent_line) != Some(reading.step) {
            return Some(format!("step {} got the touch of `{}`", reading.step, contact.sent_line));
        }
    }
    None
}

/// Finds a step whose first motion was sent before the readings of all earlier steps were stored.
fn find_lost_reading(ended: &EndedRun) -> Option<String> {
    if ended.returned_readings != ended.stored.readings {
        return Some("the run's readings are not the journal's".to_owned());
    }
    let sent = ended.driver_side_tape.iter().filter(|entry| entry.direction == Direction::ToControl);
    let last = sent.filter(|entry| is_motion_line(&entry.line)).filter_map(|entry| n_word_of_line(&entry.line));
    let begun = last.max().map_or(0, |last| last as usize + 1);
    let stored = ended.stored.readings.len();
    (stored + 1 < begun || stored > begun).then(|| format!("{begun} steps begun, {stored} readings stored"))
}

/// Finds more than two unanswered lines, or more bytes than the control's buffer holds. Each answer belongs to the
/// oldest unanswered line.
fn find_window_violation(near: &[RecordedLine]) -> Option<String> {
    let mut open = VecDeque::new();
    for entry in near {
        match entry.direction {
            Direction::ToControl if entry.line == "!" => {}
            Direction::ToControl => open.push_back(entry.line.len() + 1),
            // A restarted control has lost its lines.
            Direction::FromControl if entry.line.starts_with(FIRMWARE_BANNER) => open.clear(),
            Direction::FromControl if entry.line == "ok" || entry.line.starts_with("error:") => {
                open.pop_front();
            }
            Direction::FromControl => {}
        }
        let (lines, bytes) = (open.len(), open.iter().sum::<usize>());
        // The very first line only wakes the control: a lost answer to it is not a fault.
        if bytes > RX_BUFFER_BYTES || lines > 2 {
            return Some(format!("{lines} lines, {bytes} bytes are not answered"));
        }
    }
    None
}

fn find_wrong_state(ended: &EndedRun) -> Option<String> {
    let (state, events) = (ended.stored.summary.state, &ended.stored.events);
    let last = events.last().map(|(_, event)| event);
    let all = ended.stored.stages.iter().map(|stage| stage.steps.len()).sum::<usize>();
    let measured = ended.stored.readings.len();
    let fits = match &ended.result {
        // The schedules end with the measurement.
        Ok(()) => state == RunState::NotIdentified && last == Some(&RunEvent::Finished) && measured == all,
        Err(RunError::Controller(ControllerError::Halted)) => {
            state == RunState::Held && matches!(last, Some(RunEvent::Held { .. }))
        }
        Err(error) => {
            let expected = if ended.has_moved { RunState::Held } else { RunState::Failed };
            state == expected
                && matches!(last, Some(RunEvent::Faulted { what, remedy, .. })
                    if *what == error.to_string() && !remedy.is_empty())
        }
    };
    let moved = ended.driver_side_tape.iter().any(|e| e.direction == Direction::ToControl && is_motion_line(&e.line));
    (!fits || moved && !ended.has_moved)
        .then(|| format!("{:?} is told as {state:?}, {last:?}, {measured} of {all}", ended.result))
}

pub fn window_violation_and_report_fault_are_detected() {
    let entry = |way, line: &str| RecordedLine { direction: way, line: line.to_owned() };
    let sent = |line| entry(Direction::ToControl, line);
    let ok = || entry(Direction::FromControl, "ok");
    let lines = [sent("$I"), sent("$G"), ok(), sent("$#"), ok(), sent("G59")];
    assert_eq!(find_window_violation(&lines), None);
    let lines = [sent("$I"), sent("$G"), ok(), sent("$#"), sent("G59")];
    assert!(find_window_violation(&lines).unwrap().starts_with("3 lines"));
    for line in ["<Alarm|", "<Hold:1|", "<Door:0|", "<Tool|", "ALARM:1", "error:9"] {
        assert!(is_fault_line(line), "{line}");
    }
    assert!(!is_fault_line("<Idle|") && !is_fault_line("ok"));
}
