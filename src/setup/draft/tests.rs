use super::*;
use crate::setup::MachineFile;
use devices::controllers::ReadinessFinding;
use machine::record::machine::AxisSense;

fn draft(controller: &str, topology: Option<&str>) -> MachineFileDraft {
    let controller = toml::from_str(controller).unwrap();
    MachineFileDraft { controller, name: None, topology: topology.map(str::to_owned) }
}

fn said(letters: &str) -> DeviceInfo {
    let axes = letters.chars().map(|letter| {
        let says = ReportedAxis {
            travel_length: Some(300.0),
            rapid_per_min: Some(2500.0),
            resolution: Some(0.001),
            ..ReportedAxis::default()
        };
        (letter.to_string().parse().unwrap(), says)
    });
    DeviceInfo { identity: "Grbl 1.1f\nnot a line".to_owned(), axes: axes.collect(), ..DeviceInfo::default() }
}

const GRBL: &str = "kind = \"grbl\"\nserial = \"/dev/ttyACM0\"\nbaud = 115200";

#[test]
fn draft_is_read_by_the_machine_file_reader() {
    for (letters, named) in [
        ("XYZBC", Some("V[w-C-B-b-Y-X-Z-(C)-t]")),
        ("XYZAC", Some("V[w-C-A-b-Y-X-Z-(C)-t]")),
        ("XYZABC", None),
        ("XYZ", None),
        ("XYZA", None),
    ] {
        let text = draft(GRBL, None).render(&said(letters)).unwrap();
        let file = MachineFile::parse("drafted.toml", text.clone());
        let file = file.unwrap_or_else(|error| panic!("{letters}: {error}\n{text}"));
        assert!(named.is_none_or(|named| named == file.machine.topology), "{text}");
        let x = &file.machine.axes[&Axis::X];
        assert_eq!((x.min, x.max, x.rapid_per_min, x.resolution_um), (-150.0, 150.0, 2500.0, 1.0));
        assert!(text.contains("# reported: rapid speed, mm/min.\nrapid_per_min = 2500.0"), "{text}");
        assert!(text.contains("# YOURS: acceleration"), "{text}");
        assert_eq!(file.controller.control.dialect(), "grbl");
    }
}

#[test]
fn travel_of_the_control_is_used_and_notes_are_comments() {
    let mut said = said("XYZBC");
    let z = said.axes.get_mut(&Axis::Z).unwrap();
    (z.travel_min, z.travel_max) = (Some(-298.5), Some(0.0));
    said.findings =
        vec![ReadinessFinding { is_blocking: true, description: "a\nb".to_owned(), remedy: "$13=0".to_owned() }];
    let text = draft(GRBL, Some("w-C-B-F-X-Y-Z-S-t")).render(&said).unwrap();
    let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
    let z = &file.machine.axes[&Axis::Z];
    assert_eq!((z.min, z.max), (-298.5, 0.0));
    assert_eq!(file.machine.topology, "w-C-B-F-X-Y-Z-S-t");
    assert!(text.contains("# This setting prevents measurements: a b\n#   -> $13=0"), "{text}");
}

#[test]
fn regress_whether_a_rotary_axis_is_homed_is_left_to_the_operator_where_it_is_not_told() {
    use machine::record::machine::Homing;
    for (homes, homing, comments) in
        [(None, Homing::Switch, 2), (Some(true), Homing::Switch, 0), (Some(false), Homing::None, 0)]
    {
        let mut said = said("XYZBC");
        for axis in [Axis::B, Axis::C] {
            said.axes.get_mut(&axis).unwrap().has_homing = homes;
        }
        let text = draft(GRBL, None).render(&said).unwrap();
        let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
        assert_eq!(file.machine.axes[&Axis::C].homing, homing, "{text}");
        assert_eq!(text.matches("# YOURS: whether the control homes this axis").count(), comments);
        assert_eq!(text.matches("\n# homing = \"none\"").count(), comments);
    }
}

#[test]
fn regress_the_sense_that_the_control_tells_is_taken_and_any_other_is_marked() {
    let mut said = said("XYZBC");
    said.axes.get_mut(&Axis::C).unwrap().positive_sense = Some(AxisSense::Reversed);
    let text = draft(GRBL, None).render(&said).unwrap();
    let file = MachineFile::parse("drafted.toml", text.clone()).unwrap();
    let senses = [Axis::B, Axis::C].map(|axis| file.machine.axes[&axis].positive);
    assert_eq!(senses, [AxisSense::Iso, AxisSense::Reversed]);
    assert_eq!(text.matches("# reported: sense of this axis in the kinematics of the control.").count(), 1);
    assert_eq!(text.matches("The control does not report it;").count(), 1, "{text}");
}

#[test]
fn invalid_drafts_are_refused() {
    let missing = draft(GRBL, Some("V[w-C-A-b-Y-X-Z-(C)-t]")).render(&said("XYZBC")).unwrap_err();
    assert!(missing.to_string().contains("contains the axis A"), "{missing}");
    let keys = draft("kind = \"grbl\"\nbaud = 9600", None).control().unwrap_err();
    assert!(keys.to_string().contains("exactly one link"), "{keys}");
    let kind = draft("kind = \"grobl\"", None).control().unwrap_err();
    assert!(kind.to_string().contains("the kind of control `grobl` is not known"), "{kind}");
}
