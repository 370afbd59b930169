//! Names of the combinations of unknowns that a rank-deficient design does not determine.

use faer::MatRef;

/// Entries below this fraction of the largest entry of a direction are rounding errors.
const NEGLIGIBLE_ENTRY_RATIO: f64 = 1e-7;
/// Maximum number of unknowns that are named in one direction.
const MAX_LISTED_UNKNOWNS: usize = 6;

/// Names the undetermined directions. `null_space` (unknowns × nullity, e.g. that of
/// [`RankAnalysis`](super::linear_least_squares::RankAnalysis)) is reduced to a sparse basis. The forms of a name are:
///
/// - `EXX1 (not seen)`: one unknown that changes no row;
/// - `EX0S + t_x (inseparable)`: the rows determine only this combination of two unknowns;
/// - `W0 : W1 : W2 = 1 : 1 : 1 (not seen)`: changes in this proportion change no row.
///
/// Unknowns without a name are called `unknown 7`.
pub fn name_null_space(null_space: MatRef<'_, f64>, names: &[String]) -> Vec<String> {
    let unknowns = null_space.nrows();
    let forward: Vec<usize> = (0..unknowns).collect();
    let backward: Vec<usize> = (0..unknowns).rev().collect();
    let candidates = [echelon_form(null_space, &forward), echelon_form(null_space, &backward)];
    let members = |basis: &Vec<Vec<f64>>| basis.iter().flatten().filter(|v| **v != 0.0).count();
    let sparsest = candidates.into_iter().min_by_key(members).unwrap_or_default();
    sparsest.iter().map(|direction| describe_direction(direction, names)).collect()
}

/// Reduced row-echelon form of the directions (one row each), with pivots searched in the given order.
fn echelon_form(null_space: MatRef<'_, f64>, order: &[usize]) -> Vec<Vec<f64>> {
    let mut rows: Vec<Vec<f64>> = null_space.col_iter().map(|direction| direction.iter().copied().collect()).collect();
    let mut done = 0;
    for &unknown in order {
        let Some(pivot) = (done..rows.len()).max_by(|a, b| rows[*a][unknown].abs().total_cmp(&rows[*b][unknown].abs()))
        else {
            break;
        };
        if rows[pivot][unknown].abs() <= NEGLIGIBLE_ENTRY_RATIO * largest_absolute_entry(&rows[pivot]) {
            continue;
        }
        rows.swap(done, pivot);
        eliminate_unknown(&mut rows, done, unknown);
        done += 1;
    }
    for row in &mut rows {
        let floor = NEGLIGIBLE_ENTRY_RATIO * largest_absolute_entry(row);
        row.iter_mut().filter(|entry| entry.abs() <= floor).for_each(|entry| *entry = 0.0);
    }
    rows
}

/// Scales row `pivot` to 1 at `unknown` and eliminates that unknown from all other rows.
fn eliminate_unknown(rows: &mut [Vec<f64>], pivot: usize, unknown: usize) {
    let scale = 1.0 / rows[pivot][unknown];
    rows[pivot].iter_mut().for_each(|entry| *entry *= scale);
    let pivot_row = rows[pivot].clone();
    for (index, row) in rows.iter_mut().enumerate() {
        if index != pivot {
            let factor = row[unknown];
            row.iter_mut().zip(&pivot_row).for_each(|(entry, p)| *entry -= factor * p);
        }
    }
}

fn largest_absolute_entry(row: &[f64]) -> f64 {
    row.iter().fold(0.0, |largest: f64, entry| largest.max(entry.abs()))
}

fn describe_direction(direction: &[f64], names: &[String]) -> String {
    let name = |j: usize| names.get(j).cloned().unwrap_or_else(|| format!("unknown {j}"));
    let members: Vec<(usize, f64)> = direction.iter().copied().enumerate().filter(|(_, value)| *value != 0.0).collect();
    match members.as_slice() {
        [(only, _)] => format!("{} (not seen)", name(*only)),
        // The combination orthogonal to the undetermined direction is determined.
        [(a, alpha), (b, beta)] => {
            format!("{} {} (inseparable)", name(*a), signed_term(-alpha / beta, &name(*b)))
        }
        many => describe_proportion(many, name),
    }
}

fn describe_proportion(members: &[(usize, f64)], name: impl Fn(usize) -> String) -> String {
    let (named, rest) = members.split_at(members.len().min(MAX_LISTED_UNKNOWNS));
    let first = named.first().map_or(1.0, |(_, value)| *value);
    let left: Vec<String> = named.iter().map(|(j, _)| name(*j)).collect();
    let right: Vec<String> = named.iter().map(|(_, value)| format_four_digits(value / first)).collect();
    let more = match rest.len() {
        0 => String::new(),
        count => format!(" and {count} more"),
    };
    format!("{} = {}{more} (not seen)", left.join(" : "), right.join(" : "))
}

fn signed_term(factor: f64, name: &str) -> String {
    let sign = if factor < 0.0 { '-' } else { '+' };
    match format_four_digits(factor.abs()).as_str() {
        "1" => format!("{sign} {name}"),
        text => format!("{sign} {text} {name}"),
    }
}

/// Formats `value` with four significant digits, without trailing zeros.
fn format_four_digits(value: f64) -> String {
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;

    fn owned_names(texts: &[&str]) -> Vec<String> {
        texts.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn mixed_directions_are_separated() {
        // Two undetermined directions, EX0S − t_x and the gain alone, mixed by a rotation.
        let (c, s) = (0.6, 0.8);
        let pair = [1.0, -1.0, 0.0, 0.0];
        let gain = [0.0, 0.0, 0.0, 1.0];
        let mixed = Mat::from_fn(4, 2, |i, j| match j {
            0 => c * pair[i] + s * gain[i],
            _ => -s * pair[i] + c * gain[i] + 1e-14,
        });
        let found = name_null_space(mixed.as_ref(), &owned_names(&["EX0S", "t_x", "EA0B", "EXX1"]));
        assert_eq!(found, ["EX0S + t_x (inseparable)", "EXX1 (not seen)"]);
    }

    #[test]
    fn factors_are_stated_and_long_directions_shortened() {
        let lever = Mat::from_fn(2, 1, |i, _| [1.0, 250.0][i]);
        let found = name_null_space(lever.as_ref(), &owned_names(&["EC0C", "x1"]));
        assert_eq!(found, ["EC0C - 0.004 x1 (inseparable)"]);
        let constant = Mat::from_fn(8, 1, |_, _| 0.1);
        let all = name_null_space(constant.as_ref(), &owned_names(&["W0", "W1", "W2"]));
        let expected = "W0 : W1 : W2 : unknown 3 : unknown 4 : unknown 5 = 1 : 1 : 1 : 1 : 1 : 1 \
                        and 2 more (not seen)";
        assert_eq!(all, [expected]);
    }
}
