//! A simulated operator at a terminal who presses Enter at every prompt.

use std::fs::File;
use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Period at which Enter is pressed. Input before a prompt is shown does not answer it.
const ENTER_KEY_PERIOD: Duration = Duration::from_millis(100);

/// Connects standard input of `command` to a terminal at which Enter is pressed periodically, until its last user
/// has closed it.
pub fn confirm_prompts_with_enter(command: &mut Command) -> &mut Command {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY;
    let keyboard = openpt(flags).expect("a pseudo-terminal");
    grantpt(&keyboard).expect("granted");
    unlockpt(&keyboard).expect("unlocked");
    let name = ptsname(&keyboard, Vec::new()).expect("its name");
    let flags = OFlags::RDWR | OFlags::NOCTTY;
    let terminal = rustix::fs::open(name, flags, Mode::empty()).expect("its other end");
    let mut keyboard = File::from(keyboard);
    std::thread::spawn(move || {
        while keyboard.write_all(b"\n").is_ok() {
            std::thread::sleep(ENTER_KEY_PERIOD);
        }
    });
    command.stdin(Stdio::from(terminal))
}
