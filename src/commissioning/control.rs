//! Part 2: who is there, and does it say of itself what the machine file says of it?

use std::time::Instant;

use super::{Check, Ended, Part, compare, links};
use crate::controllers::ControllerError;

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let may_move = introduce(check).await?;
    prepare(check).await?;
    // Where its positions are not what they seem, a small jog may go anywhere.
    if may_move { Ok(()) } else { Err(Ended::Unsafe) }
}

/// What it says of itself, and whether it may move so. One that says nothing is told by what follows.
async fn introduce(check: &mut Check<'_>) -> Result<bool, Ended> {
    let since = Instant::now();
    let says = match check.controller()?.introduce().await {
        Ok(says) => says,
        Err(error) => {
            check.go_on()?;
            let why = format!("travel, speeds and axes: the control does not say them ({error})");
            check.not_looked_at(Part::Control, why);
            return Ok(true);
        }
    };
    check.summary.control = Some(says.identity.clone());
    check.polarity.clone_from(&says.polarity);
    let differs = compare::differences(&check.file.machine, &says);
    if differs.is_empty() && !says.axes.is_empty() {
        let told = says.axes.values().any(|axis| axis.rapid_per_min.is_some());
        let suits = if told {
            "travel, speeds and axes suit the machine file"
        } else {
            "axes suit the machine file; their travel and speeds it does not tell"
        };
        let what = format!("{}: {suits}", says.identity);
        check.well(Part::Control, since, what);
    }
    for (what, remedy) in differs {
        check.failed(Part::Control, since, what, remedy);
    }
    let may_move = !says.remarks.iter().any(|remark| remark.hinders);
    for remark in says.remarks {
        if remark.hinders {
            check.failed(Part::Control, since, remark.what, remark.remedy);
        } else {
            check.well(Part::Control, since, format!("{} ({})", remark.what, remark.remedy));
        }
    }
    check.go_on()?;
    Ok(may_move)
}

/// Make it ready. A probe that reads closed is left to the next part.
pub(super) async fn prepare(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    match check.controller()?.prepare().await {
        Ok(prepared) => {
            let stands = prepared.stands.iter();
            let stands = stands.map(|(axis, at)| format!("{axis} {:.3}", axis.to_edge(at)));
            let stands = stands.collect::<Vec<_>>().join(" ");
            let what = format!(
                "ready; it stands at {stands} (its display must show the same); how it stops: {}",
                prepared.stop
            );
            check.summary.control = Some(prepared.identity);
            check.stands = Some(prepared.stands);
            check.well(Part::Control, since, what);
            Ok(())
        }
        Err(ControllerError::ProbeClosed) if check.stands.is_none() => Ok(()),
        Err(error) => {
            check.go_on()?;
            links::why(check, Part::Control, since, &error).await?;
            Err(Ended::Unsafe)
        }
    }
}
