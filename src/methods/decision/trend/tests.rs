use rand_distr::{Distribution, StandardNormal};

use super::*;
use estimation::random::seeded_stream;

/// Flow rate of ten batches, the example of NIST/SEMATECH e-Handbook, 6.3.2.2.
const FLOW_RATES: [f64; 10] = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1];

#[test]
fn paper_nist_individuals_chart_is_reproduced() {
    let chart = IndividualsChart::from_values(&FLOW_RATES).unwrap();
    let [lower, upper] = chart.control_limits();
    assert!((chart.centre - 50.81).abs() < 1e-9);
    assert!((upper - 55.8041).abs() < 5e-5 && (lower - 45.8159).abs() < 5e-5, "{lower} {upper}");
}

/// Example of NIST/SEMATECH e-Handbook, 6.3.2.4, with its centre of 50, s = 2.0539 and λ = 0.3.
#[test]
fn paper_nist_ewma_chart_is_reproduced() {
    let first = [52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5];
    let values: Vec<f64> = first.into_iter().chain(FLOW_RATES).collect();
    let published = [
        50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33, 50.11, 49.36, 49.52, 50.05, 49.38, 49.92,
        50.73, 51.23, 51.94, 51.99,
    ];
    let ewma = EwmaChart::from_values(&values, 50.0, 2.0539);
    for (mean, published) in ewma.means.iter().zip(published) {
        assert!((mean - published).abs() < 0.0051, "{mean} {published}");
    }
    // The UCL of 52.5884 is the limit for many values; after 20 values the limits have settled.
    assert!((ewma.widths[19] - 2.5884).abs() < 5e-4 && !ewma.is_newest_mean_outside_limits());
    // The limits of the first mean are 0.3 times those of one value.
    assert!((ewma.widths[0] - 3.0 * 0.3 * 2.0539).abs() < 1e-12);
}

fn day_to_s(day: f64) -> f64 {
    day * 86_400.0
}

fn day_name(t_s: f64) -> String {
    format!("day {:.0}", t_s / 86_400.0)
}

/// A series of one run per day with a scatter of 1.
fn daily_series(seed: u64, days: usize, truth: impl Fn(f64) -> f64) -> Vec<TrendPoint> {
    let mut rng = seeded_stream(seed, &[7]);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    (0..days).map(|i| TrendPoint { measurement_time_s: day_to_s(i as f64), value: truth(i as f64) + draw() }).collect()
}

#[test]
fn stable_machine_gives_no_change() {
    let false_alarms = (0..2000)
        .filter(|seed| !Trend::from_points(daily_series(*seed, 6 + *seed as usize % 60, |_| 3.0)).changes.is_empty())
        .count();
    // False alarms have a probability of 1 in 1000: 2 of 2000 on average; 8 or more with a probability of 0.1
    // %.
    assert!(false_alarms < 8, "{false_alarms}");
    // No change is reported for identical values either, even if their mean is rounded.
    for value in [1.5, 49.504_871_3, -13.8, 0.0] {
        for count in 9..20 {
            let points = (0..count).map(|i| TrendPoint { measurement_time_s: day_to_s(f64::from(i)), value });
            let same = Trend::from_points(points.collect());
            assert!(
                same.changes.is_empty() && same.is_newest_value_outside_limits() == Some(false),
                "{count} of {value}"
            );
        }
    }
}

/// The height of a step lies within U, and its day within the reported interval, as often as stated.
#[test]
fn step_is_found_with_its_time_and_size() {
    let (mut found, mut height, mut when) = (0, 0, 0);
    let seeds = 60;
    for seed in 0..seeds {
        let trend = Trend::from_points(daily_series(seed, 40, |day| if day < 25.0 { 3.0 } else { 6.5 }));
        let Some(change) = trend.changes.first().filter(|change| change.kind == ChangeKind::Step) else {
            continue;
        };
        found += 1;
        height += usize::from((change.by - 3.5).abs() <= change.expanded);
        when += usize::from(change.between[0] <= 24 && change.between[1] >= 25);
    }
    assert!(found >= seeds - 1, "{found}");
    // 95 % of 60, minus three standard deviations.
    assert!(height >= 52 && when >= 52, "{height} {when}");
}

#[test]
fn drift_is_found_with_its_start_and_slope() {
    let (mut found, mut slope, mut when) = (0, 0, 0);
    let seeds = 60;
    for seed in 0..seeds {
        let trend = Trend::from_points(daily_series(seed, 60, |day| 0.25 * (day - 30.0f64).max(0.0)));
        let Some(change) = trend.changes.first().filter(|change| change.kind == ChangeKind::Drift) else {
            continue;
        };
        found += 1;
        slope += usize::from((change.by - 0.25).abs() <= change.expanded);
        when += usize::from(change.between[0] <= 30 && change.between[1] >= 30);
    }
    assert!(found >= 57, "{found}");
    assert!(when >= 50, "{when}");
    // The position of the bend is fitted as well and is not in U, so slightly fewer slopes lie within U.
    assert!(slope >= 45, "{slope}");
}

/// After a step the limits come from the values since the step.
#[test]
fn limits_follow_a_step_and_apply_to_the_newest_value() {
    let stepped = |last: f64| {
        let mut points = daily_series(3, 40, |day| if day < 20.0 { 0.0 } else { 10.0 });
        points.push(TrendPoint { measurement_time_s: day_to_s(40.0), value: last });
        Trend::from_points(points)
    };
    let trend = stepped(10.0);
    assert_eq!(trend.changes.len(), 1);
    assert_eq!(trend.changes[0].first, 20);
    assert!((trend.individuals.unwrap().centre - 10.0).abs() < 1.0);
    assert_eq!(trend.is_newest_value_outside_limits(), Some(false));
    assert_eq!(stepped(16.0).is_newest_value_outside_limits(), Some(true));
    assert_eq!(Trend::from_points(daily_series(1, 8, |_| 0.0)).is_newest_value_outside_limits(), None);
}

#[test]
fn change_is_described_in_one_sentence() {
    let step = Trend::from_points(daily_series(1, 40, |day| if day < 33.0 { 0.0 } else { 8.0 }));
    let drift = Trend::from_points(daily_series(2, 40, |day| 0.4 * day));
    let same = Trend::from_points(daily_series(3, 40, |_| 0.0));
    let few = Trend::from_points(daily_series(4, 40, |_| 0.0).split_off(37));
    let named = |symbol, trend| NamedTrend { symbol, unit: "µm", trend };
    let all = [named("EX0C", &step), named("EY0C", &drift), named("EA0B", &same), named("EB0B", &few)];
    assert_eq!(
        describe_changes(&all, day_to_s(30.0), day_name),
        "Since day 30: EX0C changed by +8.5 µm (U 0.8 µm), between day 32 and day 33; \
         EY0C drifts by +0.39 µm a day (U 0.03 µm), since the first run; the other value did not change; \
         fewer than 6 runs of EB0B, too few for a trend."
    );
    assert_eq!(
        describe_changes(&[named("EA0B", &same)], day_to_s(30.0), day_name),
        "Since day 30: no change beyond the scatter."
    );
    // The step is older than the given time.
    assert_eq!(
        describe_changes(&[named("EX0C", &step)], day_to_s(39.0), day_name),
        "Since day 39: no change beyond the scatter."
    );
}

/// A value without a new measurement does not count as unchanged.
#[test]
fn values_not_measured_since_the_given_time_are_listed() {
    let same = Trend::from_points(daily_series(3, 40, |_| 0.0));
    let newer = Trend::from_points(daily_series(3, 60, |_| 0.0));
    let drift = Trend::from_points(daily_series(2, 40, |day| 0.4 * day));
    let named = |symbol, trend| NamedTrend { symbol, unit: "µm", trend };
    assert_eq!(
        describe_changes(&[named("EA0B", &same)], day_to_s(50.0), day_name),
        "Since day 50: no run; the newest values are from day 39."
    );
    assert_eq!(
        describe_changes(&[named("EA0B", &same), named("EB0B", &newer)], day_to_s(50.0), day_name),
        "Since day 50: no new value of EA0B, the newest value is from day 39; no change beyond the scatter."
    );
    let drifts = describe_changes(&[named("EA0B", &same), named("EY0C", &drift)], day_to_s(50.0), day_name);
    let words = "Since day 50: no run; the newest values are from day 39; EY0C drifts by ";
    assert!(drifts.starts_with(words) && !drifts.contains("did not change"), "{drifts}");
}

/// Thirteen runs; the newest has a clock time of 1970 and a value that is 400 µm off. It remains the newest
/// run, its value lies outside the limits, and the limits are those of the twelve runs before it.
#[test]
fn values_are_kept_when_the_clock_was_set_back() {
    let mut points = daily_series(5, 12, |day| 3.0 + 0.0 * day);
    points.iter_mut().for_each(|point| point.measurement_time_s += day_to_s(20_000.0));
    let before = Trend::from_points([points.clone(), vec![points[11]]].concat());
    points.push(TrendPoint { measurement_time_s: 60.0, value: 403.0 });
    let trend = Trend::from_points(points);
    assert_eq!(trend.points[12].value, 403.0);
    assert_eq!(trend.is_newest_value_outside_limits(), Some(true));
    assert_eq!(trend.individuals, before.individuals);
    assert!(trend.points.windows(2).all(|pair| pair[0].measurement_time_s <= pair[1].measurement_time_s));
    let named = NamedTrend { symbol: "EX0C", unit: "µm", trend: &trend };
    let words = describe_changes(&[named], day_to_s(20_000.0), day_name);
    assert!(words.contains("the newest EX0C, 403.0 µm, is outside"), "{words}");
}
