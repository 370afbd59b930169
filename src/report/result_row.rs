//! One result as all outputs display it: page, report, terminal and results file.

use serde::Serialize;

use super::number::{decimals_for_uncertainty, format_fixed, one_line_symbol, split_into_base_and_index};
use machine::record::estimate::{Estimate, LimitVerdict, Parameter, Unit, Verdict};
use methods::decision::undecided::{DecidingChange, deciding_change};
use methods::named_symbol::named_symbol;
use methods::symbol_names::{NamedSymbol, ResultGroup};

/// Maximum number of results in large type.
const MAX_HEADLINE_RESULTS: usize = 6;

/// A parameter with its texts. Value, u, U and interval have the decimals that give U two significant digits (GUM
/// 7.2.6), a true minus sign and the unit of the estimate; a dash if the parameter is not identifiable.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResultRow {
    /// Symbol as in the estimate, such as `EX0C`.
    #[serde(rename = "plain")]
    pub symbol: String,
    /// Symbol on one line, such as `E_X0C`.
    pub one_line_symbol: String,
    /// Base of the symbol, such as `E` of `EX0C`.
    pub base: String,
    /// Subscript of the symbol, such as `X0C` of `EX0C`.
    pub index: String,
    /// The quantity in plain words; empty if the symbol needs none.
    pub name: String,
    pub group: ResultGroup,
    pub identifiable: bool,
    pub value: String,
    /// Standard uncertainty.
    pub u: String,
    /// Expanded uncertainty U = k·u.
    pub expanded: String,
    /// Coverage factor.
    pub k: String,
    /// Effective degrees of freedom of u; `> 1000` and `∞` are possible.
    pub dof: String,
    /// Shortest Monte Carlo interval with the coverage probability of k, as `a to b`.
    pub interval: Option<String>,
    pub unit: &'static str,
    /// Limit of |value|, with sign and without unit: `±10`.
    pub limit: Option<String>,
    /// `None`: no limit applies.
    pub verdict: Option<Verdict>,
    /// Word for the verdict, such as `PASS`, `FAIL` or `UNDECIDED (model)`.
    pub verdict_word: Option<&'static str>,
    /// Probability of conformity, with its unit.
    pub conformance: Option<String>,
    /// CSS class of the verdict in page and report.
    pub verdict_class: &'static str,
    /// The result on one line: `E_Y0C −30.2 µm, U 1.0 µm, limit ±10 µm: FAIL (position of C in Y)`.
    pub sentence: String,
    /// What would decide an undecided result, as a sentence without a full stop.
    pub decided_by: Option<String>,
    /// |value| divided by the limit.
    #[serde(skip)]
    pub limit_share: Option<f64>,
}

/// Context of the parameters of an estimate.
#[derive(Debug, Clone, Copy)]
pub struct RunContext<'a> {
    pub method: &'a str,
    /// Time from the first to the last reading, s, if the estimate contains it.
    pub first_to_last_reading_s: Option<f64>,
}

impl<'a> RunContext<'a> {
    pub fn from_estimate(estimate: &'a Estimate) -> Self {
        let first_to_last_reading_s = estimate.provenance.as_ref().map(|provenance| provenance.duration_s);
        Self { method: &estimate.method, first_to_last_reading_s }
    }
}

impl ResultRow {
    pub fn new(context: RunContext<'_>, parameter: &Parameter) -> Self {
        let Parameter { symbol, value, unit, u, expanded, k, dof, identifiable, judged, .. } = parameter;
        let decimals = decimals_for_uncertainty(*expanded);
        let number = |value: f64| format_fixed(value, decimals);
        let (base, index) = split_into_base_and_index(symbol);
        let NamedSymbol { name, group } = named_symbol(context.method, symbol)
            .unwrap_or_else(|| NamedSymbol { name: String::new(), group: ResultGroup::Main });
        let mut row = Self {
            symbol: symbol.clone(),
            one_line_symbol: one_line_symbol(symbol),
            base,
            index,
            name,
            group,
            identifiable: *identifiable,
            value: number(*value),
            u: number(*u),
            expanded: number(*expanded),
            k: format_fixed(*k, 2),
            dof: format_degrees_of_freedom(*dof),
            interval: parameter.interval_monte_carlo.map(|ends| ends.map(number).join(" to ")),
            unit: unit.symbol(),
            limit: judged.map(|judged| format_plus_minus_limit(judged.limit)),
            verdict: judged.map(|judged| judged.verdict),
            verdict_word: judged.map(|judged| verdict_word(judged.verdict)),
            verdict_class: verdict_class(judged.map_or(Verdict::None, |judged| judged.verdict)),
            conformance: judged.and_then(|judged| judged.conformance).map(format_percent),
            decided_by: deciding_change(parameter).map(|change| describe_deciding_change(&change, *unit, context)),
            sentence: String::new(),
            limit_share: judged.map(|LimitVerdict { limit, .. }| value.abs() / limit),
        };
        row.sentence = row.to_sentence();
        row
    }

    fn to_sentence(&self) -> String {
        let Self { one_line_symbol, value, unit, expanded, name, .. } = self;
        let measured = match self.identifiable {
            true => format!("{value} {unit}, U {expanded} {unit}"),
            false => "not identifiable".to_owned(),
        };
        let judged = self.limit.iter().zip(self.verdict_word);
        let judged: String = judged.map(|(limit, word)| format!(", limit {limit} {unit}: {word}")).collect();
        let name = if name.is_empty() { String::new() } else { format!(" ({name})") };
        format!("{one_line_symbol} {measured}{judged}{name}")
    }

    /// Whether a limit applies that the result does not meet with certainty.
    fn has_not_passed(&self) -> bool {
        self.verdict.is_some_and(|verdict| verdict != Verdict::Pass)
    }

    /// 0 is the worst verdict, 4 no verdict.
    fn severity(&self) -> u8 {
        match self.verdict {
            Some(Verdict::Fail) => 0,
            Some(Verdict::UndecidedModel) => 1,
            Some(Verdict::Undecided) => 2,
            Some(Verdict::Pass) => 3,
            Some(Verdict::None) | None => 4,
        }
    }
}

/// Rows in the order of the estimate.
pub fn result_rows(context: RunContext<'_>, parameters: &[Parameter]) -> Vec<ResultRow> {
    parameters.iter().map(|parameter| ResultRow::new(context, parameter)).collect()
}

/// Rows for an overview: the results with a limit, worst first (by verdict, then by |value| divided by the limit),
/// then the identifiable ones of the group [`ResultGroup::Main`] in the order of the estimate, which begins with the
/// main results of the method.
fn overview_rows_worst_first(rows: &[ResultRow]) -> Vec<&ResultRow> {
    let is_listed = |row: &&ResultRow| row.verdict.is_some() || (row.group == ResultGroup::Main && row.identifiable);
    let mut listed: Vec<&ResultRow> = rows.iter().filter(is_listed).collect();
    listed.sort_by(|one, other| {
        let share = |row: &ResultRow| row.limit_share.unwrap_or(0.0);
        one.severity().cmp(&other.severity()).then(share(other).total_cmp(&share(one)))
    });
    listed
}

/// Rows that have not passed, worst first.
pub fn rows_not_passed(rows: &[ResultRow]) -> Vec<&ResultRow> {
    overview_rows_worst_first(rows).into_iter().filter(|row| row.has_not_passed()).collect()
}

/// Rows in large type: those with a limit, worst first, or the main results if there is no limit; at most
/// [`MAX_HEADLINE_RESULTS`].
pub fn headline_rows(rows: &[ResultRow]) -> Vec<&ResultRow> {
    let is_judged = rows.iter().any(|row| row.verdict.is_some());
    let worst = overview_rows_worst_first(rows).into_iter().filter(|row| row.verdict.is_some() == is_judged);
    worst.take(MAX_HEADLINE_RESULTS).collect()
}

pub fn verdict_word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "PASS",
        Verdict::Fail => "FAIL",
        Verdict::Undecided => "UNDECIDED",
        Verdict::UndecidedModel => "UNDECIDED (model)",
        Verdict::None => "not judged",
    }
}

/// CSS class of a verdict in page and report.
pub fn verdict_class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "pass",
        Verdict::Fail => "fail",
        Verdict::Undecided | Verdict::UndecidedModel => "undecided",
        Verdict::None => "none",
    }
}

/// Verdict of a whole run as a text that needs no context.
pub fn verdict_sentence(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "in tolerance, with the uncertainty included",
        Verdict::Fail => "out of tolerance by more than the uncertainty",
        Verdict::Undecided => "a limit is within the uncertainty, or a result with a limit is missing",
        Verdict::UndecidedModel => "the readings contradict the model or the declared data; each U is a lower bound",
        Verdict::None => "the machine file states no tolerance",
    }
}

/// The shortest text of a limit, with both signs.
pub fn format_plus_minus_limit(limit: f64) -> String {
    format!("±{limit}")
}

/// Larger finite degrees of freedom are displayed as "> 1000", because the exact number has no effect.
const MAX_SHOWN_DEGREES_OF_FREEDOM: f64 = 1000.0;

/// Text of the degrees of freedom; `None` is infinite.
pub fn format_degrees_of_freedom(dof: Option<f64>) -> String {
    match dof {
        Some(dof) if dof <= MAX_SHOWN_DEGREES_OF_FREEDOM => format_fixed(dof, 1),
        Some(dof) if dof.is_finite() => format!("> {MAX_SHOWN_DEGREES_OF_FREEDOM}"),
        _ => "∞".to_owned(),
    }
}

fn format_percent(probability: f64) -> String {
    format!("{} %", format_fixed(100.0 * probability, 1))
}

fn describe_deciding_change(change: &DecidingChange, unit: Unit, context: RunContext<'_>) -> String {
    match change {
        DecidingChange::Runs(runs) => {
            let time = context.first_to_last_reading_s.map_or(String::new(), |one_s| {
                format!(" (about {:.0} minutes)", (f64::from(*runs) * one_s / 60.0).ceil())
            });
            format!("the mean of {runs} runs of this kind{time} would decide the verdict, if the value stays the same")
        }
        DecidingChange::TooManyRuns => {
            "the value is too close to the limit: more runs do not decide the verdict".to_owned()
        }
        DecidingChange::SmallerSources { expanded, largest } => {
            let expanded = format_fixed(*expanded, decimals_for_uncertainty(*expanded));
            format!(
                "more runs do not decide the verdict: U stays at least {expanded} {}. Largest source: {largest}",
                unit.symbol()
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(symbol: &str, value: f64, expanded: f64, limit: Option<(f64, Verdict)>) -> Parameter {
        let judged = limit.map(|(limit, verdict)| LimitVerdict { limit, verdict, conformance: Some(0.25) });
        Parameter {
            symbol: symbol.to_owned(),
            value,
            unit: Unit::Um,
            u: expanded / 2.0,
            expanded,
            k: 2.0,
            dof: None,
            identifiable: true,
            u_monte_carlo: None,
            interval_monte_carlo: None,
            budget: Vec::new(),
            judged,
        }
    }

    const CONTEXT: RunContext<'static> =
        RunContext { method: "self-calibration", first_to_last_reading_s: Some(600.0) };

    #[test]
    fn one_line_contains_value_u_limit_and_verdict() {
        let row = ResultRow::new(CONTEXT, &parameter("EY0C", -30.22, 1.04, Some((10.0, Verdict::Fail))));
        assert_eq!(row.sentence, "E_Y0C −30.2 µm, U 1.0 µm, limit ±10 µm: FAIL (position of C in Y)");
        assert_eq!((row.name.as_str(), row.conformance.as_deref()), ("position of C in Y", Some("25.0 %")));
        let row = ResultRow::new(CONTEXT, &parameter("EX0C_lsc", 12.0, 0.0004, None));
        let name = "position of C in X: by the least-squares circle (ISO 230-7), not by the mean";
        assert_eq!(row.sentence, format!("E_X0C,lsc 12.00000 µm, U 0.00040 µm ({name})"));
        let lost = Parameter { identifiable: false, ..parameter("EX0C", f64::NAN, f64::NAN, None) };
        assert_eq!(ResultRow::new(CONTEXT, &lost).sentence, "E_X0C not identifiable (position of C in X)");
    }

    #[test]
    fn failing_results_come_first_then_the_largest_share_of_the_limit() {
        let parameters = [
            parameter("EX0C", 1.0, 0.1, Some((10.0, Verdict::Pass))),
            parameter("tool_x", 1.0, 0.1, None),
            parameter("EXC_range", 1.0, 0.1, None),
            parameter("EY0C", 9.0, 0.1, Some((10.0, Verdict::Pass))),
            parameter("EA0C", 10.0, 0.1, Some((10.0, Verdict::Undecided))),
            parameter("EB0C", 20.0, 0.1, Some((10.0, Verdict::Fail))),
        ];
        let rows = result_rows(CONTEXT, &parameters);
        let symbols: Vec<&str> = overview_rows_worst_first(&rows).iter().map(|row| row.symbol.as_str()).collect();
        assert_eq!(symbols, ["EB0C", "EA0C", "EY0C", "EX0C", "EXC_range"]);
    }

    #[test]
    fn degrees_of_freedom_are_readable() {
        assert_eq!(format_degrees_of_freedom(Some(10.04)), "10.0");
        assert_eq!(format_degrees_of_freedom(Some(7_083_368.2)), "> 1000");
        assert_eq!(format_degrees_of_freedom(None), "∞");
    }
}
