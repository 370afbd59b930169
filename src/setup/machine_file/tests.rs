use std::path::Path;

use serde::Deserialize;

use super::*;
use machine::record::artefact::Cylinder;

const EMBEDDED: &str = include_str!("../../../config/simulated.toml");

/// The embedded file with `from` replaced once by `to`; `from` must be there.
fn parse_edited(from: &str, to: &str) -> Result<MachineFile, MachineFileError> {
    assert!(EMBEDDED.contains(from), "the embedded file lacks {from}");
    MachineFile::parse("shop.toml", EMBEDDED.replacen(from, to, 1))
}

/// Line (from 1) of the first line that starts with `head`, after `after`.
fn find_line_number(after: &str, head: &str) -> usize {
    let start = EMBEDDED.find(after).unwrap();
    let at = EMBEDDED[start..].find(&format!("\n{head}")).unwrap() + start + 1;
    EMBEDDED[..at].matches('\n').count() + 1
}

#[track_caller]
fn assert_refused(from: &str, to: &str, message: &str) {
    let error = parse_edited(from, to).expect_err("accepted").to_string();
    assert_eq!(error, message);
}

#[test]
fn every_file_in_config_is_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        // `trued.toml` lists machine files and is not one.
        if path.extension().is_none_or(|extension| extension != "toml") || path.ends_with("trued.toml") {
            continue;
        }
        MachineFile::read(&path).unwrap_or_else(|error| panic!("{error}"));
        count += 1;
    }
    assert!(count >= 4, "config/ holds {count} files");
}

#[test]
fn the_embedded_machine_reads_as_written() {
    let file = MachineFile::built_in_for_method("self-calibration").unwrap();
    assert_eq!(file.machine.axes[&Axis::B].max, 110.0);
    assert_eq!(file.machine.tool_mm, [0.0, 0.0, -120.0]);
    assert_eq!(file.probe.repeatability_um, Some(0.5));
    let Artefact::Cylinder(Cylinder { radius_mm, .. }) = file.artefact else { panic!() };
    assert_eq!(radius_mm, 45.0);
    assert!(matches!(file.controller_section.control, ControlConfig::Simulated(_)));
    assert_eq!(file.text(), EMBEDDED);
    assert!(file.tolerances.is_empty(), "the first command must end with code 0");
}

#[test]
fn the_hash_is_sha256_of_the_text() {
    let mut file = MachineFile::built_in_for_method("self-calibration").unwrap();
    file.document = TomlDocument::parse("x", "a=1".to_owned()).unwrap();
    // coreutils: printf 'a=1' | sha256sum
    assert_eq!(file.sha256(), "c22fea5d7428e5cf47ef6354c97c9223c95d6dcdc3e0d2300ff79056b1ff3d85");
}

#[test]
fn wrong_unit_of_a_key_suggests_the_right_key() {
    let at = find_line_number("[artefact]", "radius_mm");
    let expected =
        format!("shop.toml:{at}: unknown key `radius_um` in [artefact]; did you mean `radius_mm` (in mm, not µm)?");
    assert_refused("\nradius_mm", "\nradius_um", &expected);
}

#[test]
fn typing_errors_are_reported_with_their_line() {
    let at = find_line_number("[machine]", "topology");
    let expected = format!("shop.toml:{at}: unknown key `topolgy` in [machine]; did you mean `topology`?");
    assert_refused("\ntopology", "\ntopolgy", &expected);

    let at = find_line_number("", "[artefact]");
    let expected = format!("shop.toml:{at}: unknown section [artifact]; did you mean `artefact`?");
    assert_refused("\n[artefact]", "\n[artifact]", &expected);

    let at = find_line_number("[axes.B]", "positive");
    let expected = format!("shop.toml:{at}: `positive` in [axes.B] is `isso`; known: iso, reversed");
    assert_refused("positive = \"iso\"", "positive = \"isso\"", &expected);

    let at = find_line_number("", "[axes.B]");
    let expected = format!("shop.toml:{at}: unknown key `Q` in [axes]; known keys: X, Y, Z, A, B, C, S");
    assert_refused("[axes.B]", "[axes.Q]", &expected);
}

#[test]
fn wrong_types_and_missing_keys_are_refused_with_their_line() {
    let at = find_line_number("[artefact]", "radius_mm");
    let expected = format!("shop.toml:{at}: `radius_mm` in [artefact] must be a number, not string \"45\"");
    assert_refused("radius_mm = 45.0", "radius_mm = \"45\"", &expected);

    let at = find_line_number("[machine]", "tool_mm");
    let expected = format!("shop.toml:{at}: `tool_mm` in [machine] has 2 elements, must be an array of length 3");
    assert_refused("[0.0, 0.0, -120.0]", "[0.0, -120.0]", &expected);

    let at = find_line_number("", "[axes.B]");
    let expected = format!("shop.toml:{at}: the key `min` is missing in [axes.B]; add it");
    assert_refused("min = -110.0", "", &expected);

    let at = find_line_number("", "[artefact]");
    let expected = format!("shop.toml:{at}: the key `radius_mm` is missing in [artefact]; add it");
    assert_refused("radius_mm = 45.0", "", &expected);

    let without = EMBEDDED.split("[artefact]").next().unwrap().to_owned();
    let error = MachineFile::parse("shop.toml", without).unwrap_err().to_string();
    assert_eq!(error, "shop.toml: the section [artefact] is missing; add it");
}

#[test]
fn impossible_values_are_refused() {
    let at = find_line_number("[axes.X]", "max");
    let expected = format!("shop.toml:{at}: `max` in [axes.X] is -260; it must be greater than min = -250");
    assert_refused("max = 250.0", "max = -260.0", &expected);

    let at = find_line_number("[probe]", "ball_radius_mm");
    let expected = format!("shop.toml:{at}: `ball_radius_mm` in [probe] is -3; it must be greater than 0");
    assert_refused("ball_radius_mm = 3.0", "ball_radius_mm = -3.0", &expected);

    let at = find_line_number("[machine]", "drift_um_per_h");
    let expected = format!("shop.toml:{at}: `drift_um_per_h` in [machine] must be a finite number");
    assert_refused("drift_um_per_h = 5.0", "drift_um_per_h = nan", &expected);
    assert_refused("drift_um_per_h = 5.0", "drift_um_per_h = -inf", &expected);

    let at = find_line_number("", "[axes.B]");
    let topology = find_line_number("[machine]", "topology");
    assert_refused(
        "[axes.B]",
        "[axes.A]",
        &format!(
            "shop.toml:{topology}: `topology` in [machine] contains B, but the section [axes.B] is missing: \
            add the section with the limits of the axis"
        ),
    );
    assert_refused(
        "[axes.B]\n",
        "[axes.A]\nmin = 0\nmax = 1\n[axes.B]\n",
        &format!(
            "shop.toml:{at}: `A` in [axes] is present, but the topology `V[w-C-B-b-Y-X-Z-(C)-t]` has no \
            such axis"
        ),
    );
}

#[test]
fn keepout_box_with_min_above_max_is_refused() {
    let text = format!("{EMBEDDED}\n[[keepout]]\nname = \"setter\"\nmin_mm = [1, 0, 0]\nmax_mm = [0, 1, 1]\n");
    let error = MachineFile::parse("shop.toml", text).unwrap_err().to_string();
    assert!(error.contains("the box `setter` is not valid: each min_mm must be below its max_mm"), "{error}");
}

#[test]
fn controller_needs_a_known_kind_and_exactly_one_valid_link() {
    let controller = |keys: &str| parse_edited("kind = \"simulated\"\n", keys);
    let wire = "wire = \"memory\"";
    let strip = |keys: &str| {
        let text = EMBEDDED.replacen("kind = \"simulated\"", keys, 1).replacen(wire, "", 1);
        MachineFile::parse("shop.toml", text)
    };
    let sound = strip("kind = \"grbl\"\ntcp = \"10.0.0.7:23\"").unwrap().controller_section.control;
    assert_eq!(sound.dialect(), "grbl");
    let said = format!("{sound:?}");
    assert!(said.contains("10.0.0.7") && said.contains("port: 23"), "{said}");

    let error = |result: Result<MachineFile, MachineFileError>| result.unwrap_err().to_string();
    assert!(error(strip("kind = \"grbl\"")).contains("needs exactly one link"));
    assert!(error(strip("kind = \"grbl\"\ntcp = \"10.0.0.7\"")).contains("write `host:port`"), "a port is needed");
    let baud = "kind = \"grbl\"\ntcp = \"10.0.0.7:23\"\nbaud = 9600";
    assert!(error(strip(baud)).contains("remove it from a TCP link"));
    let message = error(controller("kind = \"fanuc\"\n"));
    assert!(message.contains("is `fanuc`; known: simulated, grbl, linuxcnc"), "{message}");
    let message = error(strip("kind = \"linuxcnc\""));
    assert!(message.contains("the key `program_dir` is missing in [controller]"), "{message}");
}

#[test]
fn tolerance_keys_need_a_unit_and_a_positive_limit() {
    let with = |keys: &str| MachineFile::parse("shop.toml", format!("{EMBEDDED}\n[tolerance]\n{keys}\n"));
    let limits = with("EX0C_um = 10.0\nEA0C_urad = 20\nEXX1_um_per_m = 5").unwrap().tolerances;
    let found: Vec<_> = limits.iter().map(|limit| (limit.symbol.as_str(), limit.unit, limit.limit)).collect();
    use machine::record::estimate::Unit;
    assert_eq!(found, [("EA0C", Unit::Urad, 20.0), ("EX0C", Unit::Um, 10.0), ("EXX1", Unit::UmPerM, 5.0)]);
    assert!(with("EX0C = 10.0").unwrap_err().to_string().contains("must be a symbol and a unit"));
    assert!(with("EX0C_um = 0").unwrap_err().to_string().contains("greater than 0"));
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    #[serde(default = "eight")]
    angles: u32,
    #[serde(default)]
    shape: Shape,
}

fn eight() -> u32 {
    8
}

/// An internally tagged type: serde buffers it and loses its locations.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
enum Shape {
    #[default]
    Round,
    Oval {
        flat_mm: f64,
    },
}

#[test]
fn method_section_is_read_by_its_own_type_with_located_errors() {
    let with = |keys: &str| MachineFile::parse("shop.toml", format!("{EMBEDDED}\n[method.some]\n{keys}\n")).unwrap();
    let read = |file: &MachineFile| file.read_method_section("some", |section| Settings::deserialize(section));
    let silent = MachineFile::built_in_for_method("self-calibration").unwrap();
    assert_eq!(read(&silent).unwrap(), Settings { angles: 8, shape: Shape::Round });
    let oval = read(&with("angles = 12\nshape = { kind = \"oval\", flat_mm = 1 }")).unwrap();
    assert_eq!(oval, Settings { angles: 12, shape: Shape::Oval { flat_mm: 1.0 } });

    let last = EMBEDDED.matches('\n').count() + 3;
    let message = read(&with("angels = 12")).unwrap_err().to_string();
    assert_eq!(message, format!("shop.toml:{last}: unknown key `angels` in [method.some]; did you mean `angles`?"));
    let message = read(&with("shape = { kind = \"oval\",\n flat_mm = 1,\n flat_um = 2 }")).unwrap_err().to_string();
    let line = last + 2;
    assert_eq!(
        message,
        format!(
            "shop.toml:{line}: unknown key `flat_um` in [method.some.shape]; did you mean `flat_mm` (in mm, not µm)?"
        )
    );
    let message = read(&with("angles = -3")).unwrap_err().to_string();
    assert!(message.contains(&format!("shop.toml:{last}: `angles` in [method.some]")), "{message}");

    let message = with("").check_method_names(&["same", "other"]).unwrap_err().to_string();
    assert!(message.contains("did you mean `method.same`?"), "{message}");
    with("").check_method_names(&["some"]).unwrap();
}

#[test]
fn simulated_section_is_read_and_may_be_absent() {
    #[derive(Deserialize)]
    struct Seed {
        seed: u64,
    }
    let file = MachineFile::built_in_for_method("self-calibration").unwrap();
    assert_eq!(file.read_simulated_section::<Seed>().unwrap().unwrap().seed, 1);
    let real = EMBEDDED.split("[simulated]").next().unwrap().to_owned();
    assert!(MachineFile::parse("x", real).unwrap().read_simulated_section::<Seed>().unwrap().is_none());
}

#[test]
fn invalid_toml_is_refused_with_its_line_and_a_missing_file_with_its_path() {
    let message = parse_edited("name = ", "name ").unwrap_err().to_string();
    let at = find_line_number("[machine]", "name");
    assert!(message.starts_with(&format!("shop.toml:{at}: the file is not valid TOML: ")), "{message}");
    let message = MachineFile::read(Path::new("no/such.toml")).unwrap_err().to_string();
    assert!(message.contains("no/such.toml cannot be read"), "{message}");
    assert!(message.contains("check the path"), "{message}");
}

#[test]
fn invalid_clamp_and_probe_keys_are_refused_with_a_reason() {
    let with = |after: &str, line: &str| {
        let head = format!("\n{after}\n");
        assert!(EMBEDDED.contains(&head), "{after}");
        let text = EMBEDDED.replacen(&head, &format!("{head}{line}\n"), 1);
        MachineFile::parse("shop.toml", text).map_err(|error| error.to_string())
    };
    let clamp = r#"clamp = { close = "M65 P3", open = "M64 P3" }"#;
    let file = with("[axes.C]", clamp).unwrap();
    assert_eq!(file.machine.axes[&Axis::C].clamp.as_ref().unwrap().wait_s, 0.5);
    for (after, line, said) in [
        ("[axes.X]", clamp, "`clamp` in [axes.X] is allowed for the axes A, B and C only"),
        ("[axes.C]", r#"clamp = { close = "M65 P3", opn = "M64 P3" }"#, "opn"),
        ("[probe]", "settle_s = -1.0", "`settle_s` in [probe] is -1; it must be from 0 to 10 s"),
        ("[probe]", "live_check = \"nobody\"", "known: touch, person"),
    ] {
        let message = with(after, line).unwrap_err();
        assert!(message.starts_with("shop.toml:") && message.contains(said), "{message}");
    }
}

#[test]
fn impossible_solids_and_stylus_sizes_are_refused_with_their_line() {
    let at = |name: &str, key: &str| find_line_number(&format!("name = \"{name}\""), key);
    let solid = |key: &str, why: &str, line: usize| format!("shop.toml:{line}: `{key}` in [solid] {why}");
    assert_refused(
        "name = \"cradle\"",
        "name = \"table\"",
        &solid("name", "is `table`, which occurs twice: use different names", at("spindle nose", "name = \"table\"")),
    );
    assert_refused(
        "on = \"B\"",
        "on = \"A\"",
        &solid("on", "is A, but this machine has no axis A", at("cradle", "on")),
    );
    assert_refused(
        "to_mm = [170.0, 130.0, -45.0]",
        "to_mm = [170.0, 130.0, -110.0]",
        &solid(
            "to_mm",
            "describes a box of zero thickness: the corners must differ in x, y and z",
            at("cradle", "to_mm"),
        ),
    );
    assert_refused(
        "radius_mm = 130.0",
        "radius_mm = -130.0",
        &solid("radius_mm", "is -130; it must be greater than 0", at("table", "radius_mm")),
    );
    let unknown = parse_edited("on = \"B\"", "on = \"ceiling\"").expect_err("accepted").to_string();
    let cradle = at("cradle", "on");
    assert!(unknown.starts_with(&format!("shop.toml:{cradle}: ")), "{unknown}");

    let stem = find_line_number("[probe]", "stem_radius_mm");
    assert_refused(
        "stem_radius_mm = 1.5",
        "stem_radius_mm = 3.0",
        &format!(
            "shop.toml:{stem}: `stem_radius_mm` in [probe] must be less than ball_radius_mm, so that the \
            ball touches before the stem"
        ),
    );
    let body = find_line_number("[probe]", "body_length_mm");
    assert_refused(
        "stem_length_mm = 95.0",
        "stem_length_mm = 0.0",
        &format!(
            "shop.toml:{body}: `body_length_mm` in [probe] requires stem_length_mm, the distance from the \
            ball to the body"
        ),
    );
}

#[test]
fn axis_without_homing_switch_adds_a_prompt_and_must_be_rotary() {
    let stated = |axis: &str| {
        let header = format!("[axes.{axis}]\n");
        EMBEDDED.replace(&header, &(header.clone() + "homing = \"none\"\n"))
    };
    let file = MachineFile::parse("shop.toml", stated("C")).unwrap();
    let [prompt] = &file.prompts_for_method("samba", &[])[..] else { panic!("one prompt") };
    assert!(prompt.contains("C has no homing switch"), "{prompt}");
    let refused = MachineFile::parse("shop.toml", stated("X")).unwrap_err().to_string();
    assert!(refused.contains("the axes A, B and C only"), "{refused}");
}

#[test]
fn prompts_apply_to_their_methods_and_invalid_prompts_are_refused() {
    let with = |more: &str| MachineFile::parse("shop.toml", format!("{EMBEDDED}\n{more}"));
    let two = "[[prompt]]\ntext = \"clean\"\n[[prompt]]\ntext = \"cap off\"\nmethods = [\"laser-r-test\"]\n";
    let file = with(two).unwrap();
    assert_eq!(file.prompts_for_method("samba", &[]), ["clean"]);
    assert_eq!(file.prompts_for_method("laser-r-test", &[]), ["clean", "cap off"]);
    assert!(file.without_prompts().prompts_for_method("laser-r-test", &[]).is_empty());
    let refused = file.check_method_names(&["samba"]).unwrap_err().to_string();
    assert!(refused.contains("`methods` in [prompt] contains the unknown method `laser-r-test`"), "{refused}");
    let long = "x".repeat(201);
    for (text, words) in [(" ", "must not be empty"), ("a\\tb", "a single line"), (long.as_str(), "201 characters")] {
        let refused = with(&format!("[[prompt]]\ntext = \"{text}\"\n")).unwrap_err().to_string();
        assert!(refused.contains("`text` in [prompt]") && refused.contains(words), "{refused}");
    }
    let refused = with("[[prompt]]\ntext = \"a\"\nmethod = []\n").unwrap_err().to_string();
    assert!(refused.contains("did you mean `methods`?"), "{refused}");
}

#[test]
fn work_offset_that_the_dialect_uses_is_refused() {
    let grbl = include_str!("../../../config/grblhal-sim.toml");
    let linuxcnc = include_str!("../../../config/linuxcnc-sim.toml");
    let parse = |text: &str, slot: &str| {
        let section = format!("[compensation.work-offset]\nslot = \"{slot}\"\n\n[probe]");
        MachineFile::parse("shop.toml", text.replace("[probe]", &section))
    };
    for (text, slot) in [(grbl, "G54"), (grbl, "G58"), (linuxcnc, "G59"), (linuxcnc, "G59.2")] {
        let file = parse(text, slot).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(file.compensation[0].kind(), "work-offset");
    }
    for (text, slot, expected) in [
        (grbl, "G59", "must be one of G54, G55, G56, G57, G58: programs of trued use G59"),
        (grbl, "G59.1", "programs of trued use G59"),
        (linuxcnc, "G59.3", "programs of trued use G59.3"),
        (linuxcnc, "G53", "`G53` is no work offset; known are G54, G55"),
    ] {
        let error = parse(text, slot).expect_err("accepted").to_string();
        assert!(error.contains(expected) && error.contains("slot"), "{error}");
    }
}
