//! HTTP schemas of types of lower layers, which do not depend on HTTP. A test compares each schema with the
//! program's output. Formats with their own contract and version (plan, reading, estimate, series) are not
//! described a second time.
#![allow(dead_code, reason = "only their schemas are used")]

use utoipa::ToSchema;

/// Object of the format that README.md describes.
#[derive(ToSchema)]
#[schema(value_type = Object)]
pub struct DocumentedObject(());

/// One value of one method over its newest 200 finished runs.
#[derive(ToSchema)]
#[schema(value_type = Object)]
pub struct SeriesView(());

/// Schedule of a machine: `planned`, `armed`, `last`, as docs/schedule.md describes them.
#[derive(ToSchema)]
#[schema(as = Agenda, value_type = Object)]
pub struct AgendaSchema(());

#[derive(ToSchema)]
#[schema(as = Signature)]
pub struct SignatureSchema {
    who: String,
    remark: String,
    estimate_sha256: String,
}

#[derive(ToSchema)]
#[schema(as = Verdict, rename_all = "lowercase")]
pub enum VerdictSchema {
    Pass,
    Fail,
    Undecided,
    /// The readings contradict the model or the declared uncertainties.
    #[schema(rename = "undecided (model)")]
    UndecidedModel,
    /// Measured; no tolerance is stated.
    None,
}

#[derive(ToSchema)]
#[schema(as = Parameter)]
pub struct ParameterSchema {
    symbol: String,
    value: f64,
    /// Unit: um, urad, um/m, mm or ms.
    unit: String,
    /// Standard uncertainty, in the unit of the value.
    u: f64,
    /// Expanded uncertainty, k·u, in the unit of the value.
    #[schema(rename = "U")]
    expanded_uncertainty: f64,
    k: f64,
    /// Degrees of freedom; null: infinitely many.
    dof: Option<f64>,
    identifiable: bool,
    u_monte_carlo: Option<f64>,
    /// Shortest coverage interval by Monte Carlo, with the coverage probability of k.
    interval_monte_carlo: Option<[f64; 2]>,
    /// Contributions to `u`, one line for each source.
    #[schema(required = false)]
    budget: Vec<BudgetLineSchema>,
    /// Judgement by the limit of the parameter; absent without a limit.
    judged: Option<JudgementSchema>,
}

/// Judgement of a parameter by its limit.
#[derive(ToSchema)]
#[schema(as = LimitVerdict)]
pub struct JudgementSchema {
    /// Limit of |value|, in the parameter's unit.
    limit: f64,
    verdict: VerdictSchema,
    /// Probability that the true value is within the limit; absent where the uncertainty cannot be trusted.
    conformance: Option<f64>,
}

/// Source of uncertainty.
#[derive(ToSchema)]
#[schema(as = Budget)]
pub struct BudgetLineSchema {
    source: String,
    /// A: by statistics of repeated readings; B: by other means. Absent in estimates of earlier versions.
    #[schema(rename = "type")]
    evaluation_type: Option<String>,
    /// Distribution of one draw: normal or rectangular. Absent in estimates of earlier versions.
    distribution: Option<String>,
    /// Contribution to the standard uncertainty of the parameter, in its unit.
    u: f64,
    /// Degrees of freedom of the size of the source; absent: infinitely many.
    dof: Option<f64>,
    /// Key of the machine file that declares the size of the source; `axes.*`: the key of each axis.
    key: Option<String>,
    /// `u` divided by the declared size of the source; of several axes or sensors, by the largest size. Absent: `u` is
    /// not proportional to the size.
    sensitivity: Option<f64>,
    /// Whether the size of the source, or a part of it, is assumed and not declared.
    #[schema(required = false)]
    assumed: bool,
}

/// Live values of the sensors that a prompt names.
#[derive(ToSchema)]
#[schema(as = LiveValues)]
pub struct LiveValuesSchema {
    sensors: Vec<LiveSensorSchema>,
    sections: Vec<LiveSectionSchema>,
    /// Slope along X and Y of the line through the centres of two sections, urad.
    tilt_urad: Option<Vec<f64>>,
}

#[derive(ToSchema)]
#[schema(as = LiveSensor)]
pub struct LiveSensorSchema {
    sensor: String,
    /// Lower and upper limit of the measuring range, mm.
    range_mm: Vec<f64>,
    /// Value after the person has done what the prompt requests, mm; null where there is none.
    target_mm: Option<f64>,
    /// Value, mm; null: `failure` states the reason.
    value_mm: Option<f64>,
    failure: Option<String>,
}

/// Section of a round artefact.
#[derive(ToSchema)]
#[schema(as = LiveSection)]
pub struct LiveSectionSchema {
    /// Number, from 1.
    number: usize,
    /// Position of its centre relative to the axis along X and Y, um; null where its sensors do not determine it.
    eccentricity_um: Option<Vec<f64>>,
}

#[derive(ToSchema)]
#[schema(as = Run)]
pub struct RunSchema {
    id: i64,
    #[schema(format = DateTime)]
    started: String,
    /// Time at which the run reached its state; null while the run is in progress.
    #[schema(format = DateTime)]
    ended: Option<String>,
    method: String,
    machine: String,
    /// State: running, held, not identified (measured, without an estimate), finished, failed, interrupted or closed.
    state: String,
    program_version: String,
    config_sha256: String,
    plan_sha256: String,
    /// Person who last signed the last estimate of the run.
    signed: Option<String>,
    /// Verdict of the last estimate of the run.
    verdict: Option<VerdictSchema>,
    /// Reason why the run is held, failed or closed; null in other states.
    end_reason: Option<String>,
}

#[derive(ToSchema)]
#[schema(as = AuditEntry)]
pub struct AuditSchema {
    /// Number of the entry in the log.
    seq: i64,
    #[schema(format = DateTime)]
    at: String,
    who: String,
    what: String,
    why: String,
    machine: String,
    /// Run in progress, or the signed run; 0 for none.
    run: i64,
    outcome: String,
}

/// Difference of one value: the second run minus the first.
#[derive(ToSchema)]
#[schema(as = Difference)]
pub struct DifferenceSchema {
    symbol: String,
    /// Unit: um, urad, um/m, mm or ms.
    unit: String,
    first: f64,
    second: f64,
    by: f64,
    /// Expanded uncertainty of `by`.
    #[schema(rename = "U")]
    expanded_uncertainty: f64,
    /// E_n = |by|/U (ISO 13528); null: U is 0.
    #[schema(rename = "E_n")]
    e_n_score: f64,
    /// Whether |by| exceeds its U: E_n is above 1.
    significant: bool,
}

/// Difference of one function: the second run minus the first, at the arguments of the coarser one within both ranges.
#[derive(ToSchema)]
#[schema(as = FunctionDifference)]
pub struct FunctionDifferenceSchema {
    symbol: String,
    argument: String,
    argument_unit: String,
    /// Unit: um, urad, um/m, mm or ms.
    unit: String,
    /// Argument at which each function is set to zero, by subtraction of its value there; null: nothing is subtracted.
    gauge_at: Option<f64>,
    x: Vec<f64>,
    by: Vec<f64>,
    /// Expanded uncertainty of `by`.
    #[schema(rename = "U")]
    expanded_uncertainties: Vec<f64>,
    /// E_n = |by|/U (ISO 13528).
    #[schema(rename = "E_n")]
    e_n_scores: Vec<f64>,
}

#[derive(ToSchema)]
#[schema(as = Comparison)]
pub struct ComparisonSchema {
    /// Both runs, in the requested order.
    runs: Vec<RunSchema>,
    /// Differences of all values that both runs have identified.
    differences: Vec<DifferenceSchema>,
    functions: Vec<FunctionDifferenceSchema>,
    /// Sources of uncertainty that have the same value in both runs: they cancel in `differences`.
    common_sources: Vec<String>,
    /// Other differences between the runs, in words.
    #[schema(rename = "besides")]
    other_differences: Vec<String>,
}

#[cfg(test)]
mod tests {
    use serde::Serialize;
    use utoipa::PartialSchema;

    use super::*;
    use crate::archive::compare::RunComparison;
    use crate::store::{AuditEntry, RunId, RunState, RunSummary, StoredAuditEntry};
    use machine::record::estimate::{BudgetLine, Distribution, EvaluationType, LimitVerdict, Parameter, Unit, Verdict};
    use machine::record::watched_sensors::{LiveCrossSectionValue, LiveSensorValue, LiveValues};
    use methods::decision::function_difference::FunctionDifference;
    use methods::decision::parameter_difference::ParameterDifference;

    fn property_names(of: &serde_json::Value) -> Vec<String> {
        let mut names: Vec<String> = of.as_object().unwrap().keys().cloned().collect();
        names.sort();
        names
    }

    fn assert_schema_matches_json<V: PartialSchema>(written: impl Serialize) {
        let schema = serde_json::to_value(V::schema()).unwrap();
        let written = serde_json::to_value(written).unwrap();
        assert_eq!(property_names(&schema["properties"]), property_names(&written));
        for (name, value) in written.as_object().unwrap() {
            let kind = &schema["properties"][name]["type"];
            let known = [("string", value.is_string()), ("number", value.is_number())];
            let known = [known[0], known[1], ("integer", value.is_i64()), ("array", value.is_array())];
            for (word, is) in known {
                assert!(kind != word || is, "{name}: {kind}, {value}");
            }
        }
    }

    fn run_summary_without_nulls() -> RunSummary {
        let text = String::new;
        RunSummary {
            id: RunId(1),
            started: jiff::Timestamp::UNIX_EPOCH,
            ended: Some(jiff::Timestamp::UNIX_EPOCH),
            method: text(),
            machine: text(),
            state: RunState::Held,
            program_version: text(),
            config_sha256: text(),
            plan_sha256: text(),
            signed: Some(text()),
            verdict: Some(Verdict::Pass),
            end_reason: Some(text()),
        }
    }

    #[test]
    fn comparison_schemas_match_their_json() {
        let text = String::new;
        let by = ParameterDifference {
            symbol: text(),
            unit: Unit::Um,
            first: 1.5,
            second: 2.0,
            by: 0.5,
            expanded: 0.25,
            normalized_error: 2.0,
            significant: true,
        };
        assert_schema_matches_json::<DifferenceSchema>(by.clone());
        let one = || vec![0.5];
        let function = FunctionDifference {
            symbol: text(),
            argument: text(),
            argument_unit: text(),
            unit: Unit::Um,
            gauge_at: Some(0.0),
            x: one(),
            by: one(),
            expanded: one(),
            normalized_errors: one(),
        };
        assert_schema_matches_json::<FunctionDifferenceSchema>(function.clone());
        assert_schema_matches_json::<ComparisonSchema>(RunComparison {
            runs: [run_summary_without_nulls(), run_summary_without_nulls()],
            differences: vec![by],
            functions: vec![function],
            common_sources: vec![text()],
            other_differences: vec![text()],
        });
    }

    #[test]
    fn parameter_run_live_audit_and_verdict_schemas_match_their_json() {
        let parameter = Parameter {
            symbol: "EX0C".to_owned(),
            value: 1.5,
            unit: Unit::Um,
            u: 0.5,
            expanded: 1.0,
            k: 2.0,
            dof: Some(9.0),
            identifiable: true,
            u_monte_carlo: Some(0.5),
            interval_monte_carlo: Some([0.5, 2.5]),
            budget: vec![BudgetLine {
                source: "probe".to_owned(),
                evaluation_type: Some(EvaluationType::A),
                distribution: Some(Distribution::Normal),
                u: 0.1,
                dof: Some(9.0),
                key: Some("probe.lobing_um".to_owned()),
                sensitivity: Some(0.2),
                assumed: true,
            }],
            judged: Some(LimitVerdict { limit: 5.0, verdict: Verdict::Pass, conformance: Some(1.0) }),
        };
        assert_schema_matches_json::<JudgementSchema>(parameter.judged);
        assert_schema_matches_json::<BudgetLineSchema>(&parameter.budget[0]);
        assert_schema_matches_json::<ParameterSchema>(parameter);
        assert_schema_matches_json::<RunSchema>(run_summary_without_nulls());
        let section = LiveCrossSectionValue { number: 1, eccentricity_um: Some([0.5; 2]) };
        assert_schema_matches_json::<LiveSectionSchema>(section);
        let (range_mm, target_mm, value_mm, failure) = ([-0.3, 0.3], Some(0.0), Some(0.1), None);
        let sensor = String::new();
        let live = LiveSensorValue { sensor, range_mm, target_mm, value_mm, failure };
        assert_schema_matches_json::<LiveSensorSchema>(&live);
        let (sensors, sections) = (vec![live], vec![section]);
        assert_schema_matches_json::<LiveValuesSchema>(LiveValues { sensors, sections, tilt_urad: None });
        let text = String::new;
        let (who, what, why, machine, outcome) = (text(), text(), text(), text(), text());
        let audit = AuditEntry { who, what, why, machine, run: 1, outcome };
        assert_schema_matches_json::<AuditSchema>(StoredAuditEntry {
            seq: 1,
            at: jiff::Timestamp::UNIX_EPOCH,
            entry: audit,
        });
        let schema = serde_json::to_value(VerdictSchema::schema()).unwrap();
        assert_eq!(schema["enum"], serde_json::to_value(Verdict::ALL).unwrap());
    }
}
