use super::*;
use crate::setup::MachineFile;
use devices::controllers::ReadinessFinding;
use machine::record::machine::AxisSense;

fn new_draft(controller: &str, topology: Option<&str>) -> MachineFileDraft {
    let controller = toml::from_str(controller).unwrap();
    MachineFileDraft { controller_keys: controller, machine_name: None, topology: topology.map(str::to_owned) }
}

fn device_info_with_axes(letters: &str) -> DeviceInfo {
    let axes = letters.chars().map(|letter| {
        let reported_axis = ReportedAxisProperties {
            travel_length: Some(300.0),
            rapid_per_min: Some(2500.0),
            resolution: Some(0.001),
            ..ReportedAxisProperties::default()
        };
        (letter.to_string().parse().unwrap(), reported_axis)
    });
    DeviceInfo { identity: "Grbl 1.1f\nnot a line".to_owned(), axes: axes.collect(), ..DeviceInfo::default() }
}

const GRBL_CONTROLLER_TOML: &str = "kind = \"grbl\"\nserial = \"/dev/ttyACM0\"\nbaud = 115200";

#[test]
fn drafts_parse_as_machine_files_with_the_reported_values() {
    for (letters, named) in [
        ("XYZBC", Some("V[w-C-B-b-Y-X-Z-(C)-t]")),
        ("XYZAC", Some("V[w-C-A-b-Y-X-Z-(C)-t]")),
        ("XYZABC", None),
        ("XYZ", None),
        ("XYZA", None),
    ] {
        let text = new_draft(GRBL_CONTROLLER_TOML, None).render(&device_info_with_axes(letters)).unwrap();
        let file = MachineFile::parse("drafted.toml", text.clone());
        let file = file.unwrap_or_else(|error| panic!("{letters}: {error}\n{text}"));
        assert!(named.is_none_or(|named| named == file.machine.topology), "{text}");
        let x = &file.machine.axes[&Axis::X];
        assert_eq!((x.min, x.max, x.rapid_per_min, x.resolution_um), (-150.0, 150.0, 2500.0, 1.0));
        assert!(text.contains("# reported: rapid speed, mm/min.\nrapid_per_min = 2500.0"), "{text}");
        assert!(text.contains("# YOURS: acceleration"), "{text}");
        assert_eq!(file.controller_section.control.dialect(), "grbl");
    }
}

#[test]
fn reported_travel_is_used_and_findings_are_comments() {
    let mut info = device_info_with_axes("XYZBC");
    let z = info.axes.get_mut(&Axis::Z).unwrap();
    (z.travel_min, z.travel_max) = (Some(-298.5), Some(0.0));
    info.findings =
        vec![ReadinessFinding { is_blocking: true, description: "a\nb".to_owned(), remedy: "$13=0".to_owned() }];
    let text = new_draft(GRBL_CONTROLLER_TOML, Some("w-C-B-F-X-Y-Z-S-t")).render(&info).unwrap();
    let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
    let z = &file.machine.axes[&Axis::Z];
    assert_eq!((z.min, z.max), (-298.5, 0.0));
    assert_eq!(file.machine.topology, "w-C-B-F-X-Y-Z-S-t");
    assert!(text.contains("# This setting prevents measurements: a b\n#   -> $13=0"), "{text}");
}

#[test]
fn unreported_homing_of_a_rotary_axis_is_left_to_the_operator() {
    use machine::record::machine::Homing;
    for (homes, homing, comments) in
        [(None, Homing::Switch, 2), (Some(true), Homing::Switch, 0), (Some(false), Homing::None, 0)]
    {
        let mut info = device_info_with_axes("XYZBC");
        for axis in [Axis::B, Axis::C] {
            info.axes.get_mut(&axis).unwrap().has_homing = homes;
        }
        let text = new_draft(GRBL_CONTROLLER_TOML, None).render(&info).unwrap();
        let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
        assert_eq!(file.machine.axes[&Axis::C].homing, homing, "{text}");
        assert_eq!(text.matches("# YOURS: whether the control homes this axis").count(), comments);
        assert_eq!(text.matches("\n# homing = \"none\"").count(), comments);
    }
}

#[test]
fn reported_axis_sense_is_used_and_unreported_is_marked() {
    let mut info = device_info_with_axes("XYZBC");
    info.axes.get_mut(&Axis::C).unwrap().positive_sense = Some(AxisSense::Reversed);
    let text = new_draft(GRBL_CONTROLLER_TOML, None).render(&info).unwrap();
    let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
    let senses = [Axis::B, Axis::C].map(|axis| file.machine.axes[&axis].positive);
    assert_eq!(senses, [AxisSense::Iso, AxisSense::Reversed]);
    assert_eq!(text.matches("# reported: sense of this axis in the kinematics of the control.").count(), 1);
    assert_eq!(text.matches("The control does not report this sense;").count(), 1, "{text}");
}

#[test]
fn invalid_drafts_are_refused() {
    let missing = new_draft(GRBL_CONTROLLER_TOML, Some("V[w-C-A-b-Y-X-Z-(C)-t]"))
        .render(&device_info_with_axes("XYZBC"))
        .unwrap_err();
    assert!(missing.to_string().contains("contains the axis A"), "{missing}");
    let keys = new_draft("kind = \"grbl\"\nbaud = 9600", None).control_config().unwrap_err();
    assert!(keys.to_string().contains("exactly one link"), "{keys}");
    let kind = new_draft("kind = \"grobl\"", None).control_config().unwrap_err();
    assert!(kind.to_string().contains("the kind of control `grobl` is not known"), "{kind}");
}
