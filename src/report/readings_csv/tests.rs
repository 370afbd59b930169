use std::collections::BTreeMap;

use rand::RngExt;

use super::*;
use estimation::random::seeded_stream;
use machine::Position;
use machine::record::reading::ReadingFlag;

fn csv_text(readings: &[Reading]) -> String {
    let mut bytes = Vec::new();
    write_readings(readings, &[], &mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}

fn line_and_problem_of_rows(rows: &str) -> (u64, ReadingsProblem) {
    let error = read_readings(format!("{FIRST_LINE}\n{rows}").as_bytes()).unwrap_err();
    (error.line, error.problem)
}

/// A random reading with numbers of every size.
fn random_reading(step: u32, random: &mut impl RngExt) -> Reading {
    let mut number = |scale: i32| random.random_range(-1.0..1.0) * 10f64.powi(random.random_range(-scale..scale));
    let mut position = Position::new();
    for axis in Axis::LINEAR {
        position.set(axis, number(6));
    }
    let (c, value, t_s, table) = (number(1), number(3), number(5), number(2));
    let mut temperatures_c = BTreeMap::new();
    if random.random_bool(0.5) {
        position.set(Axis::C, Axis::C.to_mm_or_rad(Axis::C.to_mm_or_deg(c)));
        temperatures_c.insert("table left".to_owned(), table);
    }
    Reading {
        step,
        repeat: random.random_range(0..3),
        position,
        value_mm: random.random_bool(0.5).then_some(value),
        sensor: ["probe", "", "laser, \"red\"", " # 2"][random.random_range(0..4)].to_owned(),
        t_s,
        flag: ReadingFlag::ALL[random.random_range(0..ReadingFlag::ALL.len())],
        temperatures_c: temperatures_c.into(),
    }
}

#[test]
fn written_readings_are_read_back_bit_for_bit() {
    let mut random = seeded_stream(7, &[]);
    for _ in 0..200 {
        let readings: Vec<_> = (0..6).map(|step| random_reading(step, &mut random)).collect();
        let text = csv_text(&readings);
        let back = read_readings(text.as_bytes()).unwrap();
        assert_eq!(back, readings, "{text}");
        assert_eq!(self::csv_text(&back), text);
    }
}

#[test]
fn angles_are_written_in_degrees() {
    let third = std::f64::consts::TAU / 3.0;
    let position = Position::new().with(Axis::X, 1.5).with(Axis::Y, -0.0).with(Axis::Z, 1e-7);
    let reading = Reading {
        step: 4,
        repeat: 1,
        position: position.with(Axis::C, third).with(Axis::S, -third / 4.0),
        value_mm: None,
        sensor: "probe".to_owned(),
        t_s: 0.1 + 0.2,
        flag: ReadingFlag::Excluded,
        temperatures_c: BTreeMap::from([("table".to_owned(), 20.5)]).into(),
    };
    let mut bytes = Vec::new();
    write_readings(&[reading], &["run 3\nof the mill".to_owned()], &mut bytes).unwrap();
    assert_eq!(
        String::from_utf8(bytes).unwrap(),
        "# trued-readings 1\n# run 3\n# of the mill\n\
         step,repeat,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,s_deg,value_mm,sensor,t_s,flag,temp_table_c\n\
         4,1,1.5,0,0.0000001,,,120,-30,,probe,0.30000000000000004,excluded,20.5\n"
    );
}

#[test]
fn other_column_orders_and_missing_optional_columns_are_accepted() {
    let file = "\u{feff}# trued-readings 1\r\n# by hand\r\nz_mm, step ,y_mm,x_mm,b_deg\r\n\
                # in between\r\n\r\n3,7,2,1,90\r\n";
    let readings = read_readings(file.as_bytes()).unwrap();
    let [reading] = readings.as_slice() else { panic!("{readings:?}") };
    let quarter = std::f64::consts::FRAC_PI_2;
    let expected = Position::new().with(Axis::X, 1.0).with(Axis::Y, 2.0).with(Axis::Z, 3.0).with(Axis::B, quarter);
    assert_eq!((reading.step, reading.repeat, &reading.position), (7, 0, &expected));
    assert_eq!((reading.value_mm, reading.t_s, reading.flag), (None, 0.0, ReadingFlag::None));
}

#[test]
fn several_samples_of_one_step_are_accepted() {
    let rows = "step,x_mm,y_mm,z_mm,value_mm\n1,0,0,0,0.5\n1,1,0,0,0.6\n";
    assert_eq!(read_readings(format!("{FIRST_LINE}\n{rows}").as_bytes()).unwrap().len(), 2);
}

#[test]
fn unknown_column_is_reported_with_the_nearest_name() {
    let (line, problem) = line_and_problem_of_rows("# note\nstep,x_mm,y_mm,zmm\n");
    assert_eq!(line, 3);
    assert_eq!(problem.to_string(), "unknown column `zmm`; the most similar known column is `z_mm`");
    for (name, nearest) in [("c_rad", "c_deg"), ("temp_table", "temp_NAME_c"), ("Step", "step")] {
        let (_, problem) = self::line_and_problem_of_rows(&format!("{name},x_mm,y_mm,z_mm\n"));
        let expected = ReadingsProblem::UnknownColumn { name: name.to_owned(), nearest: nearest.to_owned() };
        assert_eq!(problem, expected);
    }
}

#[test]
fn bad_line_is_reported_with_its_number() {
    let header = "# a comment\nstep,repeat,x_mm,y_mm,z_mm,flag\n0,0,1,2,3,\n# another\n";
    for (row, expected) in [
        ("1,0,1,2,3,", ReadingsProblem::NoFinalLineEnd),
        ("1,0,1,2,\n", ReadingsProblem::WrongFieldCount { found: 5, expected: 6 }),
        ("1,0,1,2,,\n", ReadingsProblem::EmptyField { name: "z_mm".to_owned() }),
        ("1,0,NaN,2,3,\n", not_finite_x_problem("NaN")),
        ("1,0,-inf,2,3,\n", not_finite_x_problem("-inf")),
        ("1,0,1e999,2,3,\n", not_finite_x_problem("1e999")),
        ("1,0,1.2.3,2,3,\n", not_a_number_x_problem("1.2.3")),
        ("-1,0,1,2,3,\n", ReadingsProblem::NotACount { name: "step".to_owned(), text: "-1".to_owned() }),
        ("1,0,1,2,3,range!\n", "range!".parse::<ReadingFlag>().unwrap_err().into()),
        ("0,0,1,2,3,\n", ReadingsProblem::DuplicateTouch { step: 0, repeat: 0, first_line: 4 }),
    ] {
        assert_eq!(line_and_problem_of_rows(&format!("{header}{row}")), (6, expected), "{row}");
    }
}

fn not_finite_x_problem(text: &str) -> ReadingsProblem {
    ReadingsProblem::NotFinite { name: "x_mm".to_owned(), text: text.to_owned() }
}

fn not_a_number_x_problem(text: &str) -> ReadingsProblem {
    ReadingsProblem::NotANumber { name: "x_mm".to_owned(), text: text.to_owned() }
}

#[test]
fn truncation_within_a_line_is_detected() {
    let mut random = seeded_stream(11, &[]);
    let readings: Vec<_> = (0..4).map(|step| random_reading(step, &mut random)).collect();
    let whole = csv_text(&readings);
    for cut in 0..whole.len() {
        let cut = &whole.as_bytes()[..cut];
        match read_readings(cut) {
            Ok(read) => assert!(cut.ends_with(b"\n") && read == readings[..read.len()]),
            Err(error) => assert!(!cut.ends_with(b"\n") || error.line == 1, "{error}"),
        }
    }
}

#[test]
fn files_with_an_invalid_head_are_refused() {
    for first in ["", "step,x_mm,y_mm,z_mm\n1,2,3,4\n", "# trued-readings 2\n"] {
        let error = read_readings(first.as_bytes()).unwrap_err();
        assert!(matches!(error.problem, ReadingsProblem::WrongFirstLine { .. }), "{error}");
        assert_eq!(error.line, 1);
    }
    let latin1 = [FIRST_LINE.as_bytes(), b"\n# M\xfcller\nstep\n"].concat();
    let error = read_readings(&latin1).unwrap_err();
    assert_eq!((error.line, error.problem), (2, ReadingsProblem::NotUtf8));
    assert_eq!(line_and_problem_of_rows("# nothing else\n"), (2, ReadingsProblem::NoHeader));
    let missing = ReadingsProblem::MissingColumn { name: "y_mm".to_owned() };
    assert_eq!(line_and_problem_of_rows("step,x_mm,z_mm\n"), (2, missing));
    let twice = ReadingsProblem::RepeatedColumn { name: "x_mm".to_owned() };
    assert_eq!(line_and_problem_of_rows("step,x_mm,x_mm\n"), (2, twice));
}

#[test]
fn non_finite_number_is_not_written() {
    let mut reading = random_reading(0, &mut seeded_stream(1, &[]));
    reading.t_s = f64::NAN;
    let error = write_readings(&[reading], &[], Vec::new()).unwrap_err();
    assert!(error.to_string().contains("t_s"), "{error}");
}
