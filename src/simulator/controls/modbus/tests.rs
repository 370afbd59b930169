//! Tests the simulated control alone, register by register.

use std::borrow::Cow;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::json;
use tokio_modbus::{ExceptionCode, Request, Response};

use super::{ControlEvent, Firmware, OperatingState, SimulatedModbusOptions};
use crate::interpreter::SimulationPace;
use crate::{MachineTruth, SimulatedWorld};
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};

fn firmware_with(pace: SimulationPace, has_resident_program: bool) -> Firmware {
    let limits = json!({"min": -400, "max": 400});
    let machine: Machine = serde_json::from_value(json!({
        "name": "bench", "topology": "w-C-B-X-F-Z-Y-S-t",
        "axes": {"X": limits, "Y": limits, "Z": limits, "B": limits, "C": limits}
    }))
    .unwrap();
    let probe: Probe = serde_json::from_value(json!({"ball_radius_mm": 3})).unwrap();
    let artefact: Artefact = serde_json::from_value(json!({
        "kind": "cylinder", "centre_mm": [0, 0, -200], "axis": [0, 0, 1], "radius_mm": 25
    }))
    .unwrap();
    let world = SimulatedWorld::new(&machine, &probe, &artefact, &MachineTruth::default()).unwrap();
    let options =
        SimulatedModbusOptions { has_resident_program, ..SimulatedModbusOptions::for_machine(&machine, pace) };
    Firmware::new(Arc::new(Mutex::new(world)), options)
}

fn firmware(pace: SimulationPace) -> Firmware {
    firmware_with(pace, false)
}

fn send_request(firmware: &mut Firmware, request: &Request<'_>, ms: u64) -> Result<Response, ExceptionCode> {
    firmware.handle_request(request, Duration::from_millis(ms)).answer.unwrap()
}

fn write(firmware: &mut Firmware, at: u16, words: &[u16], ms: u64) {
    send_request(firmware, &Request::WriteMultipleRegisters(at, Cow::Borrowed(words)), ms).unwrap();
}

fn line_status_registers(firmware: &mut Firmware, ms: u64) -> Vec<u16> {
    match send_request(firmware, &Request::ReadInputRegisters(0, 45), ms).unwrap() {
        Response::ReadInputRegisters(words) => words,
        other => panic!("{other:?}"),
    }
}

/// `G53 G0 X5`.
const RAPID_TEXT: [u16; 5] = [0x4735, 0x3320, 0x4730, 0x2058, 0x3500];

/// Checksums of `RAPID_TEXT` and of `G53 G1 X50 F60`, as computed by another program.
const RAPID_TEXT_CRC: u16 = 0x599B;
const SLOW_MOVE_CRC: u16 = 0x75C7;

fn rapid_chunk_registers(beat: u16, acknowledge: u16) -> Vec<u16> {
    [&[beat, acknowledge, RAPID_TEXT_CRC, 9], &RAPID_TEXT[..]].concat()
}

#[test]
fn chunk_is_accepted_once_with_the_next_sequence_number() {
    let mut control = firmware(SimulationPace::Immediate);
    write(&mut control, 2, &rapid_chunk_registers(1, 0), 10);
    // A written chunk is not started before its sequence is written.
    assert_eq!(line_status_registers(&mut control, 11)[2..6], [1, 0, 0, 0]);
    for sequence in [2, 1, 1, 0, 3] {
        write(&mut control, 1, &[sequence], 12);
    }
    assert_eq!(line_status_registers(&mut control, 13)[2..7], [1, 0, 1, 1, 0]);
    let took = |entry: &&ControlEvent| matches!(entry, ControlEvent::ChunkAccepted { .. });
    assert_eq!(control.event_log().lock().unwrap().iter().filter(took).count(), 1);
    // X in steps of 0.001 mm.
    assert_eq!(line_status_registers(&mut control, 14)[32..34], [0, 5000]);
}

#[test]
fn unsuitable_chunk_is_refused_without_motion() {
    for (place, value, error) in [(2, 1, 2), (3, 300, 1), (3, 0, 1), (3, 8, 2), (1, 7, 4)] {
        let mut control = firmware(SimulationPace::Immediate);
        let mut words = rapid_chunk_registers(1, 0);
        words[place] = value;
        write(&mut control, 2, &words, 10);
        write(&mut control, 1, &[1], 11);
        assert_eq!(line_status_registers(&mut control, 12)[2..7], [1, 0, 1, 0, error]);
        assert_eq!(control.executor.displayed_position().get_or_zero(machine::Axis::X), 0.0);
    }
    let mut control = firmware(SimulationPace::Immediate);
    write(&mut control, 2, &rapid_chunk_registers(1, 0), 10);
    write(&mut control, 1, &[1], 3000);
    let registers = line_status_registers(&mut control, 3001);
    assert_eq!(registers[4..7], [1, 0, 5], "the command is refused: its heartbeat is too old");
}

#[test]
fn stopped_heartbeat_or_hold_stops_a_move() {
    for (hold_ms, reason) in [(None, 64), (Some(50), 0)] {
        let mut control = firmware(SimulationPace::RealTime);
        let mut words = rapid_chunk_registers(1, 0);
        // 5 mm at rapid speed end soon; `G53 G1 X50 F60` takes 50 s.
        let text = b"G53 G1 X50 F60";
        words.splice(2.., [SLOW_MOVE_CRC, 14]);
        words.extend(text.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])));
        write(&mut control, 2, &words, 10);
        write(&mut control, 1, &[1], 11);
        assert_eq!(line_status_registers(&mut control, 40)[2], 2);
        if let Some(ms) = hold_ms {
            write(&mut control, 0, &[1], ms);
        }
        assert_eq!(line_status_registers(&mut control, 9000)[2..6], [3, reason, 1, 0]);
        let x = control.executor.displayed_position().get_or_zero(machine::Axis::X);
        // The machine moves at 1 mm/s until then.
        let until_s = hold_ms.map_or(2.010, |ms| ms as f64 * 1e-3) - 0.011;
        assert!((x - until_s).abs() < 0.01, "{x}");
        assert!(matches!(control.operating_state, OperatingState::Held(_)));
    }
}

#[test]
fn address_outside_the_window_gives_an_exception() {
    let mut control = firmware(SimulationPace::Immediate);
    let send_request = |control: &mut Firmware, request| send_request(control, &request, 1).unwrap_err();
    let address = ExceptionCode::IllegalDataAddress;
    assert_eq!(send_request(&mut control, Request::ReadInputRegisters(40, 6)), address);
    assert_eq!(send_request(&mut control, Request::WriteSingleRegister(106, 1)), address);
    assert_eq!(send_request(&mut control, Request::ReadCoils(0, 1)), ExceptionCode::IllegalFunction);
}

/// One rapid of X to 5 mm, as step 7 of program 1, bound to sequence 1; written by hand.
const ONE_RAPID_TABLE: [u16; 24] = [1, 1, 0, 0, 7, 0, 1, 0, 1, 1, 0, 0, 0, 50_000, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
/// Checksum of the table, as computed by another program.
const ONE_RAPID_TABLE_CRC: u16 = 0x9A0A;

fn offer_table(control: &mut Firmware, table: &[u16], crc: u16, ms: u64) {
    let words = [&[1, 0, crc, 2 * table.len() as u16], table].concat();
    write(control, 2, &words, ms);
    write(control, 1, &[1], ms + 1);
}

fn program_status_registers(control: &mut Firmware, ms: u64) -> Vec<u16> {
    match send_request(control, &Request::ReadInputRegisters(0, 50), ms).unwrap() {
        Response::ReadInputRegisters(words) => words,
        other => panic!("{other:?}"),
    }
}

#[test]
fn table_starts_once_and_reports_its_row() {
    let mut control = firmware_with(SimulationPace::Immediate, true);
    offer_table(&mut control, &ONE_RAPID_TABLE, ONE_RAPID_TABLE_CRC, 10);
    let status = program_status_registers(&mut control, 11);
    assert_eq!((&status[1..7], status[44]), (&[101, 2, 0, 1, 0, 0][..], 1));
    write(&mut control, 1, &[1], 12);
    let status = program_status_registers(&mut control, 20);
    assert_eq!((&status[2..7], &status[44..49]), (&[1, 0, 1, 1, 0][..], &[0; 5][..]));
    assert_eq!(status[32..34], [0, 5000]);
    let diary = control.event_log();
    let took = |entry: &&ControlEvent| matches!(entry, ControlEvent::ChunkAccepted { .. });
    assert_eq!(diary.lock().unwrap().iter().filter(took).count(), 1);
}

#[test]
fn incomplete_or_invalid_table_causes_no_motion() {
    for (place, value, crc, error) in [
        (13, 50_001, ONE_RAPID_TABLE_CRC, 2),
        (0, 2, ONE_RAPID_TABLE_CRC, 2),
        (0, 2, 0x2EBE, 3),
        (1, 2, 0x6BB9, 7),
        (2, 2, 0x198E, 8),
        (5, 1, 0x0A16, 3),
        (6, 2, 0x9A7D, 1),
        (8, 9, 0x5E8B, 3),
        (8, 2, 0x9BBA, 3),
        (9, 64, 0xEBCA, 3),
    ] {
        let mut control = firmware_with(SimulationPace::Immediate, true);
        let mut table = ONE_RAPID_TABLE;
        table[place] = value;
        offer_table(&mut control, &table, crc, 10);
        let status = program_status_registers(&mut control, 20);
        assert_eq!(status[2..7], [1, 0, 1, 0, error], "{place}");
        assert_eq!(control.executor.displayed_position().get_or_zero(machine::Axis::X), 0.0);
    }
    // A target beyond the travel.
    let mut table = ONE_RAPID_TABLE;
    table[12..14].copy_from_slice(&[0x7A, 0x1200]);
    let mut control = firmware_with(SimulationPace::Immediate, true);
    offer_table(&mut control, &table, 0xABC6, 10);
    assert_eq!(program_status_registers(&mut control, 20)[2..7], [1, 0, 1, 0, 3]);
    // The right tool.
    table = ONE_RAPID_TABLE;
    table[2] = 1;
    let mut control = firmware_with(SimulationPace::Immediate, true);
    offer_table(&mut control, &table, 0xDBC8, 10);
    assert_eq!(program_status_registers(&mut control, 20)[2..7], [1, 0, 1, 1, 0]);
}
