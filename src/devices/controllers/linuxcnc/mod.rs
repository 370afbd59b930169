//! Driver of LinuxCNC (2.9) over linuxcncrsh, its text interface on TCP, and a directory that both sides
//! see: one program file per block as input, one result log as output.
//!
//! **Stop.** A halt has a connection of its own: it takes the right to command from the driver's connection
//! and aborts. So it does not wait for an answer (linuxcncrsh takes 0.1 s for each command), and nothing
//! that the driver still sends can move the machine. The machine decelerates at its acceleration and stays;
//! measured on the simulated machine, the abort takes effect within 20 ms. Worst-case travel: 20 ms of the
//! feed, plus feed²/(2·acceleration). The driver, which sends nothing else from then on, repeats the abort
//! on its own connection until the machine is at rest: linuxcncrsh may lose a line that arrives together
//! with another (`program_runner::abort_until_at_rest`).
//!
//! **Properties of LinuxCNC 2.9 that the driver relies on**, all measured:
//! - An acknowledgement does not mean success, and messages overwrite each other. The result is the content of the
//!   log; a program has ended when the log has `END` *and* the state is IDLE.
//! - `set open` holds the file's text of that moment until the next run ends. So `prepare` opens the file
//!   once, by a program that moves nothing; afterwards the file is replaced and run again. After an error
//!   nothing runs until `prepare` has opened the file again.
//! - A probing move that starts in contact does not move and reports a touch at its start.
//! - The axes are the joints: switchable kinematics must be in identity mode. `prepare` reads the mode from
//!   a HAL pin (`kinematics.rs`), because positions do not show it while all rotary axes are at zero; after
//!   every block joints and axes are compared.
//! - #5401 to #5409 hold the tool table's entry of the loaded tool, also with G49; `#<_tool_offset>` is 1
//!   while an offset is active.
//! - `get` is answered from a copy of the task's state. If the task is frozen or killed, the copy stays as
//!   it was, and the answers continue; the motion continues too, to the end of its queue or to a contact.
//!   Only a `set` waits for the task. So the driver requests a sign of life when a program makes no visible
//!   progress.
//! - An emergency stop ends a program without a message, and does not clear the homing.
//! - The end of a killed linuxcncrsh, or of a killed `trued`, stops nothing: the control finishes its
//!   present program part (descent, touch, back-off). A contact stops its probing
//!   moves, and no further part follows.
//! - linuxcncrsh reports positions during motion a few times a second at most, and without a time. Scans in
//!   motion need HAL's `sampler`, which stamps each period of the servo thread (`sampler/`).
//! - `get spindle` and `get spindle_override` without a number crash linuxcncrsh 2.9.

mod config;
mod connection_diagnosis;
mod device_info;
mod driver;
mod fault;
mod files;
#[cfg(test)]
mod fuzz;
mod ini;
mod kinematics;
mod path_check;
mod prepare;
mod program_part_result;
mod program_runner;
mod result_log;
mod rsh;
mod sampler;
mod state;
#[cfg(test)]
mod tests;
mod tool_centre;
mod tool_centre_reading;
#[cfg(test)]
mod tool_centre_tests;
mod work_offset;

pub use config::LinuxCncConfig;
pub use driver::{LinuxCncDriver, LinuxCncSettings};
pub use files::result_log_path;
pub(crate) use ini::IniFile;
pub(crate) use kinematics::identity_switchkins_type;
pub use sampler::SamplerClient;
pub use tool_centre::{ToolCentreCommands, ToolCentreSettings};

pub const CONTROL_KIND: &str = "linuxcnc";
