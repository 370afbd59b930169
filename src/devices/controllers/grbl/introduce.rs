//! Identity and settings of a control: `$I` and `$$`. Setting numbers and meanings are those of grblHAL
//! (`settings.h`).

use super::built::FirmwareInfo;
use super::driver::Grbl;
use super::fault::not_ready;
use super::homing::{HomedBy, homed_by, homed_mask, is_homed_axis, travel_ends};
use super::readiness;
use super::settings::Settings;
use crate::controllers::{ControllerError, DeviceInfo, ReportedAxis};
use machine::Axis;

/// Resolution of the reports, mm or degrees: they print three decimals.
const SHOWN: f64 = 0.001;
impl Grbl {
    pub(super) async fn report_identity(&mut self) -> Result<DeviceInfo, ControllerError> {
        if !self.ready {
            let status = self.wire.wake().await?;
            // The control refuses `$I` while it moves.
            if matches!(status.state.as_str(), "Run" | "Jog" | "Home") {
                return Err(not_ready(&status));
            }
        }
        let built = self.built().await?;
        let settings = self.settings().await?;
        let axes = built.axes();
        let state = self.readiness_of_state(&built).await?;
        let (modes, offsets) = (self.wire.ask("$G").await?, self.wire.ask("$#").await?);
        let needed = &self.homed_axes;
        let mut said = introduction(&built, &settings, homed_mask(&offsets), needed);
        said.remarks.extend(state);
        said.remarks.extend(readiness::of_modes(&modes));
        said.remarks.extend(readiness::homed(&built, &settings, &axes, needed, &offsets));
        Ok(said)
    }
}

fn introduction(
    built: &FirmwareInfo,
    settings: &Settings,
    homed_mask: u32,
    homed_axes: &[Axis],
) -> DeviceInfo {
    let axes = built.axes();
    let says = axes.iter().map(|axis| (axis.0, axis_says(built, settings, *axis, homed_mask)));
    DeviceInfo {
        identity: built.identity(),
        axes: says.collect(),
        remarks: readiness::of_settings(built, settings, &axes, homed_axes),
        polarity: settings.value(6).map(|now| {
            format!("enter ${}={} at the control (it is {now} now)", 6, u8::from(now == 0.0))
        }),
    }
}

/// Properties of one axis. Classic Grbl does not report at which end its zero is: that is compiled in.
fn axis_says(
    built: &FirmwareInfo,
    settings: &Settings,
    (axis, place): (Axis, u16),
    homed_mask: u32,
) -> ReportedAxis {
    let above = |number: u16| settings.value(number + place).filter(|value| *value > 0.0);
    let ends = match built.classic {
        true => None,
        false => travel_ends(settings, (axis, place), homed_mask),
    };
    let homes = match built.classic {
        true => None,
        // By hand, `$H` sets the zero at the present position of the axis: the owner decides whether that
        // is confirmed.
        false if !axis.is_linear() && homed_by(settings, place) == HomedBy::Hand => None,
        false => is_homed_axis(settings, place, homed_mask),
    };
    ReportedAxis {
        min: ends.map(|(min, _)| min),
        max: ends.map(|(_, max)| max),
        travel: above(130),
        homes,
        rapid_per_min: above(110),
        acceleration_per_s2: above(120),
        step: above(100).map(|steps| SHOWN.max(1.0 / steps)),
        positive: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controllers::grbl::message::Message;

    fn says(letters: &str, classic: bool, lines: &str) -> DeviceInfo {
        let built =
            FirmwareInfo { classic, version: "1.1f".to_owned(), letters: letters.to_owned() };
        let settings = lines.lines().filter_map(|line| match Message::parse(line) {
            Message::Setting(number, value) => Some((number, value)),
            _ => None,
        });
        let axes: Vec<Axis> = built.axes().into_iter().map(|(axis, _)| axis).collect();
        introduction(&built, &Settings(settings.collect()), 0, &axes)
    }

    fn ends(said: &DeviceInfo, axis: Axis) -> (f64, f64) {
        (said.axes[&axis].min.unwrap(), said.axes[&axis].max.unwrap())
    }

    const FIVE: &str = "$10=511\n$13=0\n$20=1\n$21=1\n$22=1\n$23=1\n$27=2.000\n$44=4\n$45=3\n$100=800.000\n\
        $110=3000.000\n$120=200.000\n$130=302.000\n$131=202.000\n$132=102.000\n$133=0.000\n$300=grbl\n";

    #[test]
    fn where_the_travel_lies_follows_from_homing() {
        // As in limits_set_work_envelope: the whole travel minus the pull-off distance.
        let said = says("XYZBC", false, FIVE);
        assert_eq!(ends(&said, Axis::X), (-300.0, -2.0));
        assert_eq!(ends(&said, Axis::Z), (-100.0, -2.0));
        let zero_at_switch = FIVE.replace("$22=1\n", "$22=9\n");
        let said = says("XYZBC", false, &zero_at_switch);
        assert_eq!(ends(&said, Axis::X), (0.0, 300.0));
        assert_eq!(ends(&said, Axis::Y), (-200.0, 0.0));
        let no_switches_watched = zero_at_switch.replace("$21=1", "$21=0");
        assert_eq!(ends(&says("XYZBC", false, &no_switches_watched), Axis::X), (0.0, 302.0));
        assert_eq!(said.axes[&Axis::X].rapid_per_min, Some(3000.0));
        assert_eq!(said.axes[&Axis::X].acceleration_per_s2, Some(200.0));
        // 1/800 mm, coarser than the three decimals of the reports.
        assert_eq!(said.axes[&Axis::X].step, Some(0.00125));
        assert_eq!(
            said.axes[&Axis::B],
            ReportedAxis { homes: Some(false), ..ReportedAxis::default() }
        );
        assert_eq!(said.axes[&Axis::X].homes, Some(true));
    }

    #[test]
    fn what_cannot_be_known_is_not_said() {
        for lines in [FIVE.replace("$22=1\n", "$22=0\n"), FIVE.replace("$45=3", "$45=2")] {
            let said = says("XYZBC", false, &lines);
            assert_eq!((said.axes[&Axis::X].min, said.axes[&Axis::X].travel), (None, Some(302.0)));
        }
        // Settings of Grbl 1.1 on an Arduino, as users publish them.
        let said =
            says("XYZ", true, "$10=1\n$13=0\n$20=0\n$21=1\n$22=1\n$23=7\n$130=500.000 (x max)");
        assert_eq!((said.axes[&Axis::X].min, said.axes[&Axis::X].travel), (None, Some(500.0)));
        assert_eq!(said.remarks.len(), 1, "{:?}", said.remarks);
    }

    #[test]
    fn settings_that_cannot_measure_are_named() {
        let sound = says("XYZ", false, FIVE);
        assert_eq!(sound.remarks, []);
        for (sound, wrong, named) in [
            ("$10=511", "$10=495", "hide the probe"),
            ("$10=511", "$10=510", "the machine position"),
            ("$13=0", "$13=1", "in inches"),
            ("$22=1", "$22=0", "homing is off"),
        ] {
            let said = says("XYZ", false, &FIVE.replace(sound, wrong));
            assert!(said.remarks[0].hinders && said.remarks[0].what.contains(named), "{said:?}");
        }
        let said = says("XYZ", false, &FIVE.replace("$20=1", "$20=0"));
        assert!(said.remarks[0].hinders && said.remarks[0].what.contains("soft limits"));
        let said = says("XYZBC", false, FIVE);
        assert!(said.remarks[0].hinders, "{said:?}");
        assert!(said.remarks[0].what.contains("does not home B, C"), "{said:?}");
        assert_eq!(says("XYZBC", false, &FIVE.replace("$22=1\n", "$22=33\n")).remarks, []);
    }
}
