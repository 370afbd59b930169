//! Remaining time of the stages ahead, also with stages that were not rehearsed.

use super::*;
use machine::record::estimate::Estimate;
use methods::{IdentifyError, MethodRefusal};

/// Repeats the first stage, as a method does for a measurement outside its limits.
struct RepeatingMethod {
    inner: Box<dyn Method>,
}

impl Method for RepeatingMethod {
    fn settings(&self) -> serde_json::Value {
        self.inner.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let inner: Vec<Stage> = done.iter().filter(|stage| stage.repeat < 7).cloned().collect();
        if matches!(source, ObjectPositionSource::Measured(_))
            && let [first] = done
        {
            let name = format!("{}, once more", first.name);
            let stage = Stage { id: 1000, name, repeat: 7, ..first.clone() };
            return Ok(NextStage::Stage { stage, new_steps: Vec::new() });
        }
        self.inner.next_stage(plan, &inner, source)
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("nobody asks for it".to_owned()))
    }
}

/// Label, repeat and remaining time (s) of each step that was begun.
type TimesLeft = Mutex<Vec<(String, u32, f64)>>;

fn record_time_left(left: &TimesLeft, event: &RunEvent) {
    if let RunEvent::StepStarted { label, repeat, remaining_s, .. } = event {
        left.lock().unwrap().push((label.clone(), *repeat, *remaining_s));
    }
}

#[tokio::test]
async fn time_left_decreases_and_agrees_after_stops_and_repeats() {
    let shop = RunWorkspace::new("");
    let whole = TimesLeft::default();
    let told = |event: &RunEvent, _: &HaltHandle| record_time_left(&whole, event);
    shop.run_method(shop.method_and_plan().0.as_ref(), |_| answers_by_operator(), told).await.0.unwrap();
    let whole = whole.into_inner().unwrap();
    assert!(whole.windows(2).all(|pair| pair[1].2 < pair[0].2), "{whole:?}");

    let method = RepeatingMethod { inner: shop.method_and_plan().0 };
    let left = TimesLeft::default();
    let stopped_in_the_middle = |event: &RunEvent, halt: &HaltHandle| {
        record_time_left(&left, event);
        if left.lock().unwrap().len() == whole.len() / 2 {
            halt.trigger();
        }
    };
    let (held, stored) = shop.run_method(&method, |_| answers_by_operator(), stopped_in_the_middle).await;
    assert!(held.unwrap_err().is_requested_stop());
    let told = |event: &RunEvent, _: &HaltHandle| record_time_left(&left, event);
    shop.resume(&method, stored, told).await.0.unwrap();
    let left = left.into_inner().unwrap();
    let mut compared = 0;
    for (label, repeat, at_first_s) in &whole {
        let same = left.iter().filter(|step| (&step.0, step.1) == (label, *repeat));
        for (_, _, left_s) in same {
            // The path to a touch differs where the machine starts from another position.
            assert!((left_s - at_first_s).abs() < 20.0, "{label}: {left_s} and {at_first_s}");
            compared += 1;
        }
    }
    assert!(compared > whole.len(), "{compared} of {}", whole.len());
}
