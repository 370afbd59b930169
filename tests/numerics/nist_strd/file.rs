//! Reads one of NIST's files: starts and certified values from line 41, data from line 61.

pub const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../data/nist_strd");

pub struct Dataset {
    pub start_values: [Vec<f64>; 2],
    pub parameters: Vec<f64>,
    pub standard_deviations: Vec<f64>,
    /// Residual sum of squares.
    pub residual_sum_of_squares: f64,
    pub y: Vec<f64>,
    pub x: Vec<Vec<f64>>,
}

pub fn read_dataset(name: &str) -> Dataset {
    let text = std::fs::read_to_string(format!("{FOLDER}/{name}.dat")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let certified: Vec<Vec<f64>> = lines[40..].iter().map_while(|line| certified_values(line)).collect();
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
        parameters: column(2),
        standard_deviations: column(3),
        residual_sum_of_squares: squares.unwrap().trim().parse().unwrap(),
        y,
        x,
    }
}

/// `b1 = start 1, start 2, parameter, standard deviation`.
fn certified_values(line: &str) -> Option<Vec<f64>> {
    let (name, values) = line.split_once('=')?;
    name.trim().starts_with('b').then(|| parse_numbers(values)).filter(|row| row.len() == 4)
}

fn parse_numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|number| number.parse().unwrap()).collect()
}
