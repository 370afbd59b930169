//! Circle and sphere fits compared with references computed to 60 digits by another minimisation method
//! (`tests/data/round_fits/references.py`): noisy data, small arcs and caps, far from the origin, five touches on a
//! ball. The remaining error must be rounding: of the centre itself, and of the distances as amplified by the
//! geometry.

use estimation::circle::fit_circle;
use estimation::sphere::fit_sphere;
use serde::Deserialize;

#[derive(Deserialize)]
struct FitCase {
    name: String,
    points: Vec<Vec<f64>>,
    centre: Vec<String>,
    radius: String,
    covariance: Vec<Vec<String>>,
}

struct FittedShape {
    centre: Vec<f64>,
    radius: f64,
    /// `None` for a circle: its reference has no covariance.
    covariance: Option<Vec<Vec<f64>>>,
    residuals: Option<Vec<f64>>,
}

/// Allowed error, in units of the rounding error of the distances with the worst signs.
const MAX_ERROR_IN_ROUNDINGS: f64 = 4.0;

fn parse_table() -> Vec<FitCase> {
    serde_json::from_str(include_str!("../data/round_fits/references.json")).unwrap()
}

fn fit_circle_or_sphere(case: &FitCase) -> FittedShape {
    match case.centre.len() {
        2 => {
            let plane: Vec<[f64; 2]> = case.points.iter().map(|p| p.as_slice().try_into().unwrap()).collect();
            let circle = fit_circle(&plane).unwrap();
            let (centre, radius) = (circle.centre.to_vec(), circle.radius);
            FittedShape { centre, radius, covariance: None, residuals: None }
        }
        3 => {
            let points: Vec<[f64; 3]> = case.points.iter().map(|p| p.as_slice().try_into().unwrap()).collect();
            let sphere = fit_sphere(&points).unwrap();
            FittedShape {
                centre: sphere.centre.to_vec(),
                radius: sphere.radius,
                covariance: Some(sphere.unit_variance_covariance.map(|row| row.to_vec()).to_vec()),
                residuals: Some(sphere.residuals),
            }
        }
        other => panic!("{other:?} is no fit"),
    }
}

/// The cases of the table, and each with repeated points: these have the same circle or sphere, and a covariance
/// smaller by that factor. So many points take a different code path, except those that are near neither shape.
fn cases_with_repeated_points() -> Vec<FitCase> {
    let round = |case: &FitCase| !case.name.starts_with("rough");
    parse_table().into_iter().chain(parse_table().into_iter().filter(round).map(with_repeated_points)).collect()
}

fn with_repeated_points(case: FitCase) -> FitCase {
    let times = 2000_usize.div_ceil(case.points.len());
    let smaller = |digits: &String| format!("{:e}", parse_number(digits) / times as f64);
    FitCase {
        points: std::iter::repeat_n(case.points, times).flatten().collect(),
        covariance: case.covariance.iter().map(|row| row.iter().map(smaller).collect()).collect(),
        name: format!("{}, repeated", case.name),
        ..case
    }
}

fn parse_number(digits: &str) -> f64 {
    digits.parse().unwrap()
}

#[test]
fn centres_and_radii_agree_to_the_last_digits() {
    let mut worst: (f64, &str) = (0.0, "");
    let cases = cases_with_repeated_points();
    for case in &cases {
        let found = fit_circle_or_sphere(case);
        let radius = parse_number(&case.radius);
        let sought: Vec<(f64, f64)> = found
            .centre
            .iter()
            .zip(&case.centre)
            .map(|(found, reference)| (*found, parse_number(reference)))
            .chain([(found.radius, radius)])
            .collect();
        for (k, (found, reference)) in sought.into_iter().enumerate() {
            let variance = parse_number(&case.covariance[k][k]);
            // One rounding error of each distance, and one of the result.
            let spread = (variance * case.points.len() as f64).sqrt();
            let rounding = f64::EPSILON * (radius * spread + reference.abs());
            let error = (found - reference).abs() / rounding;
            if error > worst.0 {
                worst = (error, &case.name);
            }
        }
    }
    println!("{} fits, worst {:.2} roundings ({})", cases.len(), worst.0, worst.1);
    assert!(worst.0 <= MAX_ERROR_IN_ROUNDINGS, "{:.2} roundings: {}", worst.0, worst.1);
}

#[test]
fn sphere_covariances_and_residuals_agree_with_references() {
    for case in cases_with_repeated_points() {
        let found = fit_circle_or_sphere(&case);
        let Some(covariance) = found.covariance else { continue };
        let variance = |k: usize| parse_number(&case.covariance[k][k]);
        for (i, (row, reference)) in covariance.iter().zip(&case.covariance).enumerate() {
            for (j, (found, reference)) in row.iter().zip(reference).enumerate() {
                let scale = (variance(i) * variance(j)).sqrt();
                let error = (found - parse_number(reference)).abs() / scale;
                // The narrowest cap amplifies the rounding of the directions 1e5 times.
                assert!(error < 1e-9, "{} ({i}, {j}): {error:.1e}", case.name);
            }
        }
        let centre: Vec<f64> = case.centre.iter().map(|digits| parse_number(digits)).collect();
        for (point, residual) in case.points.iter().zip(found.residuals.unwrap()) {
            let squares: f64 = point.iter().zip(&centre).map(|(p, c)| (p - c).powi(2)).sum();
            let expected = squares.sqrt() - parse_number(&case.radius);
            let size = parse_number(&case.radius) + centre.iter().map(|c| c.abs()).sum::<f64>();
            assert!((residual - expected).abs() < 8.0 * f64::EPSILON * size, "{}", case.name);
        }
    }
}
