//! Whether the probe has the qualification that a run requires: of the same probe, and recent enough (`[probe]
//! qualified_within_days`).

use jiff::Timestamp;

use super::identify::probe_sha256;
use crate::store::{Journal, StoreError};
use machine::record::estimate::Provenance;
use machine::record::plan::Plan;
use methods::Method;
use methods::identification::probe_map::PROBE_QUALIFICATION_METHOD_NAME;

/// Reason why a run does not begin: the required qualification of the probe is missing or not valid.
#[derive(Debug, thiserror::Error)]
pub enum QualificationError {
    #[error("[probe] qualified_within_days requires a qualification of the probe, but the journal contains none")]
    Missing,
    /// `days`: time since the start of the qualification run.
    #[error("the qualification of the probe is {days:.1} days old; the limit is qualified_within_days = {most}")]
    Expired { days: f64, most: f64 },
    #[error(
        "--with contains a qualification of the probe, but with [probe] qualified_within_days the run uses the \
        newest qualification in the journal"
    )]
    AlreadyAmongPriors,
    #[error(
        "the qualification was made with a probe, stylus or machine that differs from [probe], tool_mm and \
        name in the machine file"
    )]
    OtherProbe,
    #[error(transparent)]
    MethodRefused(#[from] methods::MethodRefusal),
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl QualificationError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            QualificationError::MethodRefused(refused) => refused.remedy.clone(),
            Self::Store(error) => error.remedy().to_owned(),
            QualificationError::AlreadyAmongPriors => {
                "remove the qualification from --with, or remove qualified_within_days".to_owned()
            }
            Self::Missing | Self::Expired { .. } | Self::OtherProbe => {
                format!(
                    "run `trued run {PROBE_QUALIFICATION_METHOD_NAME}` with a precision sphere, then start this run \
                     again"
                )
            }
        }
    }
}

/// Adds the newest qualification of the machine's probe to the priors of the plan, if the machine file requires one
/// and the method uses one. Qualifications that are already among the priors are checked in any case.
///
/// # Errors
/// There is no qualification, it belongs to another probe, it is too old, the method does not accept it, or the
/// plan already contains one.
pub fn add_qualification(
    method: &dyn Method,
    mut plan: Plan,
    journal: &Journal,
    now: Timestamp,
) -> Result<Plan, QualificationError> {
    let within_days = plan.probe.qualified_within_days.filter(|_| method.accepts_probe_map());
    if let Some(most) = within_days {
        let is_given = plan.priors.iter().any(|prior| prior.method == PROBE_QUALIFICATION_METHOD_NAME);
        if is_given {
            return Err(QualificationError::AlreadyAmongPriors);
        }
        let newest = journal
            .newest_run_with_estimate(&plan.machine.name, PROBE_QUALIFICATION_METHOD_NAME)?
            .ok_or(QualificationError::Missing)?;
        let mut stored = journal.load_run(newest)?;
        let days = age_days(stored.summary.started, now);
        if days > most {
            return Err(QualificationError::Expired { days, most });
        }
        let estimate = stored.estimates.pop().ok_or(QualificationError::Missing)?.estimate;
        plan.priors.push(estimate);
        method.check_priors(&plan)?;
    }
    check_qualifications_match_probe(&plan)?;
    Ok(plan)
}

/// Checks that each qualification among the priors belongs to the plan's own probe.
///
/// # Errors
/// A qualification belongs to another probe or does not name its probe.
pub fn check_qualifications_match_probe(plan: &Plan) -> Result<(), QualificationError> {
    let own = probe_sha256(plan);
    let is_own = |provenance: &Provenance| {
        Some(&provenance.probe_sha256) == own.as_ref() && provenance.machine == plan.machine.name
    };
    let mut maps = plan.priors.iter().filter(|prior| prior.method == PROBE_QUALIFICATION_METHOD_NAME);
    match maps.all(|prior| prior.provenance.as_ref().is_some_and(is_own)) {
        true => Ok(()),
        false => Err(QualificationError::OtherProbe),
    }
}

fn age_days(started: Timestamp, now: Timestamp) -> f64 {
    now.duration_since(started).as_secs_f64() / 86_400.0
}

#[cfg(test)]
mod tests {
    use jiff::ToSpan;
    use serde_json::json;

    use super::*;
    use machine::record::estimate::Estimate;

    use crate::archive::plan_for_tests;
    use crate::store::{NewRun, RunState};

    fn samba_method() -> Box<dyn Method> {
        methods::configure_method("samba", json!({})).unwrap()
    }

    /// Qualification map as a run of `plan` stores it.
    fn probe_map_estimate(plan: &Plan) -> Estimate {
        let of = |symbol: &str| {
            json!({"symbol": symbol, "value": 1.0, "unit": "um", "u": 0.1, "U": 0.2, "k": 2.0, "dof": null,
                "identifiable": true})
        };
        let estimate = json!({
            "trued_estimate": 1, "method": PROBE_QUALIFICATION_METHOD_NAME,
            "parameters": [of("E_probe_c3"), of("E_probe_s3")], "functions": [],
            "covariance": {"symbols": ["E_probe_c3", "E_probe_s3"], "rows": [[0.01, 0.0], [0.0, 0.01]]},
            "rank": 2, "unknowns": 2, "condition": 1.0, "gauge": [], "not_identifiable": [],
            "residual_rms_um": 0.1, "degrees_of_freedom": 10, "chi2_per_dof": 1.0, "verdict": "none",
            "warnings": [], "priors": [],
            "provenance": {"program": "trued", "machine": plan.machine.name, "plan_sha256": "", "readings_sha256": "",
                "probe_sha256": probe_sha256(plan).unwrap(), "artefact_sha256": "", "compensations_active": [],
                "duration_s": 1.0},
        });
        serde_json::from_value(estimate).unwrap()
    }

    #[tokio::test]
    async fn newest_recent_qualification_of_the_same_probe_is_used() {
        let dir = tempfile::tempdir().unwrap();
        let journal = Journal::open(dir.path()).unwrap();
        let mut plan = plan_for_tests("samba", "mill");
        let now = Timestamp::now();
        let ask = |plan: &Plan, now| add_qualification(samba_method().as_ref(), plan.clone(), &journal, now);
        assert_eq!(ask(&plan, now).unwrap().priors, []);
        plan.probe.lobing_um = 0.5;
        plan.probe.qualified_within_days = Some(30.0);
        assert!(matches!(ask(&plan, now), Err(QualificationError::Missing)));

        let new =
            NewRun { machine_file_text: String::new(), plan: plan_for_tests(PROBE_QUALIFICATION_METHOD_NAME, "mill") };
        let run = journal.begin_run(&new).await.unwrap();
        let found = probe_map_estimate(&plan);
        journal.add_estimate(run, &found).await.unwrap();
        journal.set_state(run, RunState::Finished).await.unwrap();
        assert_eq!(ask(&plan, now).unwrap().priors, [found]);
        let late = now + (31 * 24).hours();
        assert!(matches!(ask(&plan, late), Err(QualificationError::Expired { days, .. }) if days > 30.9));

        // A changed declared uncertainty still describes the same probe.
        plan.probe.repeatability_um = Some(0.2);
        assert!(ask(&plan, now).is_ok());
        plan.probe.ball_radius_mm += 0.5;
        assert!(matches!(ask(&plan, now), Err(QualificationError::OtherProbe)));
        let given = Plan { priors: vec![probe_map_estimate(&plan)], ..plan.clone() };
        assert!(matches!(ask(&given, now), Err(QualificationError::AlreadyAmongPriors)));
        plan.machine.name = "another".to_owned();
        assert!(matches!(ask(&plan, now), Err(QualificationError::Missing)));
    }
}
