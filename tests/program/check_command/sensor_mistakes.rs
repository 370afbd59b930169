//! Planted mistakes between a displacement sensor and the program.

use std::io;

use link::can::{CanError, CanEvent, CanFrame, CanId};
use trued::commissioning::CheckSummary;

use super::machine_mistakes::PlantedMistake;
use super::simulated_machine_checks::runtime;
use super::test_sensors::{
    BYTE_FRAME_KEYS, MODBUS_MAP_KEYS, RATE_HZ, TEXT_LINE_KEYS, byte_frame, can_frame, check_on_can, check_on_modbus,
    check_on_serial_line, check_thermometer, check_with_silent_port, check_without_sampler, frame_near_zero,
    garbled_at_wrong_baud_rate, machine_file_with_sensor, machine_file_with_thermometer, noisy_distance_counts,
    open_sound_bus, receiver_of_events, receiver_of_frames, run_check_without_operator, sound_frame, text_line,
};

const fn mistake(name: &'static str, check: fn() -> CheckSummary, phrase: &'static str) -> PlantedMistake {
    PlantedMistake { name, run_check: check, expected_phrase: phrase }
}

const COUNTER_LEAPS_TEXT: &str = "increments its sample counter by more than one between most samples";
const SILENT_SENSOR_TEXT: &str = "no data from the sensor within";

/// Each row has words that occur for no other mistake.
pub const SENSOR_MISTAKES: &[PlantedMistake] = &[
    mistake(
        "CAN: another bit rate",
        || check_on_can(&[], || receiver_of_events(vec![CanEvent::BusErrors("bit stuffing error".to_owned())])),
        "no frame 181 was received on `can0`, and the bus has errors: bit stuffing error",
    ),
    mistake(
        "CAN: the controller has given up",
        || check_on_can(&[], || receiver_of_events(vec![CanEvent::BusOff("bus off".to_owned())])),
        "the CAN controller of `can0` is bus-off",
    ),
    mistake(
        "CAN: a kernel without it",
        || {
            let none = || Err(CanError::NoKernelSupport { source: io::Error::other("no such family") });
            check_on_can(&[], none)
        },
        "the kernel of this computer does not support CAN",
    ),
    mistake(
        "CAN: the interface is down",
        || check_on_can(&[], || receiver_of_events(vec![CanEvent::InterfaceDown("Network is down".to_owned())])),
        "the CAN interface `can0` is down",
    ),
    mistake(
        "CAN: another identifier",
        || check_on_can(&[], || receiver_of_events(vec![CanEvent::ForeignId(CanId::new(0x182, false).unwrap())])),
        "no frame 181 was received on `can0`, only frames with other identifiers: 182",
    ),
    mistake("CAN: a sensor that is off", || check_on_can(&[], || receiver_of_events(Vec::new())), SILENT_SENSOR_TEXT),
    mistake(
        "CAN: the bytes the other way",
        || check_on_can(&[("order = \"big\"", "order = \"little\"")], open_sound_bus),
        COUNTER_LEAPS_TEXT,
    ),
    mistake(
        "CAN: a scale too large, near zero",
        || check_on_can(&[("1e-5", "5e-4")], || receiver_of_frames(frame_near_zero)),
        "the machine file states noise_um = 0.5",
    ),
    mistake(
        "CAN: what does not measure",
        || check_on_can(&[], || receiver_of_frames(|number| can_frame(number, RATE_HZ, number, 123_450))),
        "reports exactly the same value in every sample",
    ),
    mistake(
        "CAN: a counter that is none",
        || {
            check_on_can(&[], || {
                receiver_of_frames(|number| can_frame(number, RATE_HZ, 7, noisy_distance_counts(number, 1.2345)))
            })
        },
        "the counter of the received samples never changes",
    ),
    mistake(
        "CAN: a counter of another thing",
        || {
            fn frame_with_tripled_counter(number: u64) -> CanFrame {
                can_frame(number, RATE_HZ, 3 * number, noisy_distance_counts(number, 1.2345))
            }
            check_on_can(&[], || receiver_of_frames(frame_with_tripled_counter))
        },
        COUNTER_LEAPS_TEXT,
    ),
    mistake(
        "CAN: samples that are lost",
        || {
            fn frame_after_losses(number: u64) -> CanFrame {
                sound_frame(number + number / 10)
            }
            check_on_can(&[], || receiver_of_frames(frame_after_losses))
        },
        "loses samples: ",
    ),
    mistake(
        "CAN: half the rate",
        || {
            fn frame_at_half_rate(number: u64) -> CanFrame {
                can_frame(number, 500.0, number, noisy_distance_counts(number, 1.2345))
            }
            check_on_can(&[], || receiver_of_frames(frame_at_half_rate))
        },
        "sends 500 samples/s; the machine file states rate_hz = 1000",
    ),
    mistake(
        "CAN: frames of another length",
        || {
            fn shortened_frame(number: u64) -> CanFrame {
                let whole = sound_frame(number);
                CanFrame::new(whole.received_s, whole.id, &whole.data()[..4])
            }
            check_on_can(&[], || receiver_of_frames(shortened_frame))
        },
        "the frame has 4 bytes, but the layout needs 6",
    ),
    mistake(
        "serial: another baud rate, text",
        || check_on_serial_line(TEXT_LINE_KEYS, |number| garbled_at_wrong_baud_rate(text_line(number))),
        "mostly noise instead of lines of text",
    ),
    mistake(
        "serial: another baud rate, bytes",
        || check_on_serial_line(BYTE_FRAME_KEYS, |number| garbled_at_wrong_baud_rate(byte_frame(number))),
        "no valid frame in the received bytes: `",
    ),
    mistake(
        "serial: text where the number is",
        || check_on_serial_line(TEXT_LINE_KEYS, |number| format!("M0,READY,{:04}\r\n", number % 10_000).into_bytes()),
        "the received lines do not match the layout: `M0,READY",
    ),
    mistake(
        "serial: another line's end",
        || {
            let cut = |number| String::from_utf8(text_line(number)).unwrap().replace("\r\n", "\r");
            check_on_serial_line(TEXT_LINE_KEYS, move |number| cut(number).into_bytes())
        },
        "\\rM0,+01.",
    ),
    mistake(
        "serial: a counter that is none",
        || {
            let stands = |number| text_line(number)[..13].iter().copied().chain(*b"0007\r\n").collect();
            check_on_serial_line(TEXT_LINE_KEYS, stands)
        },
        "the counter of the received samples never changes",
    ),
    mistake(
        "serial: a sensor that is off",
        || check_on_serial_line(TEXT_LINE_KEYS, |_| Vec::new()),
        SILENT_SENSOR_TEXT,
    ),
    mistake(
        "serial: a port that is not there",
        || {
            let at = "[sensor.serial]\nserial = \"/dev/trued-laser\"\n";
            runtime().block_on(run_check_without_operator(&machine_file_with_sensor(&format!("{at}{TEXT_LINE_KEYS}"))))
        },
        "/dev/trued-laser does not exist",
    ),
    mistake(
        "Modbus: another unit",
        || {
            check_with_silent_port(|address| {
                machine_file_with_sensor(&format!("[sensor.modbus]\ntcp = \"{address}\"\nunit = 7\n{MODBUS_MAP_KEYS}"))
            })
        },
        "compare `unit`, baud rate and parity of [sensor.modbus]",
    ),
    mistake(
        "Modbus: registers that it has not",
        || check_on_modbus(&[("register = 2", "register = 40")], 200.0),
        "reading input registers 1 to 41:",
    ),
    mistake(
        "Modbus: holding registers",
        || check_on_modbus(&[("counter", "space = \"holding\"\ncounter")], 200.0),
        "exception 1 (illegal function)",
    ),
    mistake("Modbus: what does not measure", || check_on_modbus(&[], 0.1), "the registers of the sensor never change"),
    mistake("thermometer: another scale", || check_thermometer("1e-3"), "the temperature 2150.0 °C is not plausible"),
    mistake(
        "thermometer: nobody answers",
        || check_with_silent_port(|address| machine_file_with_thermometer(address, "0.1")),
        "for the thermometer: the keys of [thermometer.modbus]",
    ),
    mistake("LinuxCNC: no sampler", check_without_sampler, "the sampler at 127.0.0.1:1 is not reachable"),
];
