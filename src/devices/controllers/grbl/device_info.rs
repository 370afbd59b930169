//! Reads identity and settings of a Grbl control: `$I` and `$$`. Setting numbers and meanings are those of grblHAL
//! (`settings.h`).

use super::driver::GrblDriver;
use super::fault::not_ready_error;
use super::homing::{HomingMethod, has_homing, homed_axes_mask, homing_method, travel_limits};
use super::readiness;
use super::settings::{FirmwareInfo, GrblSettings};
use crate::controllers::{ControllerError, DeviceInfo, ReportedAxisProperties};
use machine::Axis;

/// Resolution of the reports, mm or degrees: they print three decimals.
const REPORT_RESOLUTION_MM_OR_DEG: f64 = 0.001;

impl GrblDriver {
    pub(super) async fn read_device_info(&mut self) -> Result<DeviceInfo, ControllerError> {
        if !self.is_prepared {
            let status = self.connection.synchronize_and_read_status().await?;
            // `$I` is not sent while the control moves: the control refuses it.
            if matches!(status.state.as_str(), "Run" | "Jog" | "Home") {
                return Err(not_ready_error(&status));
            }
        }
        let firmware = self.read_firmware_info().await?;
        let settings = self.read_settings().await?;
        let state = self.state_findings(&firmware).await?;
        let (modes, offsets) = (self.connection.send_line("$G").await?, self.connection.send_line("$#").await?);
        let needed = &self.required_homed_axes;
        let mut info = build_device_info(&firmware, &settings, homed_axes_mask(&offsets), needed);
        info.findings.extend(state);
        info.findings.extend(readiness::blocking_mode_findings(&modes));
        info.findings.extend(readiness::homed_state_finding(&firmware, &settings, needed, &offsets));
        Ok(info)
    }
}

fn build_device_info(
    firmware: &FirmwareInfo,
    settings: &GrblSettings,
    homed_axes_mask: u32,
    required_homed_axes: &[Axis],
) -> DeviceInfo {
    let axes = firmware.axes_with_report_index();
    let reported_axes =
        axes.iter().map(|(axis, index)| (*axis, reported_axis(firmware, settings, *axis, *index, homed_axes_mask)));
    DeviceInfo {
        identity: firmware.identity(),
        axes: reported_axes.collect(),
        findings: readiness::settings_findings(firmware, settings, required_homed_axes),
        probe_inversion_hint: settings
            .value(6)
            .map(|now| format!("enter ${}={} at the control (present value: {now})", 6, u8::from(now == 0.0))),
    }
}

/// Properties of one axis. Classic Grbl does not report at which end of the travel the zero is.
fn reported_axis(
    firmware: &FirmwareInfo,
    settings: &GrblSettings,
    axis: Axis,
    axis_index: u16,
    homed_axes_mask: u32,
) -> ReportedAxisProperties {
    let positive_value = |number: u16| settings.value(number + axis_index).filter(|value| *value > 0.0);
    let ends = match firmware.is_classic {
        true => None,
        false => travel_limits(settings, axis, axis_index, homed_axes_mask),
    };
    let has_homing = match firmware.is_classic {
        true => None,
        // With manual homing, `$H` sets the zero at the present position of the axis: the machine file states whether
        // the operator must confirm the zero.
        false if !axis.is_linear() && homing_method(settings, axis_index) == HomingMethod::Manual => None,
        false => has_homing(settings, axis_index, homed_axes_mask),
    };
    ReportedAxisProperties {
        travel_min: ends.map(|(min, _)| min),
        travel_max: ends.map(|(_, max)| max),
        travel_length: positive_value(130),
        has_homing,
        rapid_per_min: positive_value(110),
        acceleration_per_s2: positive_value(120),
        resolution: positive_value(100).map(|steps| REPORT_RESOLUTION_MM_OR_DEG.max(1.0 / steps)),
        positive_sense: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controllers::grbl::message::GrblMessage;

    fn device_info_from_lines(axis_letters: &str, is_classic: bool, lines: &str) -> DeviceInfo {
        let firmware = FirmwareInfo { is_classic, version: "1.1f".to_owned(), axis_letters: axis_letters.to_owned() };
        let settings = lines.lines().filter_map(|line| match GrblMessage::parse(line) {
            GrblMessage::Setting(number, value) => Some((number, value)),
            _ => None,
        });
        let axes: Vec<Axis> = firmware.axes_with_report_index().into_iter().map(|(axis, _)| axis).collect();
        build_device_info(&firmware, &GrblSettings(settings.collect()), 0, &axes)
    }

    fn travel_ends(info: &DeviceInfo, axis: Axis) -> (f64, f64) {
        (info.axes[&axis].travel_min.unwrap(), info.axes[&axis].travel_max.unwrap())
    }

    const FIVE_AXIS_SETTINGS: &str = "$10=511\n$13=0\n$20=1\n$21=1\n$22=1\n$23=1\n$27=2.000\n$44=4\n$45=3\n$100=800.000\n\
        $110=3000.000\n$120=200.000\n$130=302.000\n$131=202.000\n$132=102.000\n$133=0.000\n$300=grbl\n";

    #[test]
    fn travel_range_follows_from_the_homing_settings() {
        // As in limits_set_work_envelope: the whole travel minus the pull-off distance.
        let info = device_info_from_lines("XYZBC", false, FIVE_AXIS_SETTINGS);
        assert_eq!(travel_ends(&info, Axis::X), (-300.0, -2.0));
        assert_eq!(travel_ends(&info, Axis::Z), (-100.0, -2.0));
        let zero_at_switch = FIVE_AXIS_SETTINGS.replace("$22=1\n", "$22=9\n");
        let info = device_info_from_lines("XYZBC", false, &zero_at_switch);
        assert_eq!(travel_ends(&info, Axis::X), (0.0, 300.0));
        assert_eq!(travel_ends(&info, Axis::Y), (-200.0, 0.0));
        let no_switches_watched = zero_at_switch.replace("$21=1", "$21=0");
        assert_eq!(travel_ends(&device_info_from_lines("XYZBC", false, &no_switches_watched), Axis::X), (0.0, 302.0));
        assert_eq!(info.axes[&Axis::X].rapid_per_min, Some(3000.0));
        assert_eq!(info.axes[&Axis::X].acceleration_per_s2, Some(200.0));
        // 1/800 mm, coarser than the three decimals of the reports.
        assert_eq!(info.axes[&Axis::X].resolution, Some(0.00125));
        assert_eq!(
            info.axes[&Axis::B],
            ReportedAxisProperties { has_homing: Some(false), ..ReportedAxisProperties::default() }
        );
        assert_eq!(info.axes[&Axis::X].has_homing, Some(true));
    }

    #[test]
    fn travel_ends_are_none_if_the_settings_do_not_determine_them() {
        for lines in [FIVE_AXIS_SETTINGS.replace("$22=1\n", "$22=0\n"), FIVE_AXIS_SETTINGS.replace("$45=3", "$45=2")] {
            let info = device_info_from_lines("XYZBC", false, &lines);
            assert_eq!((info.axes[&Axis::X].travel_min, info.axes[&Axis::X].travel_length), (None, Some(302.0)));
        }
        // Settings of Grbl 1.1 on an Arduino, as users publish them.
        let info =
            device_info_from_lines("XYZ", true, "$10=1\n$13=0\n$20=0\n$21=1\n$22=1\n$23=7\n$130=500.000 (x max)");
        assert_eq!((info.axes[&Axis::X].travel_min, info.axes[&Axis::X].travel_length), (None, Some(500.0)));
        assert_eq!(info.findings.len(), 1, "{:?}", info.findings);
    }

    #[test]
    fn unsuitable_settings_are_reported() {
        let sound = device_info_from_lines("XYZ", false, FIVE_AXIS_SETTINGS);
        assert_eq!(sound.findings, []);
        for (sound, wrong, named) in [
            ("$10=511", "$10=495", "do not contain the probe"),
            ("$10=511", "$10=510", "the machine position"),
            ("$13=0", "$13=1", "in inches"),
            ("$22=1", "$22=0", "homing is off"),
        ] {
            let info = device_info_from_lines("XYZ", false, &FIVE_AXIS_SETTINGS.replace(sound, wrong));
            assert!(info.findings[0].is_blocking && info.findings[0].description.contains(named), "{info:?}");
        }
        let info = device_info_from_lines("XYZ", false, &FIVE_AXIS_SETTINGS.replace("$20=1", "$20=0"));
        assert!(info.findings[0].is_blocking && info.findings[0].description.contains("soft limits"));
        let info = device_info_from_lines("XYZBC", false, FIVE_AXIS_SETTINGS);
        assert!(info.findings[0].is_blocking, "{info:?}");
        assert!(info.findings[0].description.contains("does not home B, C"), "{info:?}");
        assert_eq!(
            device_info_from_lines("XYZBC", false, &FIVE_AXIS_SETTINGS.replace("$22=1\n", "$22=33\n")).findings,
            []
        );
    }
}
