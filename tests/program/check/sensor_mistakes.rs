//! Planted mistakes between a displacement sensor and the program.

use std::io;

use link::can::{CanError, CanEvent, CanFrame, CanId};
use trued::commissioning::Summary;

use super::bench::runtime;
use super::mistakes::Mistake;
use super::sensors::{
    BYTES, LINE, MAP, RATE_HZ, at_a_thermometer, bytes, counts, file, frame, frames, hearing, line, looked_at,
    near_frame, on_a_line, on_can, on_modbus, sound, sound_frame, too_fast, with_a_deaf_port, with_thermometer,
    without_sampler,
};

const fn row(name: &'static str, check: fn() -> Summary, phrase: &'static str) -> Mistake {
    Mistake { name, check, phrase }
}

const LEAPS: &str = "increments its sample counter by more than one between most samples";
const SILENT: &str = "no data from the sensor within";

/// Each row has words that occur for no other mistake.
pub const MISTAKES: &[Mistake] = &[
    row(
        "CAN: another bit rate",
        || on_can(&[], || hearing(vec![CanEvent::BusErrors("bit stuffing error".to_owned())])),
        "no frame 181 was received on `can0`, and the bus has errors: bit stuffing error",
    ),
    row(
        "CAN: the controller has given up",
        || on_can(&[], || hearing(vec![CanEvent::BusOff("bus off".to_owned())])),
        "the CAN controller of `can0` is bus-off",
    ),
    row(
        "CAN: a kernel without it",
        || {
            let none = || Err(CanError::NoKernelSupport { source: io::Error::other("no such family") });
            on_can(&[], none)
        },
        "the kernel of this computer does not support CAN",
    ),
    row(
        "CAN: the interface is down",
        || on_can(&[], || hearing(vec![CanEvent::Down("Network is down".to_owned())])),
        "the CAN interface `can0` is down",
    ),
    row(
        "CAN: another identifier",
        || on_can(&[], || hearing(vec![CanEvent::ForeignId(CanId::new(0x182, false).unwrap())])),
        "no frame 181 was received on `can0`, only frames with other identifiers: 182",
    ),
    row("CAN: a sensor that is off", || on_can(&[], || hearing(Vec::new())), SILENT),
    row("CAN: the bytes the other way", || on_can(&[("order = \"big\"", "order = \"little\"")], sound), LEAPS),
    row(
        "CAN: a scale too large, near zero",
        || on_can(&[("1e-5", "5e-4")], || frames(near_frame)),
        "the machine file states noise_um = 0.5",
    ),
    row(
        "CAN: what does not measure",
        || on_can(&[], || frames(|number| frame(number, RATE_HZ, number, 123_450))),
        "reports exactly the same value in every sample",
    ),
    row(
        "CAN: a counter that is none",
        || on_can(&[], || frames(|number| frame(number, RATE_HZ, 7, counts(number, 1.2345)))),
        "the counter of the received samples never changes",
    ),
    row(
        "CAN: a counter of another thing",
        || {
            fn of_thirds(number: u64) -> CanFrame {
                frame(number, RATE_HZ, 3 * number, counts(number, 1.2345))
            }
            on_can(&[], || frames(of_thirds))
        },
        LEAPS,
    ),
    row(
        "CAN: samples that are lost",
        || {
            fn lossy(number: u64) -> CanFrame {
                sound_frame(number + number / 10)
            }
            on_can(&[], || frames(lossy))
        },
        "loses samples: ",
    ),
    row(
        "CAN: half the rate",
        || {
            fn slow(number: u64) -> CanFrame {
                frame(number, 500.0, number, counts(number, 1.2345))
            }
            on_can(&[], || frames(slow))
        },
        "sends 500 samples/s; the machine file states rate_hz = 1000",
    ),
    row(
        "CAN: frames of another length",
        || {
            fn short(number: u64) -> CanFrame {
                let whole = sound_frame(number);
                CanFrame::new(whole.t_s, whole.id, &whole.data()[..4])
            }
            on_can(&[], || frames(short))
        },
        "the frame has 4 bytes, but the layout needs 6",
    ),
    row(
        "serial: another baud rate, text",
        || on_a_line(LINE, |number| too_fast(line(number))),
        "mostly noise instead of lines of text",
    ),
    row(
        "serial: another baud rate, bytes",
        || on_a_line(BYTES, |number| too_fast(bytes(number))),
        "no valid frame in the received bytes: `",
    ),
    row(
        "serial: text where the number is",
        || on_a_line(LINE, |number| format!("M0,READY,{:04}\r\n", number % 10_000).into_bytes()),
        "the received lines do not match the layout: `M0,READY",
    ),
    row(
        "serial: another line's end",
        || {
            let cut = |number| String::from_utf8(line(number)).unwrap().replace("\r\n", "\r");
            on_a_line(LINE, move |number| cut(number).into_bytes())
        },
        "\\rM0,+01.",
    ),
    row(
        "serial: a counter that is none",
        || {
            let stands = |number| line(number)[..13].iter().copied().chain(*b"0007\r\n").collect();
            on_a_line(LINE, stands)
        },
        "the counter of the received samples never changes",
    ),
    row("serial: a sensor that is off", || on_a_line(LINE, |_| Vec::new()), SILENT),
    row(
        "serial: a port that is not there",
        || {
            let at = "[sensor.serial]\nserial = \"/dev/trued-laser\"\n";
            runtime().block_on(looked_at(&file(&format!("{at}{LINE}"))))
        },
        "/dev/trued-laser does not exist",
    ),
    row(
        "Modbus: another unit",
        || with_a_deaf_port(|address| file(&format!("[sensor.modbus]\ntcp = \"{address}\"\nunit = 7\n{MAP}"))),
        "compare `unit`, baud rate and parity of [sensor.modbus]",
    ),
    row(
        "Modbus: registers that it has not",
        || on_modbus(&[("register = 2", "register = 40")], 200.0),
        "reading input registers 1 to 41:",
    ),
    row(
        "Modbus: holding registers",
        || on_modbus(&[("counter", "space = \"holding\"\ncounter")], 200.0),
        "exception 1 (illegal function)",
    ),
    row("Modbus: what does not measure", || on_modbus(&[], 0.1), "the registers of the sensor never change"),
    row("thermometer: another scale", || at_a_thermometer("1e-3"), "the temperature 2150.0 °C is not plausible"),
    row(
        "thermometer: nobody answers",
        || with_a_deaf_port(|address| with_thermometer(address, "0.1")),
        "for the thermometer: the keys of [thermometer.modbus]",
    ),
    row("LinuxCNC: no sampler", without_sampler, "the sampler at 127.0.0.1:1 is not reachable"),
];
