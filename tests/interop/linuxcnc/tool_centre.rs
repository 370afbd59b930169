//! The tool centre as LinuxCNC's kinematics compute it.

use devices::controllers::ControllerDriver as _;
use devices::controllers::linuxcnc::{ToolCentreCommands, ToolCentreSettings};
use libtest_mimic::Failed;
use machine::Axis;
use machine::record::tool_centre::ToolCentreReading;

use super::driver::{block_on, open_driver};
use super::rig::{LinuxCncRig, halcmd, lock_rig};

/// Positions of the axes in the kinematics, mm.
const PINS: [(&str, &str); 4] = [
    ("xyzbc-trt-kins.x-rot-point", "0.3"),
    ("xyzbc-trt-kins.y-rot-point", "-0.2"),
    ("xyzbc-trt-kins.x-offset", "0.15"),
    ("xyzbc-trt-kins.z-offset", "20.0"),
];
const STYLUS_LENGTH_MM: f64 = 40.0;

/// X, Y, Z of the control with tool centre point control, as linuxcncrsh reports them.
fn reported_tool_centre(rig: &LinuxCncRig) -> Result<Vec<f64>, Failed> {
    let mut person = rig.connect_client()?;
    person.run_mdi("M68 E3 Q1")?;
    rig.wait_for_rest()?;
    let reported = person.send_line("get abs_act_pos")?;
    person.run_mdi("M68 E3 Q0")?;
    rig.wait_for_rest()?;
    Ok(reported.split_whitespace().skip(1).take(3).map(str::parse).collect::<Result<_, _>>()?)
}

fn read_tool_centre(rig: &LinuxCncRig, commands: &str) -> Result<Option<ToolCentreReading>, Failed> {
    let commands: ToolCentreCommands = serde_json::from_str(commands)?;
    block_on(async {
        let (driver, _halt) = open_driver(rig).await?;
        let settings = ToolCentreSettings { commands, stylus_length_mm: STYLUS_LENGTH_MM };
        let mut driver = driver.with_tool_centre(Some(settings));
        driver.prepare().await?;
        Ok(driver.read_tool_centre().await?)
    })
}

/// With the rotary axes at zero, positions do not show that the kinematics stay on.
fn check_exchanged_commands_are_refused(rig: &LinuxCncRig) -> Result<(), Failed> {
    let read = read_tool_centre(rig, r#"{"on": "M68 E3 Q0", "off": "M68 E3 Q1"}"#);
    rig.connect_client()?.run_mdi("M68 E3 Q0")?;
    let message = read.err().ok_or("exchanged commands were accepted")?;
    match message.message().is_some_and(|text| text.contains("motion.switchkins-type was 0, then 0, then 1")) {
        true => Ok(()),
        false => Err(message),
    }
}

/// Nothing moves, and the kinematics are in identity mode again.
pub fn tool_centre_is_read_from_the_kinematics() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let zeros = PINS.map(|(pin, _)| (pin, "0"));
    let set = |pins: &[(&str, &str)]| pins.iter().try_for_each(|(pin, mm)| halcmd(&["setp", pin, mm]).map(drop));
    set(&PINS)?;
    let read = rig.with_kinematics_switch(|| {
        check_exchanged_commands_are_refused(&rig)?;
        rig.connect_client()?.run_mdi("G53 G0 X60 Y-30 Z150 B25 C40")?;
        let joints = rig.wait_for_rest()?;
        let reading = read_tool_centre(&rig, r#"{"on": "M68 E3 Q1", "off": "M68 E3 Q0"}"#)?;
        if rig.wait_for_rest()? != joints {
            return Err("the machine has moved".into());
        }
        Ok((reading.ok_or("nothing is read")?, reported_tool_centre(&rig)?))
    });
    set(&zeros)?;
    let (reading, reported) = read?;
    let [x, y, z] = <[f64; 3]>::try_from(reported).map_err(|_| "three coordinates")?;
    let expected = [x, y, z - STYLUS_LENGTH_MM];
    let is_equal = reading.tool_centre_mm.iter().zip(expected).all(|(own, other)| (own - other).abs() < 2e-6);
    // Far from the position of the machine, and with the rotary axes as commanded.
    let is_compensated =
        (x - 60.0).abs() > 10.0 && (reading.position.get_or_zero(Axis::B) - 25_f64.to_radians()).abs() < 1e-9;
    if is_equal && is_compensated && reading.position.get(Axis::X) == Some(60.0) {
        return Ok(());
    }
    Err(format!("{reading:?} instead of {expected:?}").into())
}
