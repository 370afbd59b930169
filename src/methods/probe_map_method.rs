//! Use of the map of a qualified probe that is among the priors of a plan: the spindle is oriented as the map
//! needs it, and the method identifies from readings without pre-travel.

use super::identification::probe_map::{ProbeMap, is_touch, without_pre_travel};
use super::{IdentifyError, Method, Next, Refused, Source};
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub(super) struct ProbeMapMethod(pub Box<dyn Method>);

impl Method for ProbeMapMethod {
    fn settings(&self) -> serde_json::Value {
        self.0.settings()
    }

    /// A map is valid for an oriented spindle only. If a touch leaves a positionable spindle unoriented, the
    /// spindle is turned to 0°, or to the nearest angle within its limits.
    fn next(&self, plan: &Plan, done: &[Stage], readings: Source<'_>) -> Result<Next, Refused> {
        let mut next = self.0.next(plan, done, readings)?;
        if let Next::Stage { new_steps, .. } = &mut next
            && let Some(spec) = plan.machine.axes.get(&Axis::S)
            && ProbeMap::of(plan)?.is_some()
        {
            let degrees = spec.nearest_zero();
            let left = |step: &&mut Step| is_touch(step) && step.from.get(Axis::S).is_none();
            new_steps
                .iter_mut()
                .filter(left)
                .for_each(|step| step.from.set(Axis::S, Axis::S.from_edge(degrees)));
        }
        Ok(next)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        self.0.required_sensors(sensors)
    }

    fn takes_probe_map(&self) -> bool {
        self.0.takes_probe_map()
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        let has_map = ProbeMap::of(plan)?.is_some();
        Refused::unless(
            !has_map || self.takes_probe_map(),
            "this method does not take off the pre-travel of a qualified probe",
            "leave the qualification out (--with)",
        )?;
        self.0.check_priors(plan)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let mut lines = self.0.forecast(plan, machine_s)?;
        let asks = plan.probe.qualified_within_days.is_some() && self.takes_probe_map();
        if asks && ProbeMap::of(plan)?.is_none() {
            lines.push(
                "the run takes the newest qualification of the probe (qualified_within_days), which is not counted here"
                    .to_owned(),
            );
        }
        Ok(lines)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        self.check_priors(plan)?;
        let readings = without_pre_travel(plan, readings)?;
        let mut estimate = self.0.identify(plan, &readings)?;
        estimate.gauge.extend(ProbeMap::of(plan)?.map(|map| map.in_words()));
        Ok(estimate)
    }
}
