//! `trued identify`: readings from anywhere to an estimate.

use super::args::IdentifyArgs;
use super::failure::Failure;
use super::run::read_estimate;
use super::{Exit, show};
use crate::decision;
use crate::methods;
use crate::record::plan::{PLAN_VERSION, Plan};
use crate::report::readings_csv;
use crate::setup;

pub fn identify(args: &IdentifyArgs) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref())?;
    let (method, plan) = match &args.plan {
        Some(file) => read_plan(file, &args.method)?,
        None => {
            let (method, header) = setup::header(&machine, &args.method, None)?;
            let plan = super::plan::nominal(method.as_ref(), header)?;
            (method, plan)
        }
    };
    let bytes =
        std::fs::read(&args.readings).map_err(|error| Failure::file(&args.readings, &error))?;
    let readings = readings_csv::read(&bytes)
        .map_err(|error| Failure::plain(format!("{}: {error}", args.readings.display())))?;
    let priors = args.with.iter().map(|file| read_estimate(file)).collect::<Result<Vec<_>, _>>()?;
    let mut estimate = method.identify(&plan, &readings, &priors)?;
    estimate.verdict = decision::judge(&estimate, &machine.tolerance);
    if args.json {
        show::print_json(&estimate)?;
    } else {
        show::print_estimate(&estimate);
    }
    Ok(estimate.verdict.into())
}

fn read_plan(
    file: &std::path::Path,
    method: &str,
) -> Result<(Box<dyn methods::Method>, Plan), Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| Failure::file(file, &error))?;
    let wrong = |why: String| {
        Failure::new(
            format!("{}: {why}", file.display()),
            "a plan as `trued plan --json` prints it is expected",
        )
    };
    let plan: Plan = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
    if plan.trued_plan != PLAN_VERSION {
        return Err(wrong(format!("plan version {} is not {PLAN_VERSION}", plan.trued_plan)));
    }
    if plan.method != method {
        return Err(wrong(format!("it is a plan of `{}`, not of `{method}`", plan.method)));
    }
    let settings = methods::configure(method, plan.settings.clone())
        .map_err(|error| wrong(format!("settings: {error}")))?;
    Ok((settings, plan))
}
