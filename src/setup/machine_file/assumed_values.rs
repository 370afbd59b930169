//! Values that are assumed where the file does not state them (docs/uncertainty.md gives the reasons): an
//! undeclared source of uncertainty still exists in the machine.

use super::document::TomlDocument;
use super::error::MachineFileError;
use machine::Axis;
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};

/// Error motion of a linear axis along each of X, Y and Z: positioning and straightness.
const ASSUMED_LINEAR_AXIS_ERROR_MOTION_STD_U_UM: f64 = 1.0;
/// Angular error motion of a linear axis: roll, pitch and yaw, each.
const ASSUMED_LINEAR_AXIS_ANGULAR_ERROR_MOTION_STD_U_URAD: f64 = 5.0;
/// Error motion of a rotary axis along each of X, Y and Z.
const ASSUMED_ROTARY_AXIS_ERROR_MOTION_STD_U_UM: f64 = 0.5;
/// Lost motion at a reversal of a linear axis that remains after the control's compensation.
const ASSUMED_BACKLASH_STD_U_UM: f64 = 1.0;
/// Step of the displayed position of a linear axis; not a standard uncertainty.
const ASSUMED_RESOLUTION_UM: f64 = 1.0;
/// Direction-dependent pre-travel of the probe.
const ASSUMED_LOBING_STD_U_UM: f64 = 0.5;
/// Stated stylus offset in each of X and Y.
const ASSUMED_STYLUS_OFFSET_STD_U_UM: f64 = 0.8;
/// Rate of the thermal drift between table and spindle in each of X, Y and Z.
const ASSUMED_DRIFT_STD_U_UM_PER_H: f64 = 5.0;
/// Squareness error between each two of X, Y and Z.
const ASSUMED_SQUARENESS_STD_U_URAD: f64 = 10.0;
/// Standard uncertainty of the temperature of a certified length, or of certified ball centres, without a stated
/// temperature, which is then taken as 20 °C.
const ASSUMED_TEMPERATURE_STD_U_K: f64 = 2.0;
/// Coefficient of thermal expansion (steel) of a certified length, or of the base of certified balls, without a
/// stated temperature, if the file does not state the coefficient.
const ASSUMED_EXPANSION_UM_PER_M_K: f64 = 11.5;

/// Fills in the values of `[machine]`, `[axes]` and `[probe]` that have an assumed value and are not stated; a stated 0
/// is kept. Returns the keys of the assumed values, e.g. `axes.X.backlash_um`.
///
/// # Errors
/// The text cannot be read.
pub fn fill_assumed_values(
    document: &TomlDocument,
    machine: &mut Machine,
    probe: &mut Probe,
) -> Result<Vec<String>, MachineFileError> {
    let mut assumed = Vec::new();
    let mut fill = |path: &[&str], value: &mut f64, size: f64| {
        let is_stated = document.read_section(path, |_| Ok(()))?.is_some();
        if !is_stated {
            *value = size;
            assumed.push(path.join("."));
        }
        Ok(())
    };
    fill(&["machine", "drift_um_per_h"], &mut machine.drift_um_per_h, ASSUMED_DRIFT_STD_U_UM_PER_H)?;
    fill(&["machine", "squareness_urad"], &mut machine.squareness_urad, ASSUMED_SQUARENESS_STD_U_URAD)?;
    for (axis, spec) in &mut machine.axes {
        let name = axis.to_string();
        let key = |key| ["axes", name.as_str(), key];
        if axis.is_linear() {
            fill(&key("resolution_um"), &mut spec.resolution_um, ASSUMED_RESOLUTION_UM)?;
            fill(&key("error_motion_um"), &mut spec.error_motion_um, ASSUMED_LINEAR_AXIS_ERROR_MOTION_STD_U_UM)?;
            fill(
                &key("angular_motion_urad"),
                &mut spec.angular_motion_urad,
                ASSUMED_LINEAR_AXIS_ANGULAR_ERROR_MOTION_STD_U_URAD,
            )?;
            fill(&key("backlash_um"), &mut spec.backlash_um, ASSUMED_BACKLASH_STD_U_UM)?;
        } else if *axis != Axis::S {
            fill(&key("error_motion_um"), &mut spec.error_motion_um, ASSUMED_ROTARY_AXIS_ERROR_MOTION_STD_U_UM)?;
        }
    }
    fill(&["probe", "lobing_um"], &mut probe.lobing_um, ASSUMED_LOBING_STD_U_UM)?;
    fill(&["probe", "stylus_offset_um"], &mut probe.u_stylus_offset_um, ASSUMED_STYLUS_OFFSET_STD_U_UM)?;
    Ok(assumed)
}

/// Fills in the temperature uncertainty and the expansion of certified lengths and centres of `artefact` without a
/// stated temperature; for a length, 0 counts as not stated. Appends the keys to `assumed_keys`.
pub fn fill_assumed_thermal_values(artefact: &mut Artefact, assumed_keys: &mut Vec<String>) {
    let Artefact::Balls(balls) = artefact else { return };
    if balls.certificate_u_mm.is_some() && balls.temperature_c.is_none() {
        let mut fill = |key: &str, value: &mut Option<f64>, size: f64| {
            if value.is_none() {
                *value = Some(size);
                assumed_keys.push(format!("artefact.{key}"));
            }
        };
        fill("u_temperature_k", &mut balls.u_temperature_k, ASSUMED_TEMPERATURE_STD_U_K);
        fill("expansion_um_per_m_k", &mut balls.expansion_um_per_m_k, ASSUMED_EXPANSION_UM_PER_M_K);
    }
    for length in balls.lengths.iter_mut().filter(|length| length.temperature_c.is_none()) {
        let mut fill = |key: &str, value: &mut f64, size: f64| {
            if *value == 0.0 {
                *value = size;
                assumed_keys.push(format!("artefact.lengths.{key}"));
            }
        };
        fill("u_temperature_k", &mut length.u_temperature_k, ASSUMED_TEMPERATURE_STD_U_K);
        fill("expansion_um_per_m_k", &mut length.expansion_um_per_m_k, ASSUMED_EXPANSION_UM_PER_M_K);
    }
    assumed_keys.dedup();
}

#[cfg(test)]
mod tests {
    use crate::setup::machine_file::MachineFile;
    use machine::Axis;
    use machine::record::artefact::Artefact;

    const SIMULATED_MACHINE_TOML: &str = include_str!("../../../config/simulated.toml");
    const UNCERTAINTY_DOCS: &str = include_str!("../../../docs/uncertainty.md");

    /// Value in the documentation for a key, e.g. `[axes.X] backlash_um`.
    fn documented_value(key: &str) -> f64 {
        let row = UNCERTAINTY_DOCS.lines().find(|line| line.starts_with(&format!("| `{key}` |"))).unwrap();
        let size = row.split('|').nth(2).unwrap().trim();
        size.split(' ').next().unwrap().parse().unwrap()
    }

    #[test]
    fn assumed_values_equal_the_docs_and_their_keys_are_listed() {
        let keys =
            ["error_motion_um", "angular_motion_urad", "backlash_um", "resolution_um", "lobing_um", "drift_um_per_h"];
        let is_taken_out = |line: &&str| !keys.iter().any(|key| line.starts_with(key));
        let text: String =
            SIMULATED_MACHINE_TOML.lines().filter(is_taken_out).map(|line| format!("{line}\n")).collect();
        let file = MachineFile::parse("shop.toml", text).unwrap();
        let [x, c] = [Axis::X, Axis::C].map(|axis| &file.machine.axes[&axis]);
        let sizes = [
            ("[axes.X] resolution_um", x.resolution_um),
            ("[axes.X] error_motion_um", x.error_motion_um),
            ("[axes.X] angular_motion_urad", x.angular_motion_urad),
            ("[axes.X] backlash_um", x.backlash_um),
            ("[axes.C] error_motion_um", c.error_motion_um),
            ("[probe] lobing_um", file.probe.lobing_um),
            ("[machine] drift_um_per_h", file.machine.drift_um_per_h),
        ];
        for (key, size) in sizes {
            assert_eq!(size, documented_value(key), "{key}");
        }
        // Four values of each linear axis, one of each rotary axis, drift and lobing.
        assert_eq!(file.assumed_keys.len(), 3 * 4 + 2 + 2, "{:?}", file.assumed_keys);
        assert!(file.assumed_keys.contains(&"axes.B.error_motion_um".to_owned()));
        // Stated values are kept, also if they are 0.
        assert_eq!((file.machine.squareness_urad, file.probe.u_stylus_offset_um), (0.0, 0.3));
        assert_eq!(c.backlash_um, 0.0);
    }

    #[test]
    fn certified_length_without_temperature_gets_the_assumed_uncertainty() {
        const SAMBA_TOML: &str = include_str!("../../../config/samba.toml");
        let keys = ["temperature_c", "u_temperature_k"];
        let is_taken_out = |line: &&str| !keys.iter().any(|key| line.starts_with(key));
        let text: String = SAMBA_TOML.lines().filter(is_taken_out).map(|line| format!("{line}\n")).collect();
        let file = MachineFile::parse("shop.toml", text).unwrap();
        let Artefact::Balls(balls) = &file.artefact else { panic!("balls") };
        assert_eq!(file.assumed_keys, ["artefact.lengths.u_temperature_k"]);
        let length = &balls.lengths[0];
        assert_eq!(length.u_temperature_k, documented_value("[[artefact.lengths]] u_temperature_k"));
        // The stated value.
        assert_eq!(length.expansion_um_per_m_k, 1.2);
        let expansion = documented_value("[[artefact.lengths]] expansion_um_per_m_k");
        assert_eq!(expansion, super::ASSUMED_EXPANSION_UM_PER_M_K);
    }

    #[test]
    fn certified_dome_without_temperature_gets_the_assumed_uncertainty() {
        const BALL_DOME_TOML: &str = include_str!("../../../config/ball-dome.toml");
        let keys = ["temperature_c", "u_temperature_k", "expansion_um_per_m_k"];
        let is_left = |line: &&str| !keys.iter().any(|key| line.starts_with(key));
        let text: String = BALL_DOME_TOML.lines().filter(is_left).map(|line| format!("{line}\n")).collect();
        let file = MachineFile::parse("shop.toml", text).unwrap();
        assert_eq!(file.assumed_keys, ["artefact.u_temperature_k", "artefact.expansion_um_per_m_k"]);
        let Artefact::Balls(balls) = &file.artefact else { panic!("balls") };
        let sizes = (balls.u_temperature_k.unwrap(), balls.expansion_um_per_m_k.unwrap());
        let keys = ["[artefact] u_temperature_k", "[artefact] expansion_um_per_m_k"];
        assert_eq!(sizes, (documented_value(keys[0]), documented_value(keys[1])));
    }

    #[test]
    fn complete_file_has_no_assumed_values() {
        let file = MachineFile::parse("shop.toml", SIMULATED_MACHINE_TOML.to_owned()).unwrap();
        assert!(file.assumed_keys.is_empty(), "{:?}", file.assumed_keys);
    }
}
