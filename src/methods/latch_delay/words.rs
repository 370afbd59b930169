//! Texts of the results for the operator.

use super::fit::Fitted;
use super::observe::Observed;
use super::scan::{LEVEL, Latch, Scan, Time};
use estimation::coverage::chi_square_bounds;

/// Probability with which the declared scatter meets its bounds. Outside of them it counts as contradicted.
const DECLARED: f64 = 0.998;

/// Largest scatter of the slow touches that `declared_mm` and a scan explain, mm.
pub fn scatter_bound_mm(
    observed: &Observed,
    fitted: &Fitted,
    scan: &Scan,
    declared_mm: f64,
) -> Option<f64> {
    let [slow, _] = fitted.scatter;
    let explained = match scan.latch {
        // With the upper bound of the scan duration.
        Latch::Scan(time) => {
            declared_mm.powi(2) + (observed.speeds()[0] * time.most_s()).powi(2) / 12.0
        }
        _ => declared_mm.powi(2),
    };
    let (_, upper) = chi_square_bounds(slow.dof, DECLARED)?;
    Some((upper * explained / slow.dof).sqrt())
}

/// Text on the location of the latch.
pub fn of_latch(observed: &Observed, fitted: &Fitted, scan: &Scan) -> String {
    let [slow, fast] = observed.feeds_mm_min;
    let [s_slow, s_fast] = fitted.scatter.map(|scatter| scatter.s_mm * 1e3);
    let seen = format!(
        "touches scatter by {s_slow:.2} µm at {slow} mm/min and by {s_fast:.2} µm at {fast} mm/min ({})",
        test(scan)
    );
    match scan.latch {
        Latch::Control { longest_s } => format!(
            "latched in the control: {} touches show no scan longer than {:.2} ms; {seen}",
            observed.touches.len(),
            longest_s * 1e3
        ),
        Latch::Scan(time) => format!(
            "the latch is read by a scan of about {:.1} ms (U = {:.1} ms), as by a PLC's program: {seen}; \
             each touch at {slow} mm/min is off by anything from 0 to {:.2} µm",
            time.t_s * 1e3,
            time.expanded_s() * 1e3,
            observed.speeds()[0] * time.t_s * 1e3
        ),
        Latch::Unsteady(Time { t_s, .. }) => format!(
            "{seen}, but come too early for a scan, which would have to be {:.1} ms: the machine or the \
             part shakes at that feed, or the probe is loose",
            t_s * 1e3
        ),
    }
}

/// Text on a delay that exceeds its uncertainty.
pub fn of_delay(observed: &Observed, fitted: &Fitted) -> Option<String> {
    let [slow, _] = observed.feeds_mm_min;
    let (delay_ms, expanded_ms) = (fitted.delay_s * 1e3, fitted.delay_uncertainty.expanded() * 1e3);
    if delay_ms > expanded_ms {
        Some(format!(
            "contact is latched {delay_ms:.2} ms late (U = {expanded_ms:.2} ms): {:.2} µm at {slow} \
             mm/min, in every direction alike, as if the probe had so much more pre-travel; only touches \
             at one feed can be compared",
            observed.speeds()[0] * delay_ms
        ))
    } else if delay_ms < -expanded_ms {
        Some(format!(
            "contact is latched {:.2} ms before it comes (U = {expanded_ms:.2} ms): the control takes off \
             too much for a delay of the probe, or moves at another feed than it is told",
            -delay_ms
        ))
    } else {
        None
    }
}

/// Text on touches that scatter more than declared.
pub fn of_scatter(
    observed: &Observed,
    fitted: &Fitted,
    scan: &Scan,
    declared_mm: Option<f64>,
) -> Option<String> {
    let mm = declared_mm?;
    let bound_mm = scatter_bound_mm(observed, fitted, scan, mm)?;
    if fitted.scatter[0].s_mm <= bound_mm {
        return None;
    }
    Some(format!(
        "touches scatter by {:.2} µm at {} mm/min; [probe] repeatability_um and the display's steps \
         explain {:.2} µm: declare more, or look for dirt, a loose stylus or part",
        fitted.scatter[0].s_mm * 1e3,
        observed.feeds_mm_min[0],
        mm * 1e3
    ))
}

pub fn warnings(
    observed: &Observed,
    fitted: &Fitted,
    scan: &Scan,
    declared_mm: Option<f64>,
) -> Vec<String> {
    let is_sound = matches!(scan.latch, Latch::Control { .. });
    let of_latch = (!is_sound).then(|| of_latch(observed, fitted, scan));
    let of_scatter = of_scatter(observed, fitted, scan, declared_mm);
    let timeless =
        || "the readings carry no times (t_s): drift is fitted over their order".to_owned();
    let lines = [of_latch, of_delay(observed, fitted), of_scatter];
    lines.into_iter().flatten().chain((!observed.timed).then(timeless)).collect()
}

/// Text such as `F = 840 against 4.7 at 1 %`.
fn test(scan: &Scan) -> String {
    format!("F = {:.1} against {:.1} at {} %", scan.ratio, scan.limit, LEVEL * 100.0)
}

pub fn conventions(observed: &Observed, fitted: &Fitted) -> Vec<String> {
    let [slow, fast] = observed.feeds_mm_min;
    vec![
        "positive: latched after contact, farther along the touch".to_owned(),
        format!(
            "s_{slow}, s_{fast}: experimental standard deviation of a touch at that feed in mm/min; \
             uncertainties follow from it, whatever is declared"
        ),
        format!(
            "a linear drift is fitted and removed ({:.2} µm/min along the touch); the order slow, fast, \
             fast, slow keeps it from the delay",
            fitted.drift_mm_s * 60e3
        ),
        "the axes go as fast as commanded: with the feed override elsewhere than at 100 % all times are \
         off in proportion"
            .to_owned(),
        format!("all touches begin at one place, about {:.2} mm before contact", observed.way_mm),
    ]
}

pub fn cannot_know(observed: &Observed, fitted: &Fitted, scan: &Scan) -> Vec<String> {
    let mut lines = vec![
        "whose a delay is that is always the same: the probe's filter or radio link, the control, and, \
         where a control latches commanded positions, the lag of the axes behind them act alike"
            .to_owned(),
        "a scan that stands still against the touches, so that each falls at the same moment of it: it \
         is a delay like any other"
            .to_owned(),
    ];
    if let Latch::Control { longest_s } = scan.latch {
        let seen = of_latch(observed, fitted, scan);
        lines.push(format!("a scan shorter than {:.2} ms: {seen}", longest_s * 1e3));
    }
    lines
}
