//! Reads one of NIST's files: start values and certified values from line 41, data from line 61.

pub const NIST_STRD_FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../data/nist_strd");

pub struct Dataset {
    /// Start 1 (far from the solution) and start 2 (near it).
    pub start_values: [Vec<f64>; 2],
    pub certified_parameters: Vec<f64>,
    pub certified_standard_deviations: Vec<f64>,
    /// Sum of squares of the residuals at the certified parameters.
    pub certified_residual_sum_of_squares: f64,
    pub responses: Vec<f64>,
    pub predictors: Vec<Vec<f64>>,
}

pub fn read_dataset(name: &str) -> Dataset {
    let text = std::fs::read_to_string(format!("{NIST_STRD_FOLDER}/{name}.dat")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let certified: Vec<Vec<f64>> = lines[40..].iter().map_while(|line| parse_parameter_line(line)).collect();
    let column = |k: usize| certified.iter().map(|row| row[k]).collect::<Vec<f64>>();
    let squares = lines.iter().find_map(|line| line.strip_prefix("Residual Sum of Squares:"));
    let rows = lines[60..].iter().filter(|line| !line.trim().is_empty()).map(|line| parse_numbers(line));
    let (mut y, mut x) = (Vec::new(), Vec::new());
    for mut row in rows {
        y.push(row.remove(0));
        x.push(row);
    }
    // The only problem whose response is a logarithm.
    if name == "Nelson" {
        y.iter_mut().for_each(|y| *y = y.ln());
    }
    Dataset {
        start_values: [column(0), column(1)],
        certified_parameters: column(2),
        certified_standard_deviations: column(3),
        certified_residual_sum_of_squares: squares.unwrap().trim().parse().unwrap(),
        responses: y,
        predictors: x,
    }
}

/// The four numbers of a line `b1 = start 1, start 2, parameter, standard deviation`, or `None` for another line.
fn parse_parameter_line(line: &str) -> Option<Vec<f64>> {
    let (name, values) = line.split_once('=')?;
    name.trim().starts_with('b').then(|| parse_numbers(values)).filter(|row| row.len() == 4)
}

fn parse_numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|number| number.parse().unwrap()).collect()
}
