//! LinuxCNC (2.9) over linuxcncrsh, its text interface on TCP, and a directory that both sides see:
//! one program file a block goes in, one result log comes out.
//!
//! **Stop.** A halt goes over a connection of its own: it takes the right to command away from the
//! driver's connection and aborts. So it does not wait behind an answer (linuxcncrsh takes 0.1 s for
//! each command), and nothing that the driver still sends can move the machine. The machine
//! decelerates at its acceleration and stays; measured on the simulated machine, the abort acts
//! within 20 ms. Worst-case travel: 20 ms of the feed, plus feed²/(2·acceleration). The driver, which
//! sends nothing else from then on, aborts once more on its own connection, until it sees the machine at
//! rest: linuxcncrsh may lose a line that comes beside another (`watch::stop`).
//!
//! **What it relies on**, all measured against LinuxCNC 2.9:
//! - An acknowledgement is not success; messages overwrite each other. A result is what stands in the
//!   log; the end is `END` in the log *and* the state IDLE.
//! - `set open` holds the file's text of that moment until the next run ends. So the file is opened
//!   once, in `prepare`, by a program that moves nothing; afterwards the file is replaced and run
//!   again. After an error nothing runs until `prepare` has done so anew.
//! - A probe move that starts in contact does not move and reports a touch where it stands.
//! - The axes are the joints: kinematics that can be switched must be in identity mode. `prepare` reads
//!   the mode from a HAL pin (`kinematics.rs`), as it does not show while all rotary axes are at zero;
//!   after every block joints and axes are compared.
//! - #5401 to #5409 hold the tool table's entry of the loaded tool, also with G49; `#<_tool_offset>` is 1
//!   while an offset is active.
//! - `get` is answered from a copy of the task's state. Of a frozen or killed task the copy stays as it
//!   was, and the answers go on; motion goes on too, up to the end of what it has or to a contact. Only
//!   a `set` waits for the task. So a program that seems to stand still is asked for a sign of life.
//! - An emergency stop ends a program without a message, and without losing the homing.
//! - A killed linuxcncrsh, or a killed `trued`, stops nothing: the control finishes the program part it
//!   has (descent, touch, back-off). It is a part of one touch, which guards itself; nothing follows it.
//! - Where the axes stand while they move it tells a few times a second at most, and at no known time.
//!   Scans in motion need HAL's `sampler`, which stamps each period of the servo thread (`sampler/`).
//! - `get spindle` and `get spindle_override` without a number crash linuxcncrsh 2.9.

mod config;
mod diagnose;
mod driver;
mod fault;
mod files;
#[cfg(test)]
mod fuzz;
mod ini;
mod introduce;
mod kinematics;
mod not_ready;
mod prepare;
mod result;
mod rsh;
mod sampler;
mod state;
#[cfg(test)]
mod tests;
mod watch;
mod way;

pub use config::Config;
pub use driver::{LinuxCnc, Settings};
pub use files::log_name;
pub use sampler::Sampler;

pub const KIND: &str = "linuxcnc";
