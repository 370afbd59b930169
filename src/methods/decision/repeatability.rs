//! Repeatability of a parameter: the same cycle repeated on the same machine within a short time (repeatability
//! conditions, ISO 5725-1, 3.14). The scatter between the repetitions is compared with the uncertainty that each of
//! them states, and with time and temperature.

use std::collections::BTreeSet;

use serde::Serialize;

use estimation::coverage::{chi_square_bounds, coverage_factor};
use machine::record::estimate::Unit;
use machine::record::reading::Temperatures;

/// Probability of the interval within which the ratio of the scatter to u lies, if u is right and purely random.
const SCATTER_INTERVAL_PROBABILITY: f64 = 0.95;
/// Fewest repetitions for a slope: two determine a line without a residual.
const MIN_REPETITIONS_FOR_SLOPE: usize = 3;

/// One parameter in one repetition, in the unit of the parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Repetition {
    /// Mean time of the repetition from any origin, s.
    pub time_s: f64,
    pub value: f64,
    /// Standard uncertainty that the estimate of this repetition states.
    pub u: f64,
    /// Mean temperature of each thermometer.
    pub temperatures_c: Temperatures,
}

/// Repeatability of one parameter, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Repeatability {
    pub symbol: String,
    pub unit: Unit,
    /// Number of repetitions.
    pub repetitions: usize,
    pub mean: f64,
    /// Within the repetitions: root mean square of the standard uncertainties that they state.
    pub within: f64,
    /// Between the repetitions: experimental standard deviation of the values (GUM 4.2.2), which is the repeatability
    /// standard deviation s_r of ISO 5725-2.
    pub between: f64,
    /// `between` / `within`. A ratio below 1 is no fault: u contains systematic errors that all repetitions share.
    pub ratio: f64,
    /// Whether the ratio is above the upper bound of its 95 % interval by χ²: u is too small, or the machine drifts.
    pub exceeds_u: bool,
    /// Drift against time, per hour; `None` for fewer than three repetitions or equal times.
    pub per_hour: Option<Slope>,
    /// Change with each thermometer, per kelvin. Each slope is a separate fit: where temperature and time change
    /// together, the slopes do not separate their effects.
    pub per_kelvin: Vec<ThermometerSlope>,
}

/// Slope of a least-squares line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Slope {
    pub slope: f64,
    /// Standard uncertainty, from the residuals of the line (type A).
    pub u: f64,
    /// Expanded uncertainty, by the coverage factor for n − 2 degrees of freedom.
    #[serde(rename = "U")]
    pub expanded: f64,
}

impl Slope {
    /// Whether the slope differs from zero by more than its expanded uncertainty.
    pub fn is_significant(&self) -> bool {
        self.slope.abs() > self.expanded
    }
}

/// Slope of the parameter against one thermometer, per kelvin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThermometerSlope {
    pub thermometer: String,
    #[serde(flatten)]
    pub slope: Slope,
}

impl Repeatability {
    /// `None` for fewer than two repetitions.
    pub fn from_repetitions(symbol: &str, unit: Unit, repetitions: &[Repetition]) -> Option<Self> {
        let count = repetitions.len();
        if count < 2 {
            return None;
        }
        let mean = repetitions.iter().map(|one| one.value).sum::<f64>() / count as f64;
        let deviations = repetitions.iter().map(|one| one.value - mean);
        let between = (deviations.map(|one| one * one).sum::<f64>() / (count - 1) as f64).sqrt();
        let within = (repetitions.iter().map(|one| one.u * one.u).sum::<f64>() / count as f64).sqrt();
        let dof = (count - 1) as f64;
        let upper = chi_square_bounds(dof, SCATTER_INTERVAL_PROBABILITY).map_or(f64::INFINITY, |(_, upper)| upper);
        let hours = repetitions.iter().map(|one| (one.time_s / 3600.0, one.value));
        Some(Self {
            symbol: symbol.to_owned(),
            unit,
            repetitions: count,
            mean,
            within,
            between,
            ratio: between / within,
            exceeds_u: dof * between * between > upper * within * within,
            per_hour: fit_slope(&hours.collect::<Vec<_>>()),
            per_kelvin: thermometer_slopes(repetitions),
        })
    }
}

/// Slope against each thermometer that has a value in at least three repetitions.
fn thermometer_slopes(repetitions: &[Repetition]) -> Vec<ThermometerSlope> {
    let names = repetitions.iter().flat_map(|one| one.temperatures_c.iter().map(|(name, _)| name));
    let names: BTreeSet<&str> = names.collect();
    let slope_of = |name: &str| {
        let points = repetitions.iter().filter_map(|one| Some((one.temperatures_c.get(name)?, one.value)));
        let slope = fit_slope(&points.collect::<Vec<_>>())?;
        Some(ThermometerSlope { thermometer: name.to_owned(), slope })
    };
    names.into_iter().filter_map(slope_of).collect()
}

/// Slope of the least-squares line through `points` of x and y. `None`: too few points, or all x are equal.
fn fit_slope(points: &[(f64, f64)]) -> Option<Slope> {
    let count = points.len();
    if count < MIN_REPETITIONS_FOR_SLOPE {
        return None;
    }
    let mean_of = |part: fn(&(f64, f64)) -> f64| points.iter().map(part).sum::<f64>() / count as f64;
    let (mean_x, mean_y) = (mean_of(|point| point.0), mean_of(|point| point.1));
    let sum_xx: f64 = points.iter().map(|(x, _)| (x - mean_x) * (x - mean_x)).sum();
    let sum_xy: f64 = points.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    // The mean of equal numbers may differ from them in the last bit.
    if sum_xx <= (f64::EPSILON * mean_x).powi(2) * count as f64 {
        return None;
    }
    let slope = sum_xy / sum_xx;
    let residuals = points.iter().map(|(x, y)| y - mean_y - slope * (x - mean_x));
    let dof = (count - 2) as f64;
    let u = (residuals.map(|one| one * one).sum::<f64>() / dof / sum_xx).sqrt();
    Some(Slope { slope, u, expanded: coverage_factor(dof) * u })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn repetition(time_s: f64, value: f64) -> Repetition {
        Repetition { time_s, value, u: 1.0, temperatures_c: Temperatures::default() }
    }

    /// GUM (JCGM 100), table 1 and 4.4.3: the mean of 20 temperatures is 100.14 °C, their standard deviation 1.49 °C.
    #[test]
    fn paper_gum_mean_and_experimental_standard_deviation() {
        let values = [
            96.90, 98.18, 98.25, 98.61, 99.03, 99.49, 99.56, 99.74, 99.89, 100.07, 100.33, 100.42, 100.68, 100.95,
            101.11, 101.20, 101.57, 101.84, 102.36, 102.72,
        ];
        let all = values.map(|value| repetition(0.0, value));
        let found = Repeatability::from_repetitions("T", Unit::Um, &all).unwrap();
        assert!((found.mean - 100.14).abs() < 0.006 && (found.between - 1.49).abs() < 0.005, "{found:?}");
        // All at one time: no drift can be stated.
        assert_eq!((found.within, found.per_hour), (1.0, None));
        assert!((found.ratio - 1.49).abs() < 0.005);
        // By a table of χ²: 32.85 for 19 degrees of freedom at 97.5 %; 19·1.489² is 42.1.
        assert!(found.exceeds_u);
        let wider = all.map(|one| Repetition { u: 1.2, ..one });
        // 42.1/1.44 is 29.2.
        assert!(!Repeatability::from_repetitions("T", Unit::Um, &wider).unwrap().exceeds_u);
    }

    /// NIST Statistical Reference Datasets, `Norris`: certified slope 1.00211681802045, its standard deviation
    /// 0.429796848199937e-3.
    #[test]
    fn paper_nist_norris_slope_and_its_standard_deviation() {
        #[rustfmt::skip]
        let y_and_x = [
            [0.1, 0.2], [338.8, 337.4], [118.1, 118.2], [888.0, 884.6], [9.2, 10.1], [228.1, 226.5], [668.5, 666.3],
            [998.5, 996.3], [449.1, 448.6], [778.9, 777.0], [559.2, 558.2], [0.3, 0.4], [0.1, 0.6], [778.1, 775.5],
            [668.8, 666.9], [339.3, 338.0], [448.9, 447.5], [10.8, 11.6], [557.7, 556.0], [228.3, 228.1],
            [998.0, 995.8], [888.8, 887.6], [119.6, 120.2], [0.3, 0.3], [0.6, 0.3], [557.6, 556.8], [339.3, 339.1],
            [888.0, 887.2], [998.5, 999.0], [778.9, 779.0], [10.2, 11.1], [117.6, 118.3], [228.9, 229.2],
            [668.4, 669.1], [449.2, 448.9], [0.2, 0.5],
        ];
        let all = y_and_x.map(|[y, x]| Repetition {
            temperatures_c: BTreeMap::from([("table".to_owned(), x)]).into(),
            ..repetition(3600.0 * x, y)
        });
        let found = Repeatability::from_repetitions("T", Unit::Um, &all).unwrap();
        let slopes = [found.per_hour.unwrap(), found.per_kelvin[0].slope];
        for Slope { slope, u, expanded } in slopes {
            assert!((slope - 1.002_116_818_020_45).abs() < 1e-12, "{slope}");
            assert!((u - 0.429_796_848_199_937e-3).abs() < 1e-12, "{u}");
            // Student's t for 34 degrees of freedom at 95.45 %, by a table: 2.08.
            assert!((expanded / u - 2.08).abs() < 0.005, "{}", expanded / u);
        }
        assert!(slopes[0].is_significant());
    }

    #[test]
    fn slopes_need_three_repetitions_and_two_temperatures() {
        let warm = |time_s: f64, value: f64, celsius: f64| Repetition {
            temperatures_c: BTreeMap::from([("table".to_owned(), celsius)]).into(),
            ..repetition(time_s, value)
        };
        let two = [warm(0.0, 1.0, 20.1), warm(60.0, 2.0, 20.2)];
        let found = Repeatability::from_repetitions("T", Unit::Um, &two).unwrap();
        assert_eq!((found.per_hour, found.per_kelvin), (None, Vec::new()));
        let equal = [0.0, 60.0, 120.0].map(|time_s| warm(time_s, time_s, 20.1));
        let found = Repeatability::from_repetitions("T", Unit::Um, &equal).unwrap();
        assert!(found.per_hour.is_some() && found.per_kelvin.is_empty(), "{found:?}");
        assert_eq!(Repeatability::from_repetitions("T", Unit::Um, &two[..1]), None);
    }
}
