//! Properties that LinuxCNC reports. linuxcncrsh reports its version and its units; its manual calls
//! `get ini` "not implemented", so limits and speeds come from the INI file, if `[controller] ini` names
//! it.

use super::driver::LinuxCncDriver;
use super::ini::IniFile;
use crate::controllers::{ControllerError, DeviceInfo, ReadinessFinding, ReportedAxisProperties};
use machine::Axis;
use machine::record::machine::AxisSense;

/// Modules that compute the position of a workpiece on rotary tables, and the sense of rotation in which
/// they count the axes of these tables, by their formulas (LinuxCNC 2.9, `trtfuncs.c`, `rotatekins.c`, `maxkins.c`,
/// `xyzab_tdr_kins.comp`): a table that turns right-handed by a positive command turns against ISO 841,
/// which counts the tool's motion. Other modules, such as `trivkins` and `5axiskins`, define no sense
/// of rotation for a table.
const TABLE_KINEMATICS: [(&str, &[Axis], AxisSense); 5] = [
    ("xyzac-trt-kins", &[Axis::A, Axis::C], AxisSense::Reversed),
    ("xyzbc-trt-kins", &[Axis::B, Axis::C], AxisSense::Reversed),
    ("rotatekins", &[Axis::C], AxisSense::Reversed),
    ("maxkins", &[Axis::C], AxisSense::Iso),
    ("xyzab_tdr_kins", &[Axis::A, Axis::B], AxisSense::Iso),
];

const S_PER_MIN: f64 = 60.0;
/// Resolution of reported positions, mm or degrees: linuxcncrsh prints six decimals.
const REPORT_RESOLUTION: f64 = 0.000_001;

impl LinuxCncDriver {
    pub(super) async fn read_device_info(&mut self) -> Result<DeviceInfo, ControllerError> {
        let identity = format!("LinuxCNC, {}", self.rsh.server_identity);
        let Some(path) = &self.settings.ini_path else {
            let axes = self.settings.axes.iter().map(|axis| (*axis, ReportedAxisProperties::default()));
            let description = "linuxcncrsh does not report axes, travel and speeds";
            let remedy =
                "in the machine file, set [controller] ini = \"...\" to the INI file that LinuxCNC was started with";
            let findings = vec![ReadinessFinding::non_blocking(description, remedy)];
            return Ok(DeviceInfo { identity, axes: axes.collect(), findings, probe_inversion_hint: None });
        };
        let ini = IniFile::read(path)?;
        let mm = ini.mm_per_unit();
        let axes = ini.axes().into_iter().map(|axis| (axis, ini.reported_axis(axis, mm))).collect();
        Ok(DeviceInfo { identity, axes, findings: ini.findings(), probe_inversion_hint: None })
    }
}

impl IniFile {
    /// Axes of `[TRAJ]COORDINATES`; a gantry names an axis twice.
    fn axes(&self) -> Vec<Axis> {
        let letters = self.value("TRAJ", "COORDINATES").unwrap_or_default().chars();
        let mut axes: Vec<Axis> =
            letters.filter_map(|letter| letter.to_ascii_uppercase().to_string().parse().ok()).collect();
        axes.sort();
        axes.dedup();
        axes
    }

    /// 25.4 for inches; 1 for any other or a missing unit.
    fn mm_per_unit(&self) -> f64 {
        match self.value("TRAJ", "LINEAR_UNITS").map(str::to_ascii_lowercase).as_deref() {
            Some("inch" | "in" | "imperial") => 25.4,
            _ => 1.0,
        }
    }

    fn reported_axis(&self, axis: Axis, mm_per_unit: f64) -> ReportedAxisProperties {
        let section = format!("AXIS_{axis}");
        let unit = if axis.is_linear() { mm_per_unit } else { 1.0 };
        let value = |key: &str| self.number(&section, key).map(|value| value * unit);
        let (min, max) = (value("MIN_LIMIT"), value("MAX_LIMIT"));
        ReportedAxisProperties {
            travel_min: min,
            travel_max: max,
            travel_length: min.zip(max).map(|(min, max)| max - min),
            has_homing: None,
            rapid_per_min: value("MAX_VELOCITY").map(|speed| speed * S_PER_MIN),
            acceleration_per_s2: value("MAX_ACCELERATION"),
            resolution: Some(REPORT_RESOLUTION),
            positive_sense: self
                .rotary_table_axes_and_sense()
                .filter(|(axes, _)| axes.contains(&axis))
                .map(|(_, sense)| sense),
        }
    }

    /// Axes of the table that the kinematics compute, and the sense of rotation in which they count these axes.
    fn rotary_table_axes_and_sense(&self) -> Option<(&'static [Axis], AxisSense)> {
        let module = self.kinematics_module()?;
        let known = TABLE_KINEMATICS.iter().find(|(name, ..)| *name == module);
        known.map(|(_, axes, sense)| (*axes, *sense))
    }

    /// Remarks on the kinematics, none of them blocking.
    fn findings(&self) -> Vec<ReadinessFinding> {
        let mut findings = Vec::new();
        let kinematics = self.kinematics().unwrap_or_default();
        // The INI file has only the mode at the start: `prepare` reads the present mode itself.
        if kinematics.contains("trt") && !kinematics.contains("identityfirst") {
            let description = format!(
                "the kinematics (`{kinematics}`) compensate the rotary axes after a start of LinuxCNC: the \
                 positions of axes and joints differ"
            );
            let remedy = "enter M429 before a measurement, or add sparm=identityfirst to KINEMATICS in the INI file";
            findings.push(ReadinessFinding::non_blocking(description, remedy));
        }
        if let Some((axes, AxisSense::Reversed)) = self.rotary_table_axes_and_sense() {
            let axes: Vec<String> = axes.iter().map(Axis::to_string).collect();
            let description = format!(
                "the kinematics (`{kinematics}`) count {} against ISO 841, unless the module's HAL pin \
                 conventional-directions is 1",
                axes.join(" and ")
            );
            let remedy = "set positive = \"reversed\" in [axes] of the machine file, or \"iso\" if that pin is 1; \
                          `trued check` shows the sense of rotation";
            findings.push(ReadinessFinding::non_blocking(description, remedy));
        }
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// INI file of the rig that the tests drive.
    const RIG_INI: &str = include_str!("../../../../tests/peers/linuxcnc/rig.ini");

    #[test]
    fn limits_and_speeds_come_from_the_ini_file() {
        let ini = IniFile::parse(RIG_INI);
        assert_eq!(ini.axes(), [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C]);
        let b = ini.reported_axis(Axis::B, ini.mm_per_unit());
        assert_eq!((b.travel_min, b.travel_max), (Some(-110.0), Some(110.0)));
        assert_eq!((b.rapid_per_min, b.acceleration_per_s2), (Some(12_000.0), Some(2000.0)));
        let [table] = &ini.findings()[..] else { panic!("{:?}", ini.findings()) };
        assert!(!table.is_blocking && table.description.contains("count B and C against ISO 841"), "{table:?}");
        let inches = IniFile::parse(&RIG_INI.replace("LINEAR_UNITS = mm", "LINEAR_UNITS = inch"));
        assert_eq!(inches.reported_axis(Axis::X, inches.mm_per_unit()).travel_max, Some(7620.0));
        assert_eq!(inches.reported_axis(Axis::B, inches.mm_per_unit()).travel_max, Some(110.0));
        let compensating = IniFile::parse(&RIG_INI.replace("sparm=identityfirst", ""));
        let [mode, _] = &compensating.findings()[..] else { panic!("{:?}", compensating.findings()) };
        assert!(!mode.is_blocking && mode.remedy.contains("M429"), "{mode:?}");
    }
    /// Computed by hand from the modules' formulas, one axis at 90°: with `xyzbc-trt-kins` and C = 90°
    /// joints (0, 1) are the point (1, 0) of the workpiece: its X axis has turned to the machine's Y axis,
    /// right-handed.
    #[test]
    fn how_a_table_turns_follows_from_the_kinematics_module() {
        use AxisSense::{Iso, Reversed};
        for (kinematics, [a, b, c]) in [
            ("xyzbc-trt-kins sparm=identityfirst", [None, Some(Reversed), Some(Reversed)]),
            ("xyzac-trt-kins", [Some(Reversed), None, Some(Reversed)]),
            ("xyzab_tdr_kins", [Some(Iso), Some(Iso), None]),
            ("maxkins", [None, None, Some(Iso)]),
            ("rotatekins", [None, None, Some(Reversed)]),
            ("trivkins coordinates=XYZBC", [None; 3]),
        ] {
            let line = "KINEMATICS = xyzbc-trt-kins sparm=identityfirst";
            assert!(RIG_INI.contains(line));
            let ini = IniFile::parse(&RIG_INI.replace(line, &format!("KINEMATICS = {kinematics}")));
            let told = [Axis::A, Axis::B, Axis::C].map(|axis| ini.reported_axis(axis, 1.0).positive_sense);
            assert_eq!(told, [a, b, c], "{kinematics}");
            assert_eq!(ini.reported_axis(Axis::X, 1.0).positive_sense, None);
        }
    }
}
