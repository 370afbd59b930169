//! What was found, for a person.

use super::fit::Fitted;
use super::observe::Observed;
use super::scan::{LEVEL, Latch, Scan, Time};
use crate::estimation::coverage::{chi_square_bounds, coverage_factor};

/// Declared scatter counts as contradicted beyond the bounds that it meets with this probability.
const DECLARED: f64 = 0.998;

/// Scatter beyond what is declared: a factor, with the scatter itself in mm.
fn too_good(observed: &Observed, fitted: &Fitted, scan: &Scan, declared_mm: f64) -> Option<f64> {
    let [slow, _] = fitted.scatter;
    // A scan's own share of the scatter is no probe's.
    let of_scan = match scan.latch {
        Latch::Scan(Time { t_s, .. }) => (observed.speeds()[0] * t_s).powi(2) / 12.0,
        _ => 0.0,
    };
    let own = slow.s_mm.powi(2) - of_scan;
    let (_, upper) = chi_square_bounds(slow.dof, DECLARED)?;
    (own * slow.dof > upper * declared_mm.powi(2)).then(|| own.sqrt())
}

pub fn warnings(
    observed: &Observed,
    fitted: &Fitted,
    scan: &Scan,
    declared_mm: Option<f64>,
) -> Vec<String> {
    let [slow, fast] = observed.feeds_mm_min;
    let [s_slow, s_fast] = fitted.scatter.map(|scatter| scatter.s_mm * 1e3);
    let test = test(scan);
    let mut lines = Vec::new();
    match scan.latch {
        Latch::Scan(Time { t_s, u_s, dof }) => {
            let (ms, expanded) = (t_s * 1e3, coverage_factor(dof) * u_s * 1e3);
            lines.push(format!(
                "the latch is read by a scan of about {ms:.1} ms (U = {expanded:.1} ms), as by a PLC's \
                 program: touches scatter by {s_slow:.2} µm at {slow} mm/min and by {s_fast:.2} µm at \
                 {fast} mm/min ({test}); each touch at {slow} mm/min is off by anything from 0 to {:.2} µm",
                observed.speeds()[0] * t_s * 1e3
            ));
        }
        Latch::Unsteady(Time { t_s, .. }) => lines.push(format!(
            "touches scatter by {s_slow:.2} µm at {slow} mm/min and by {s_fast:.2} µm at {fast} mm/min \
             ({test}), but come too early for a scan, which would have to be {:.1} ms: the machine or the \
             part shakes at that feed, or the probe is loose",
            t_s * 1e3
        )),
        Latch::Control { .. } => {}
    }
    let (delay_ms, expanded_ms) = (fitted.delay_s * 1e3, fitted.expanded_s() * 1e3);
    if delay_ms > expanded_ms {
        lines.push(format!(
            "contact is latched {delay_ms:.2} ms late: {:.2} µm at {slow} mm/min, in every direction alike, \
             as if the probe had so much more pre-travel; only touches at one feed can be compared",
            observed.speeds()[0] * delay_ms
        ));
    }
    if delay_ms < -expanded_ms {
        lines.push(format!(
            "contact is latched {:.2} ms before it comes: the control takes off too much for a delay of \
             the probe, or touches at another feed than it is told",
            -delay_ms
        ));
    }
    if let Some(declared_mm) = declared_mm
        && let Some(own) = too_good(observed, fitted, scan, declared_mm)
    {
        lines.push(format!(
            "touches scatter by {:.2} µm at {slow} mm/min; [probe] repeatability_um and the display's steps \
             explain {:.2} µm: declare more, or look for dirt, a loose stylus or part",
            own * 1e3,
            declared_mm * 1e3
        ));
    }
    if !observed.timed {
        lines
            .push("the readings carry no times (t_s): drift is fitted over their order".to_owned());
    }
    lines
}

/// `F = 840 against 4.7 at 1 %`
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
        let count = observed.touches.len();
        let [s_slow, s_fast] = fitted.scatter.map(|scatter| scatter.s_mm * 1e3);
        lines.push(format!(
            "a scan shorter than {:.2} ms: {count} touches show none and are latched in the control, as far \
             as they tell (scatter {s_slow:.2} and {s_fast:.2} µm, {})",
            longest_s * 1e3,
            test(scan)
        ));
    }
    lines
}
