//! Latch delay of a contact, from touches of one position of the part at two alternating feeds. A latch that is τ
//! late records the axes v·τ too far, so the position over the feed is a line with slope τ. A PLC that reads the
//! probe once per scan of duration T is late by 0 to T, on average T/2. Its touches scatter by v·T/√12
//! (rectangular, GUM 4.3.7), which grows with the feed, unlike the scatter of the probe.

mod estimate;
mod evaluation;
mod feeds;
mod fit;
mod observe;
mod outputs;
mod plc_scan_test;
mod result_texts;
mod settings;
mod symbol_names;
mod touch_path;

pub use plc_scan_test::{LatchDiagnosis, PlcScanTime};
pub use settings::LatchDelaySettings;

use self::evaluation::EvaluatedRun;
use self::feeds::TouchFeeds;
use self::touch_path::TouchEndsAndNormal;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use machine::artefact::max_misplacement_mm;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const METHOD_NAME: &str = "latch-delay";

pub struct LatchDelay {
    settings: LatchDelaySettings,
}

impl LatchDelay {
    /// Measuring feed and fast feed, and the distances that a fast touch needs for the position uncertainty of the
    /// part.
    fn choose_feeds(&self, plan: &Plan) -> Result<TouchFeeds, MethodRefusal> {
        let uncertainty = max_misplacement_mm(&plan.artefact);
        let length = |margin_mm| touch_path::touch_length_mm(uncertainty, margin_mm);
        TouchFeeds::from_settings(&plan.machine, &plan.probe, &self.settings, length)
    }
}

impl RegisteredMethod for LatchDelay {
    type Settings = LatchDelaySettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "a round part or balls",
        results: "delay from contact to latch; whether a PLC program scan latches the contact, and its \
                duration; scatter of touches at two feeds",
        default_machine_file: "simulated.toml",
        source: "documentation of trued",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: LatchDelaySettings) -> Self {
        Self { settings }
    }
}

impl Method for LatchDelay {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        self.settings.check()?;
        let feeds = self.choose_feeds(plan)?;
        let touch_path = TouchEndsAndNormal::from_plan(plan, &self.settings, &feeds)?;
        let (name, steps) = match done.len() {
            0 => ("search".to_owned(), vec![touch_path.search_step(plan.probe.search_feed_mm_min)]),
            1 => {
                if let ObjectPositionSource::Measured(readings) = source {
                    observe::check_search_result(plan, &feeds, readings)?;
                }
                let name = format!("{} and {} mm/min", feeds.measuring_feed_mm_min, feeds.fast_feed_mm_min);
                (name, touch_path.alternating_steps(&feeds, self.settings.touches))
            }
            _ => return Ok(NextStage::NoFurtherStage),
        };
        Ok(NextStage::from_new_steps(plan, done, name, steps))
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        Ok(estimate::build_estimate(&EvaluatedRun::from_readings(plan, readings)?))
    }
}

/// Results of a run for the check of the machine.
#[derive(Debug, Clone, PartialEq)]
pub struct LatchDelayResult {
    pub latch_diagnosis: LatchDiagnosis,
    /// Text for the operator: control or PLC scan, scatter at both feeds, F test.
    pub latch_text: String,
    /// Latch delay, s, positive if late.
    pub delay_s: f64,
    /// Text on a delay, late or early, that exceeds its expanded uncertainty U. `None` for a smaller delay.
    pub significant_delay_text: Option<String>,
    /// Description of slow touches that scatter more than explained. `None`: the scatter is explained, or no scatter is
    /// declared.
    pub excess_scatter_text: Option<String>,
    /// Experimental standard deviation of one slow touch, mm.
    pub slow_touch_std_dev_mm: f64,
    /// Upper χ² bound of the experimental standard deviation of slow touches, mm, for the declared scatter and a
    /// detected PLC scan. `None`: no scatter is declared.
    pub max_explained_slow_touch_std_dev_mm: Option<f64>,
}

impl LatchDelayResult {
    /// # Errors
    /// The errors of [`Method::identify`].
    pub fn from_readings(plan: &Plan, readings: &[Reading]) -> Result<Self, IdentifyError> {
        let run = EvaluatedRun::from_readings(plan, readings)?;
        Ok(Self {
            latch_diagnosis: run.plc_scan_test.latch_diagnosis,
            latch_text: result_texts::describe_latch(&run),
            delay_s: run.fitted.delay_s,
            significant_delay_text: result_texts::describe_significant_delay(&run),
            excess_scatter_text: result_texts::describe_excess_scatter(&run),
            slow_touch_std_dev_mm: run.fitted.scatter_by_feed[0].std_dev_mm,
            max_explained_slow_touch_std_dev_mm: result_texts::max_explained_slow_touch_std_dev_mm(&run),
        })
    }
}
