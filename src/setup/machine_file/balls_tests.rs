//! Balls in machine files: accepted values, and refusals with file, line and key.

use std::path::Path;

use super::*;
use machine::record::artefact::{Ball, Balls};

const SAMBA_MACHINE_FILE: &str = include_str!("../../../config/samba.toml");

/// The built-in file with `from` replaced once by `to`, and the line of the replacement.
fn parse_edited_and_find_line(from: &str, to: &str) -> (Result<MachineFile, MachineFileError>, usize) {
    let at = SAMBA_MACHINE_FILE.find(from).unwrap_or_else(|| panic!("no {from}"));
    let line = SAMBA_MACHINE_FILE[..at].matches('\n').count() + 1;
    (MachineFile::parse("shop.toml", SAMBA_MACHINE_FILE.replacen(from, to, 1)), line)
}

/// Checks that the error names the line that is `lines_below` lines after the replacement.
#[track_caller]
fn assert_refused(from: &str, to: &str, lines_below: usize, expected_message: &str) {
    let (file, line) = parse_edited_and_find_line(from, to);
    let message = file.expect_err("accepted").to_string();
    let expected = format!("shop.toml:{}: {expected_message}", line + lines_below);
    assert!(message.starts_with(&expected), "{message}\nis not\n{expected}");
}

fn balls(file: &MachineFile) -> &Balls {
    let Artefact::Balls(balls) = &file.artefact else { panic!("no balls") };
    balls
}

#[test]
fn built_in_samba_file_has_topology_and_balls_of_paper_4() {
    let file = MachineFile::built_in_for_method("samba").unwrap();
    assert_eq!(file.machine.topology, "w-C-B-X-F-Z-Y-S-t");
    let balls = balls(&file);
    // Paper 4, Table 1.
    let table = [
        [-152.4, 0.0, 40.855],
        [152.4, 0.0, 40.435],
        [160.0, 160.0, 177.835],
        [-160.0, 160.0, 177.695],
        [-160.0, -160.0, 75.605],
        [160.0, -160.0, 76.045],
    ];
    assert_eq!(balls.balls.iter().map(|ball| ball.centre_mm).collect::<Vec<_>>(), table);
    assert_eq!((balls.lengths[0].mm, balls.lengths[0].u_mm), (304.8, 1e-4));
    assert!(file.tolerances.is_empty(), "the first command must end with code 0");
    crate::setup::build_world(&file).unwrap();
}

#[test]
fn built_in_samba_truth_equals_table_2_of_paper_4() {
    let file = MachineFile::built_in_for_method("samba").unwrap();
    let truth: simulator::MachineTruth = file.read_simulated_section().unwrap().unwrap();
    let table = include_str!("../../../tests/data/paper4-table2.csv");
    let mut count = 0;
    for line in table.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let [name, value, unit] = line.split(',').collect::<Vec<_>>().try_into().unwrap();
        let value: f64 = value.parse().unwrap();
        let (unit, value) = match unit {
            "mm" => ("um", value * 1e3),
            "um/m" => ("um_per_m", value),
            same => (same, value),
        };
        assert!((truth.errors[&format!("{name}_{unit}")] - value).abs() < 1e-9, "{line}");
        count += 1;
    }
    assert_eq!((count, truth.errors.len()), (13, 13));
}

#[test]
fn invalid_balls_are_refused_with_their_line() {
    assert_refused(
        "id = \"2\"",
        "id = \"1\"",
        0,
        "`id` in [artefact.balls] is `1`, as for another ball; give each ball its own id",
    );
    for id in ["a/b", "a b", "a,b"] {
        let to = format!("id = \"{id}\"");
        let message = format!("`id` in [artefact.balls] is `{id}`; it must be one word without `/` or `,`");
        assert_refused("id = \"4\"", &to, 0, &message);
    }
    assert_refused("id = \"4\"", "id = \"\"", 0, "`id` in [artefact.balls] must not be empty");
    assert_refused(
        "centre_mm = [-160.0, 160.0, 177.695]",
        "centre_mm = [160.0, 160.0, 190.0]",
        0,
        "`centre_mm` in [artefact.balls] is 12.165 mm from ball `3`; the two balls would touch",
    );
    assert_refused(
        "centre_mm = [-160.0, -160.0, 75.605]",
        "centre_mm = [160.0, 152.0, 100.0]",
        0,
        "`centre_mm` in [artefact.balls] puts ball `5` into the stem of ball `3`: 8.000 mm",
    );
    // The reverse case: the stem of the later ball.
    assert_refused(
        "centre_mm = [160.0, -160.0, 76.045]",
        "centre_mm = [-152.4, 5.0, 76.0]",
        0,
        "`centre_mm` in [artefact.balls] puts ball `1` into the stem of ball `6`: 5.000 mm",
    );
    for radius in ["0.0", "-1.0"] {
        let to = format!("radius_mm = {radius}\nstem");
        let said = "`radius_mm` in [artefact.balls] is ";
        assert_refused("radius_mm = 6.35\nstem", &to, 0, said);
    }
    assert_refused(
        "stem_radius_mm = 2.0\nstem_length_mm = 177.0",
        "stem_radius_mm = 6.35\nstem_length_mm = 177.0",
        0,
        "`stem_radius_mm` in [artefact.balls] is 6.35; the stem must be thinner than its ball",
    );
    assert_refused(
        "stem_length_mm = 177.0",
        "stem_length_mm = 6.0",
        0,
        "`stem_length_mm` in [artefact.balls] is 6; the length is measured from the centre of the ball",
    );
    // The squared length of the last direction overflows to infinity.
    for stem in ["[0.0, 0.0, 0.0]", "[1e200, 0.0, 0.0]"] {
        let said = "`stem` in [artefact.balls] must be a direction";
        assert_refused("stem = [0.0, 0.0, -1.0]", &format!("stem = {stem}"), 0, said);
    }
    assert_refused(
        "uncertainty_mm = 1.0",
        "uncertainty_mm = -1.0",
        0,
        "`uncertainty_mm` in [artefact] must not be negative",
    );
}

#[test]
fn invalid_certified_lengths_are_refused_with_their_line() {
    let lengths = |key: &str| format!("`{key}` in [artefact.lengths]");
    let ends = "from = \"1\"\nto = \"2\"";
    assert_refused(
        ends,
        "from = \"7\"\nto = \"2\"",
        0,
        &(lengths("from") + " is `7`; no ball in the list has this id"),
    );
    assert_refused(ends, "from = \"1\"\nto = \"7\"", 1, &(lengths("to") + " is `7`; no ball in the list has this id"));
    assert_refused(
        ends,
        "from = \"1\"\nto = \"1\"",
        1,
        &(lengths("to") + " is `1`, the same ball as `from`; a length needs two different balls"),
    );
    assert_refused("u_mm = 0.0001", "u_mm = 0.0", 0, &(lengths("u_mm") + " is 0; the standard"));
    assert_refused("u_mm = 0.0001", "u_mm = -0.1", 0, &(lengths("u_mm") + " is -0.1; the standard"));
    let apart = lengths("mm") + " is 306.9, but the stated centres of balls `1` and `2` are 304.800 mm apart";
    assert_refused("mm = 304.8\n", "mm = 306.9\n", 0, &apart);
    parse_edited_and_find_line("mm = 304.8\n", "mm = 306.7\n").0.unwrap();
    let warm = lengths("u_temperature_k") + " is -1; it must not be negative";
    assert_refused("u_temperature_k = 0.5", "u_temperature_k = -1", 0, &warm);
    assert_refused("u_mm = 0.0001", "u_um = 0.1", 0, "unknown key `u_um` in [artefact.lengths]");
}

/// The built-in file with its balls in the CSV table `table`.
fn read_with_ball_table(table: &str) -> Result<MachineFile, String> {
    read_with_common_keys_and_ball_table("", table)
}

/// The built-in file with its balls in the CSV table `table`, and with the keys `common` in [artefact].
fn read_with_common_keys_and_ball_table(common: &str, table: &str) -> Result<MachineFile, String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("set.csv"), table).unwrap();
    let at = SAMBA_MACHINE_FILE.find("\n[[artefact.balls]]").unwrap();
    let to = SAMBA_MACHINE_FILE.find("\n[[artefact.lengths]]").unwrap();
    let text = format!("{}\nfile = \"set.csv\"\n{common}{}", &SAMBA_MACHINE_FILE[..at], &SAMBA_MACHINE_FILE[to..]);
    let path = folder.path().join("shop.toml");
    std::fs::write(&path, text).unwrap();
    let prefix = format!("{}/", folder.path().display());
    MachineFile::read(&path).map_err(|error| error.to_string().replace(&prefix, ""))
}

const BALL_TABLE_CSV: &str = "# from the drawing
ball, x_mm,y_mm,z_mm,radius_mm,stem_x,stem_y,stem_z,stem_radius_mm,stem_length_mm
1,-152.4,0,40.855,6.35,0,0,-1,2,40
2,152.4,0,40.435,6.35,,,,2,40
# the tall ones
3,160,160,177.835,6.35,0,0,-1,2,177
4,-160,160,177.695,6.35,0,0,-1,2,177
5,-160,-160,75.605,6.35,0,0,-1,2,75
6,160,-160,76.045,6.35,0,0,-1,2,75
";

#[test]
fn ball_table_file_equals_inline_balls() {
    let inline = MachineFile::built_in_for_method("samba").unwrap();
    let file = read_with_ball_table(BALL_TABLE_CSV).unwrap();
    assert_eq!(balls(&file), balls(&inline));
    // A stored run keeps its balls after the table is deleted.
    let text = file.text().to_owned();
    let lost = MachineFile::parse("shop.toml", text.clone()).unwrap_err().to_string();
    assert!(
        lost.contains(
            "`file` in [artefact] names a file, but the folder of the machine file is not \
        known"
        ),
        "{lost}"
    );
    let stored = MachineFile::from_stored_run("run 1", text, &file.artefact).unwrap();
    assert_eq!(stored.artefact, file.artefact);
    // Columns in another order, and without a stem.
    let few = read_with_ball_table("radius_mm,z_mm,y_mm,x_mm,ball\n6,40,0,-152.4,1\n6,40,0,152.4,2\n").unwrap();
    assert_eq!(balls(&few).balls[1].centre_mm, [152.4, 0.0, 40.0]);
    assert_eq!(balls(&few).balls[1].stem, [0.0, 0.0, -1.0]);
}

#[test]
fn invalid_ball_table_is_refused_with_its_line_and_column() {
    let said = |from: &str, to: &str| {
        assert!(BALL_TABLE_CSV.contains(from), "{from}");
        read_with_ball_table(&BALL_TABLE_CSV.replacen(from, to, 1)).expect_err("accepted")
    };
    for (from, to, expected) in [
        ("y_mm", "y_um", "set.csv:2: column `y_um` is unknown; did you mean `y_mm` (in mm, not µm)?"),
        ("radius_mm,stem_x", "x_mm,stem_x", "set.csv:2: column `radius_mm` is missing"),
        ("stem_x", "stem_y", "set.csv:2: column `stem_y` occurs twice"),
        ("152.4,0,40.435", "wide,0,40.435", "set.csv:4: column `x_mm` is `wide`; it must be a finite"),
        ("152.4,0,40.435", "nan,0,40.435", "set.csv:4: column `x_mm` is `nan`; it must be a finite"),
        ("152.4,0,40.435", "152.4,,40.435", "set.csv:4: column `y_mm` is empty"),
        ("2,152.4", "1,152.4", "set.csv:4: column `ball` is `1`, as for another ball"),
        (
            "3,160,160,177.835",
            "3,152.4,0,45",
            "set.csv:6: column `x_mm` is 4.565 mm from ball `2`; the two balls would touch",
        ),
        (",2,75\n6", ",2\n6", "set.csv:8: the file is not a valid table of comma-separated values: "),
        ("3,160", "a b,160", "set.csv:6: column `ball` is `a b`; it must be one word"),
    ] {
        let message = said(from, to);
        assert!(message.starts_with(expected), "{message}\nis not\n{expected}");
    }
    assert!(read_with_ball_table("ball,x_mm,y_mm,z_mm,radius_mm\n").unwrap_err().contains("contains no ball"));
    let twice = "file = \"set.csv\"\n# id: any";
    assert_refused("# id: any", twice, 0, "`file` in [artefact] and [[artefact.balls]] are both present");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/none.toml");
    let text = SAMBA_MACHINE_FILE.replacen("uncertainty_mm = 1.0", "file = \"none.csv\"", 1);
    let start = text.find("\n[[artefact.balls]]").unwrap();
    let end = text.find("\n[[artefact.lengths]]").unwrap();
    let text = format!("{}{}", &text[..start], &text[end..]);
    let source = artefact::ArtefactSource::FolderOfMachineFile(path.parent().unwrap());
    let message =
        MachineFile::from_document(TomlDocument::parse("x.toml", text).unwrap(), source).unwrap_err().to_string();
    assert!(message.contains("none.csv cannot be read"), "{message}");
    assert!(message.contains("the folder of the machine file"), "{message}");
}

/// The paper's table contains centres only; shared properties are in [artefact].
#[test]
fn common_ball_keys_fill_missing_columns_and_empty_cells() {
    let paper = include_str!("../../../tests/data/paper4-table1.csv");
    let common = "radius_mm = 6.35\nstem_radius_mm = 2.0\nstem_length_mm = 177.0\n";
    let file = read_with_common_keys_and_ball_table(common, paper).unwrap();
    let inline = MachineFile::built_in_for_method("samba").unwrap();
    for (read, stated) in balls(&file).balls.iter().zip(&balls(&inline).balls) {
        let expected = Ball { stem_length_mm: 177.0, ..stated.clone() };
        assert_eq!(*read, expected);
    }
    assert_eq!(balls(&file).balls.len(), 6);
    // A row's own value takes precedence; an empty cell uses the shared value.
    let rows = "ball,x_mm,y_mm,z_mm,radius_mm,stem_x\n1,-152.4,0,40.855,5,1\n2,152.4,0,40.435,,\n";
    let own = read_with_common_keys_and_ball_table("radius_mm = 6.0\nstem = [0.0, 1.0, 0.0]\n", rows).unwrap();
    let radii: Vec<f64> = balls(&own).balls.iter().map(|ball| ball.radius_mm).collect();
    let stems: Vec<[f64; 3]> = balls(&own).balls.iter().map(|ball| ball.stem).collect();
    assert_eq!((radii, stems), (vec![5.0, 6.0], vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]));
}

#[test]
fn invalid_common_keys_of_balls_are_refused_with_their_line() {
    let paper = include_str!("../../../tests/data/paper4-table1.csv");
    let said = |common: &str, table: &str| read_with_common_keys_and_ball_table(common, table).expect_err("accepted");
    let none = said("", paper);
    assert!(none.starts_with("set.csv:2: column `radius_mm` is missing; state radius_mm in [art"));
    let key = SAMBA_MACHINE_FILE[..SAMBA_MACHINE_FILE.find("\n[[artefact.balls]]").unwrap()].lines().count() + 2;
    for (common, why) in [
        ("radius_mm = -6.35\n", "`radius_mm` in [artefact] is -6.35; it must be greater than 0"),
        ("radius_mm = \"6\"\n", "`radius_mm` in [artefact] "),
        ("stem = [0.0, 0.0, 0.0]\nradius_mm = 6.35\n", "`stem` in [artefact] must be a direction"),
    ] {
        let message = said(common, paper);
        let expected = format!("shop.toml:{key}: {why}");
        assert!(message.starts_with(&expected), "{message}\nis not\n{expected}");
    }
    let bad = said("radius_mm = 6.35\n", &paper.replace("3,160.0000", "3,16O.0000"));
    assert!(bad.starts_with("set.csv:5: column `x_mm` is `16O.0000`"), "{bad}");
    let big = said("radius_mm = 160.0\n", paper);
    assert!(big.starts_with("set.csv:4: column `x_mm` is"), "{big}");
    let inline = "radius_mm = 6.35\n# id: any";
    assert_refused("# id: any", inline, 0, "`radius_mm` in [artefact] is a common value for the balls");
}

#[test]
fn ball_table_file_is_refused_for_a_cylinder() {
    let built_in = include_str!("../../../config/simulated.toml");
    let text = built_in.replacen("kind = \"cylinder\"", "kind = \"cylinder\"\nfile = \"x.csv\"", 1);
    let message = MachineFile::parse("shop.toml", text).unwrap_err().to_string();
    assert!(message.contains("unknown key `file` in [artefact]"), "{message}");
}

/// Calculated by hand: a quarter turn rotates (x, y) to (−y, x).
#[test]
fn artefact_origin_and_turn_apply_to_ball_centres_and_stems() {
    let at = "kind = \"balls\"\n";
    let (placed, _) =
        parse_edited_and_find_line(at, "kind = \"balls\"\norigin_mm = [1.0, 2.0, 60.0]\nturned_deg = 90.0\n");
    let (stated, placed) = (MachineFile::built_in_for_method("samba").unwrap(), placed.unwrap());
    for (stated, placed) in balls(&stated).balls.iter().zip(&balls(&placed).balls) {
        let [x, y, z] = stated.centre_mm;
        let expected = [1.0 - y, 2.0 + x, 60.0 + z];
        let apart = |k: usize| (placed.centre_mm[k] - expected[k]).abs();
        assert!((0..3).all(|k| apart(k) < 1e-9), "{:?} {expected:?}", placed.centre_mm);
        let [x, y, z] = stated.stem;
        let apart = |k: usize| (placed.stem[k] - [-y, x, z][k]).abs();
        assert!((0..3).all(|k| apart(k) < 1e-9), "{:?}", placed.stem);
    }
    assert_refused(at, "kind = \"balls\"\norigin_mm = [1.0]\n", 1, "`origin_mm` in [artefact]");
}

#[test]
fn certificate_uncertainty_outside_its_range_is_refused() {
    let at = "kind = \"balls\"\n";
    for value in ["-1.0", "0.0", "2.65", "nan"] {
        let key = format!("kind = \"balls\"\ncertificate_u_mm = {value}\n");
        assert_refused(at, &key, 1, "`certificate_u_mm` in [artefact]");
    }
}
