use super::*;
use crate::report::tests::example_estimate;
use machine::record::measurement_check::{Outlier, OutlierCandidate};

/// Five readings, one a minute from t = 100 s on.
fn readings(warms_k_per_min: f64) -> Vec<Reading> {
    let reading = |order: u32| -> Reading {
        let minutes = f64::from(order);
        serde_json::from_value(serde_json::json!({
            "step": order, "repeat": 0, "position": {}, "value_mm": null, "sensor": "probe",
            "t_s": 100.0 + 60.0 * minutes, "temperatures_c": {"table": 20.0 + warms_k_per_min * minutes},
        }))
        .unwrap()
    };
    (0..5).map(reading).collect()
}

/// Five touches that were measured in the order 4, 3, 2, 1, 0, one a minute from t = 100 s on.
fn estimate_with_residuals(residuals_um: &[f64]) -> Estimate {
    let check = |(id, residual_um): (usize, &f64)| MeasurementCheck {
        label: format!("touch/{id}"),
        t_s: Some(100.0 + 60.0 * (4 - id) as f64),
        residual_um: Some(*residual_um),
        min_detectable_deviation_um: None,
    };
    Estimate { measurement_checks: residuals_um.iter().enumerate().map(check).collect(), ..example_estimate() }
}

#[test]
fn residuals_are_in_the_order_of_the_readings() {
    let readings = readings(0.5);
    let mut estimate = estimate_with_residuals(&[4.0, -3.0, 2.0, -1.0, 0.5]);
    let candidate = |label: &str| OutlierCandidate { label: label.to_owned(), deviation_um: 4.0 };
    let outlier =
        |label: &str| Outlier { candidates: vec![candidate(label)], studentised_residual: 9.0, resolution: None };
    let replaced = Outlier { resolution: Some(Outlier::REPLACED.to_owned()), ..outlier("touch/1") };
    estimate.outliers = vec![outlier("touch/0"), replaced];
    let figures = residual_figures(&readings, &estimate);
    let [over_time, over_temperature] = &figures[..] else { panic!("{figures:?}") };
    assert_eq!(over_time.function.x, [0.0, 1.0, 2.0, 3.0, 4.0]);
    assert_eq!(over_temperature.function.x, [20.0, 20.5, 21.0, 21.5, 22.0]);
    for figure in &figures {
        assert_eq!(figure.function.y, [0.5, -1.0, 2.0, -3.0, 4.0]);
        assert!(figure.caption.contains("Circled"), "{}", figure.caption);
    }
    assert_eq!((&over_time.outlier_points, &over_temperature.outlier_points), (&vec![[4.0, 4.0]], &vec![[22.0, 4.0]]));
    assert!(over_time.caption.contains("measured minus modelled value, 5 measurements"));
    let values: Vec<String> = residual_figure_values(&figures).iter().map(ToString::to_string).collect();
    assert!(values[0].contains("time / min") && values[1].contains("temperature / °C"), "{values:?}");
    assert!(values.iter().all(|value| value.contains("residual / µm")));
}

#[test]
fn one_unknown_time_gives_the_order_of_the_estimate() {
    let readings = readings(0.0);
    let mut estimate = estimate_with_residuals(&[4.0, 3.0, 2.0, 1.0, 0.5]);
    let caption_of = |estimate: &Estimate| {
        let figures = residual_figures(&readings, estimate);
        // The temperature does not change.
        let [figure] = &figures[..] else { panic!("{figures:?}") };
        (figure.function.x.clone(), figure.caption.clone())
    };
    let (x, caption) = caption_of(&estimate);
    assert!(x[4] == 4.0 && caption.contains("length of the vector") && !caption.contains("Circled"), "{caption}");
    estimate.measurement_checks[3].t_s = None;
    let (x, caption) = caption_of(&estimate);
    assert_eq!(x, [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(caption.contains("over the number of the measurement"), "{caption}");
    estimate.measurement_checks.iter_mut().for_each(|check| check.residual_um = None);
    assert!(residual_figures(&readings, &estimate).is_empty());
}

#[test]
fn temperature_is_that_of_the_nearest_reading() {
    let by_time = [(0.0, 20.0), (10.0, 21.0), (30.0, 22.0)];
    let expected = [(-5.0, 20.0), (4.0, 20.0), (6.0, 21.0), (10.0, 21.0), (19.0, 21.0), (21.0, 22.0), (99.0, 22.0)];
    for (t_s, celsius) in expected {
        assert_eq!(nearest_value(&by_time, t_s), Some(celsius), "at {t_s} s");
    }
    assert_eq!(nearest_value(&[], 1.0), None);
}
