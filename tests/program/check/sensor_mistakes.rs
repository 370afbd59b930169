//! Planted mistakes between a displacement sensor and the program.

use std::io;

use link::can::{CanError, CanEvent, Frame, Id};
use trued::commissioning::Summary;

use super::bench::runtime;
use super::mistakes::Mistake;
use super::sensors::{
    BYTES, LINE, MAP, RATE_HZ, at_a_thermometer, bytes, counts, file, frame, frames, hearing, line,
    looked_at, near_frame, on_a_line, on_can, on_modbus, sound, sound_frame, too_fast,
    with_a_deaf_port, with_thermometer, without_sampler,
};

const fn row(name: &'static str, check: fn() -> Summary, phrase: &'static str) -> Mistake {
    Mistake { name, check, phrase }
}

const LEAPS: &str = "counts on by more than one from most samples to the next";
const SILENT: &str = "nothing came from the sensor within";

/// Each row has words that occur for no other mistake.
pub const MISTAKES: &[Mistake] = &[
    row(
        "CAN: another bit rate",
        || {
            on_can(&[], || {
                hearing(vec![CanEvent::ErrorFrameClass("bit stuffing error".to_owned())])
            })
        },
        "no frame 181 came on `can0`, and the bus has errors: bit stuffing error",
    ),
    row(
        "CAN: the controller has given up",
        || on_can(&[], || hearing(vec![CanEvent::Off("bus off".to_owned())])),
        "the CAN controller of `can0` has left the bus",
    ),
    row(
        "CAN: a kernel without it",
        || {
            let none = || Err(CanError::NoKernel { source: io::Error::other("no such family") });
            on_can(&[], none)
        },
        "this computer's kernel has no CAN",
    ),
    row(
        "CAN: the interface is down",
        || on_can(&[], || hearing(vec![CanEvent::Down("Network is down".to_owned())])),
        "the CAN interface `can0` is down",
    ),
    row(
        "CAN: another identifier",
        || on_can(&[], || hearing(vec![CanEvent::Other(Id::new(0x182, false).unwrap())])),
        "no frame 181 came on `can0`, but those of others did: 182",
    ),
    row("CAN: a sensor that is off", || on_can(&[], || hearing(Vec::new())), SILENT),
    row(
        "CAN: the bytes the other way",
        || on_can(&[("order = \"big\"", "order = \"little\"")], sound),
        LEAPS,
    ),
    row(
        "CAN: a scale too large, near zero",
        || on_can(&[("1e-5", "5e-4")], || frames(near_frame)),
        "where noise_um says 0.5 µm",
    ),
    row(
        "CAN: what does not measure",
        || on_can(&[], || frames(|number| frame(number, RATE_HZ, number, 123_450))),
        "says the same to the last digit all the time",
    ),
    row(
        "CAN: a counter that is none",
        || on_can(&[], || frames(|number| frame(number, RATE_HZ, 7, counts(number, 1.2345)))),
        "samples come, but their counter always says the same",
    ),
    row(
        "CAN: a counter of another thing",
        || {
            fn of_thirds(number: u64) -> Frame {
                frame(number, RATE_HZ, 3 * number, counts(number, 1.2345))
            }
            on_can(&[], || frames(of_thirds))
        },
        LEAPS,
    ),
    row(
        "CAN: samples that are lost",
        || {
            fn lossy(number: u64) -> Frame {
                sound_frame(number + number / 10)
            }
            on_can(&[], || frames(lossy))
        },
        "loses samples: ",
    ),
    row(
        "CAN: half the rate",
        || {
            fn slow(number: u64) -> Frame {
                frame(number, 500.0, number, counts(number, 1.2345))
            }
            on_can(&[], || frames(slow))
        },
        "gives 500 samples a second, where rate_hz says 1000",
    ),
    row(
        "CAN: frames of another length",
        || {
            fn short(number: u64) -> Frame {
                let whole = sound_frame(number);
                Frame::new(whole.t_s, whole.id, &whole.data()[..4])
            }
            on_can(&[], || frames(short))
        },
        "a frame of 4 bytes came where the layout needs 6",
    ),
    row(
        "serial: another baud rate, text",
        || on_a_line(LINE, |number| too_fast(line(number))),
        "mostly noise comes where lines should",
    ),
    row(
        "serial: another baud rate, bytes",
        || on_a_line(BYTES, |number| too_fast(bytes(number))),
        "no frames in `",
    ),
    row(
        "serial: text where the number is",
        || on_a_line(LINE, |number| format!("M0,READY,{:04}\r\n", number % 10_000).into_bytes()),
        "lines come as `M0,READY",
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
        "samples come, but their counter always says the same",
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
        || {
            with_a_deaf_port(|address| {
                file(&format!("[sensor.modbus]\ntcp = \"{address}\"\nunit = 7\n{MAP}"))
            })
        },
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
    row("Modbus: what does not measure", || on_modbus(&[], 0.1), "its registers stand"),
    row(
        "thermometer: another scale",
        || at_a_thermometer("1e-3"),
        "it says 2150.0 °C, which no place of a machine has",
    ),
    row(
        "thermometer: nobody answers",
        || with_a_deaf_port(|address| with_thermometer(address, "0.1")),
        "of the thermometer it stands in [thermometer.modbus]",
    ),
    row("LinuxCNC: no sampler", without_sampler, "the sampler at 127.0.0.1:1 is not there"),
];
