//! Arbitrary bytes as a readings file.

use super::{read_readings, write_readings};
use machine::Axis;
use machine::record::reading::Reading;
use testing::fuzz::fuzz_parser;

const VALID_READINGS_FILE: &[u8] = b"# trued-readings 1
# run 3: self-calibration on bench
step,repeat,x_mm,y_mm,z_mm,b_deg,c_deg,s_deg,value_mm,sensor,t_s,flag,temp_table left_c
0,0,-47.99,0.0012,50,0,45,,,probe,12.25,,21.5
1,0,0.001,47.99,50,0,90,,,probe,14.5,excluded,
2,1,1e-3,-47.99,50,0,-90,180,0.125,\"laser, \"\"red\"\"\",15,range,21.75
";

#[test]
fn fuzz_readings_reader() {
    let words = [
        "# trued-readings 1\n",
        "step",
        ",x_mm,y_mm,z_mm",
        ",value_mm",
        ",t_s",
        ",flag",
        ",sensor",
        ",temp_a_c",
        "\n",
        "0,",
        "1.5,",
        "\"",
        "excluded",
        "#",
    ];
    fuzz_parser("readings-csv", &[VALID_READINGS_FILE], &words, |input| match read_readings(input) {
        Err(error) => error.to_string().len(),
        Ok(readings) => {
            let mut again = Vec::new();
            write_readings(&readings, &[], &mut again).unwrap();
            let read_again = read_readings(&again).unwrap();
            assert_eq!(read_again.len(), readings.len());
            for (one, two) in readings.iter().zip(&read_again) {
                // Degrees are written rounded, so positions agree within the rounding; all other values agree
                // bit for bit.
                let near = |axis| (one.position.get_or_zero(axis) - two.position.get_or_zero(axis)).abs();
                let far = |(axis, at): &(Axis, f64)| near(*axis) > 1e-11 + 1e-15 * at.abs();
                assert!(!one.position.iter().any(|at| far(&at)), "{one:?} {two:?}");
                assert_eq!(&Reading { position: one.position.clone(), ..two.clone() }, one);
            }
            size_of_val(readings.as_slice())
        }
    });
}
