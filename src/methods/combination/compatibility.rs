//! Which runs may be combined: those whose parameters are the same quantities.

use super::MeasuredRun;
use machine::record::estimate::{Estimate, Verdict};
use machine::record::machine::Machine;

/// Reason why runs are not combined. The integers are the numbers of the runs; `first` is the lowest of all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CombinationRefusal {
    #[error("a combination needs at least two runs")]
    TooFewRuns,
    #[error("run {0} is listed twice")]
    DuplicateRun(i64),
    #[error("run {run} measured the machine `{machine}`, run {first} the machine `{machine_of_first}`")]
    OtherMachine { run: i64, machine: String, first: i64, machine_of_first: String },
    #[error("run {run} has the method {method}, run {first} the method {method_of_first}")]
    OtherMethod { run: i64, method: String, first: i64, method_of_first: String },
    /// The verdict of the run is `Verdict::UndecidedModel`.
    #[error("the readings of run {0} contradict its model: no uncertainty of the run is reliable")]
    ContradictedModel(i64),
    /// Topology, axes, stylus or active compensations differ in the plans; `what` names the one that differs.
    #[error("run {run} and run {first} state {what} differently")]
    OtherStatement { run: i64, first: i64, what: &'static str },
    /// The run `holding` holds a parameter at zero that the run `estimating` estimates.
    #[error("run {holding} holds {symbol} at zero, run {estimating} estimates it")]
    HeldAtZero { holding: i64, estimating: i64, symbol: String },
    /// The gauge lines differ, or the point for which the axis positions are valid.
    #[error("the parameters of run {run} and run {first} have different conventions: {difference}")]
    OtherConventions { run: i64, first: i64, difference: String },
    /// Holds the symbol of the parameter.
    #[error("the runs have different units for {0}")]
    OtherUnit(String),
    /// Its variance is zero, or a covariance is missing or not finite.
    #[error("{symbol} of run {run} has no uncertainty")]
    NoUncertainty { run: i64, symbol: String },
    #[error("the runs have no parameter in common")]
    NoCommonParameter,
    #[error("the joint covariance of the runs is singular: the runs have no uncertainty of their own")]
    SingularCovariance,
}

impl CombinationRefusal {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::TooFewRuns | Self::DuplicateRun(_) => "give two or more different runs".to_owned(),
            Self::ContradictedModel(run) => {
                format!("read the warnings with `trued show {run}`; leave the run out, or measure again")
            }
            Self::HeldAtZero { .. } => "measure all runs with the same method parameters".to_owned(),
            Self::OtherUnit(_) => "compute new estimates with `trued identify METHOD --run RUN`".to_owned(),
            Self::NoUncertainty { .. } | Self::SingularCovariance => {
                "declare the uncertainty of probe and axes in the machine file, and measure again".to_owned()
            }
            Self::OtherMachine { .. }
            | Self::OtherMethod { .. }
            | Self::OtherStatement { .. }
            | Self::OtherConventions { .. }
            | Self::NoCommonParameter => {
                "choose runs of one machine and method with the same machine file; `trued compare RUN RUN` \
                shows the differences"
                    .to_owned()
            }
        }
    }
}

/// Maximum difference of each coordinate of two points that count as equal, mm.
const SAME_POINT_TOLERANCE_MM: f64 = 0.5;

/// Checks that `runs`, sorted by number, measure the same quantities; not that they have a parameter in common.
pub fn check_runs(runs: &[MeasuredRun<'_>]) -> Result<(), CombinationRefusal> {
    let [first, others @ ..] = runs else { return Err(CombinationRefusal::TooFewRuns) };
    if others.is_empty() {
        return Err(CombinationRefusal::TooFewRuns);
    }
    if let Some(pair) = runs.windows(2).find(|pair| pair[0].number == pair[1].number) {
        return Err(CombinationRefusal::DuplicateRun(pair[0].number));
    }
    others.iter().try_for_each(|run| check_same_machine_and_method(run, first))?;
    for run in runs {
        if run.estimate.verdict == Verdict::UndecidedModel {
            return Err(CombinationRefusal::ContradictedModel(run.number));
        }
        runs.iter().try_for_each(|other| check_held_at_zero(run, other))?;
        check_conventions(run, first)?;
        check_uncertainties(run)?;
    }
    check_units(runs)
}

/// Checks that both runs state the same machine, method, axes, stylus and compensations.
fn check_same_machine_and_method(run: &MeasuredRun<'_>, first: &MeasuredRun<'_>) -> Result<(), CombinationRefusal> {
    let (number, plan, plan_of_first) = (run.number, run.plan, first.plan);
    let (machine, machine_of_first) = (&plan.machine, &plan_of_first.machine);
    let axes = |machine: &Machine| -> Vec<_> {
        let stated = machine.axes.iter();
        stated.map(|(axis, stated)| (*axis, stated.positive, stated.point_mm, stated.direction)).collect()
    };
    if machine.name != machine_of_first.name {
        let names = (machine.name.clone(), machine_of_first.name.clone());
        let (machine, machine_of_first) = names;
        return Err(CombinationRefusal::OtherMachine { run: number, machine, first: first.number, machine_of_first });
    }
    if plan.method != plan_of_first.method {
        let (method, method_of_first) = (plan.method.clone(), plan_of_first.method.clone());
        return Err(CombinationRefusal::OtherMethod { run: number, method, first: first.number, method_of_first });
    }
    let statements = [
        ("the topology", machine.topology == machine_of_first.topology),
        ("the position, direction or sense of an axis", axes(machine) == axes(machine_of_first)),
        (
            "the stylus",
            (&plan.probe.stylus, machine.tool_mm) == (&plan_of_first.probe.stylus, machine_of_first.tool_mm),
        ),
        ("the active compensations", plan.compensations_active == plan_of_first.compensations_active),
    ];
    match statements.into_iter().find(|(_, is_same)| !is_same) {
        Some((what, _)) => Err(CombinationRefusal::OtherStatement { run: number, first: first.number, what }),
        None => Ok(()),
    }
}

/// Refuses if `holding` holds a parameter at zero that `other` estimates.
fn check_held_at_zero(holding: &MeasuredRun<'_>, other: &MeasuredRun<'_>) -> Result<(), CombinationRefusal> {
    let held = &holding.estimate.held_at_zero;
    match held.iter().find(|symbol| other.estimate.covariance.symbols.contains(symbol)) {
        Some(symbol) => Err(CombinationRefusal::HeldAtZero {
            holding: holding.number,
            estimating: other.number,
            symbol: symbol.clone(),
        }),
        None => Ok(()),
    }
}

/// A convention without the measured values that follow it.
pub fn convention_without_values(line: &str) -> &str {
    line.split(", measured [").next().unwrap_or(line)
}

/// Checks that both runs state the same conventions (measured values in them may differ), and the same point for the
/// positions of the axes.
fn check_conventions(run: &MeasuredRun<'_>, first: &MeasuredRun<'_>) -> Result<(), CombinationRefusal> {
    let other =
        |difference: String| CombinationRefusal::OtherConventions { run: run.number, first: first.number, difference };
    for (one, another) in [(run, first), (first, run)] {
        let lines = |estimate: &Estimate| -> Vec<String> {
            estimate.gauge.iter().map(|line| convention_without_values(line).to_owned()).collect()
        };
        let known = lines(another.estimate);
        if let Some(line) = lines(one.estimate).into_iter().find(|line| !known.contains(line)) {
            return Err(other(format!("only run {} states `{line}`", one.number)));
        }
    }
    let is_same_point = match (run.estimate.location_at_mm, first.estimate.location_at_mm) {
        (Some(a), Some(b)) => a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME_POINT_TOLERANCE_MM),
        (a, b) => a == b,
    };
    if is_same_point {
        Ok(())
    } else {
        Err(other("the positions of the axes are valid at different points".to_owned()))
    }
}

/// Checks that each parameter of the covariance has a positive variance and finite covariances.
fn check_uncertainties(run: &MeasuredRun<'_>) -> Result<(), CombinationRefusal> {
    let covariance = &run.estimate.covariance;
    let is_valid = |index: usize| {
        let row = covariance.rows.get(index);
        row.is_some_and(|row| row.len() == covariance.symbols.len() && row.iter().all(|entry| entry.is_finite()))
            && row.is_some_and(|row| row[index] > 0.0)
    };
    match covariance.symbols.iter().enumerate().find(|(index, _)| !is_valid(*index)) {
        Some((_, symbol)) => Err(CombinationRefusal::NoUncertainty { run: run.number, symbol: symbol.clone() }),
        None => Ok(()),
    }
}

fn check_units(runs: &[MeasuredRun<'_>]) -> Result<(), CombinationRefusal> {
    let all = || runs.iter().flat_map(|run| &run.estimate.parameters);
    match all().find(|one| all().any(|other| other.symbol == one.symbol && other.unit != one.unit)) {
        Some(parameter) => Err(CombinationRefusal::OtherUnit(parameter.symbol.clone())),
        None => Ok(()),
    }
}
