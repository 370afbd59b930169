//! Applies the pre-travel map of a qualified probe from the priors of a plan: orients the spindle as the map requires,
//! and subtracts the pre-travel from the readings before the identification.

use super::identification::probe_map::{ProbeMap, is_probe_touch, subtract_pre_travel};
use super::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

/// Wrapper that orients the spindle as the pre-travel map among the priors requires, and subtracts the pre-travel
/// from the readings before the identification. Without such a map, steps and readings are unchanged.
pub(super) struct ProbeMapMethod(pub Box<dyn Method>);

impl Method for ProbeMapMethod {
    fn settings(&self) -> serde_json::Value {
        self.0.settings()
    }

    /// A map is valid for an oriented spindle only. If a touch has no spindle angle, although the spindle is an axis,
    /// the spindle is turned to 0°, or to the nearest angle within its limits.
    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        readings: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let mut next = self.0.next_stage(plan, done, readings)?;
        if let NextStage::Stage { new_steps, .. } = &mut next
            && let Some(spec) = plan.machine.axes.get(&Axis::S)
            && ProbeMap::from_plan(plan)?.is_some()
        {
            let degrees = spec.position_nearest_zero();
            let left = |step: &&mut Step| is_probe_touch(step) && step.from.get(Axis::S).is_none();
            new_steps.iter_mut().filter(left).for_each(|step| step.from.set(Axis::S, Axis::S.to_mm_or_rad(degrees)));
        }
        Ok(next)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        self.0.required_sensors(sensors)
    }

    fn accepts_probe_map(&self) -> bool {
        self.0.accepts_probe_map()
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        let has_map = ProbeMap::from_plan(plan)?.is_some();
        MethodRefusal::require(
            !has_map || self.accepts_probe_map(),
            "this method does not correct the pre-travel of a qualified probe",
            "remove the probe qualification (--with)",
        )?;
        self.0.check_priors(plan)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let mut lines = self.0.forecast(plan, machine_s)?;
        let asks = plan.probe.qualified_within_days.is_some() && self.accepts_probe_map();
        if asks && ProbeMap::from_plan(plan)?.is_none() {
            lines.push(
                "the run will use the newest qualification of the probe (qualified_within_days); the \
                expected U does not include its effect"
                    .to_owned(),
            );
        }
        Ok(lines)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        self.check_priors(plan)?;
        let readings = subtract_pre_travel(plan, readings)?;
        let mut estimate = self.0.identify(plan, &readings)?;
        estimate.gauge.extend(ProbeMap::from_plan(plan)?.map(|map| map.describe()));
        Ok(estimate)
    }
}
