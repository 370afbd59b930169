//! Remaining stages of a run, with the machine times from its rehearsal.

/// Rehearsed stages that the run has not begun.
#[derive(Debug, Default)]
pub(super) struct RemainingStages {
    /// In the order of the rehearsal.
    stages: Vec<RehearsedStage>,
}

/// Name and machine time of a stage of the rehearsal.
#[derive(Debug)]
pub(super) struct RehearsedStage {
    pub(super) name: String,
    pub(super) machine_time_s: f64,
}

impl RemainingStages {
    pub(super) fn new(stages: Vec<RehearsedStage>) -> Self {
        Self { stages }
    }

    /// Removes the stage `name`, which begins now, and all stages before it. Removes none if the stage was not
    /// rehearsed, for example another round of the rest check or a repeated measurement.
    pub(super) fn remove_up_to_begun_stage(&mut self, name: &str) {
        if let Some(at) = self.stages.iter().position(|stage| stage.name == name) {
            self.stages.drain(..=at);
        }
    }

    /// Machine time of the remaining stages, s.
    pub(super) fn total_machine_time_s(&self) -> f64 {
        self.stages.iter().map(|stage| stage.machine_time_s).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn remaining_of_two_stages() -> RemainingStages {
        let stage = |name: &str, machine_s| RehearsedStage { name: name.to_owned(), machine_time_s: machine_s };
        RemainingStages::new(vec![
            stage("find", 1.0),
            stage("reference", 2.0),
            stage("measure", 4.0),
            stage("reference", 8.0),
        ])
    }

    #[test]
    fn unrehearsed_stages_do_not_reduce_the_time_left() {
        let mut remaining = remaining_of_two_stages();
        let names = ["find", "find, once more", "reference", "at rest?", "measure", "reference"];
        let left = names.map(|name| {
            remaining.remove_up_to_begun_stage(name);
            remaining.total_machine_time_s()
        });
        assert_eq!(left, [14.0, 14.0, 12.0, 12.0, 8.0, 0.0]);
    }

    #[test]
    fn stages_done_before_a_resume_are_not_counted() {
        let mut remaining = remaining_of_two_stages();
        remaining.remove_up_to_begun_stage("measure");
        assert_eq!(remaining.total_machine_time_s(), 8.0);
    }
}
