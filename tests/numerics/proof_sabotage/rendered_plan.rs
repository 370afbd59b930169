//! Whole programs of real plans, and the lines of each action of a step.

use machine::record::plan::{Plan, Stage};
use machine::record::stage_proof::StageProof;
use machine::{Axis, Position};
use planning::SafeHeights;
use planning::gcode::{Dialect, HeadAndFootValues};
use planning::proof::{ProofRefusal, ProofRequest, StageSteps, prove_programs};
use trued::setup::{MachineFile, configure_method_and_plan_without_steps};

pub const SIMULATED_MACHINE_TOML: &str = include_str!("../../../config/simulated.toml");
pub const LINUXCNC_MACHINE_TOML: &str = include_str!("../../../config/linuxcnc-sim.toml");
pub const GRBLHAL_MACHINE_TOML: &str = include_str!("../../../config/grblhal-serial.toml");

pub struct RenderedPlan {
    pub plan: Plan,
    pub stages: Vec<Stage>,
    pub dialect: Dialect,
    pub program_lines: Vec<String>,
}

impl RenderedPlan {
    /// The plan of the machine file `machine_text` from nominal positions, in `dialect`.
    pub fn new(machine_text: &str, method: &str, dialect: &str) -> Self {
        let file = MachineFile::parse("shop.toml", machine_text.to_owned()).unwrap();
        let (method, header) = configure_method_and_plan_without_steps(&file, method, None).unwrap();
        let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), header).unwrap();
        Self::from_plan(plan, stages, dialect)
    }

    /// Renders a whole plan as one program.
    pub fn from_plan(plan: Plan, stages: Vec<Stage>, dialect: &str) -> Self {
        let (blocks, _) =
            planning::plan_blocks_and_time_s(&plan, &SafeHeights::above_plan_artefact(&plan).unwrap()).unwrap();
        let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
        let dialect = Dialect::from_name(dialect).unwrap();
        let text = dialect
            .render_program(&HeadAndFootValues { title: "t", axes: &axes, result_log_path: None }, &blocks)
            .unwrap();
        Self { plan, stages, dialect, program_lines: text.lines().map(str::to_owned).collect() }
    }

    pub fn prove(&self, lines: &[String], start_position: Option<&Position>) -> Result<StageProof, ProofRefusal> {
        let staged: Vec<StageSteps> = self
            .stages
            .iter()
            .map(|stage| StageSteps { step_ids: &stage.steps, found_artefact: stage.found.as_ref() })
            .collect();
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        let request = ProofRequest {
            plan: &self.plan,
            stages: &staged,
            start_position,
            touched_directions: planning::TouchedDirections::default(),
            dialect: &self.dialect,
        };
        prove_programs(&request, &[text])
    }

    /// Lines of each action of step `id`; indices into `lines`.
    pub fn lines_of_step(&self, id: u32) -> StepLines {
        let of_step = |line: &String| line.starts_with(&format!("N{id} "));
        let own: Vec<usize> = (0..self.program_lines.len()).filter(|i| of_step(&self.program_lines[*i])).collect();
        let back = *own.iter().rev().find(|i| self.program_lines[**i].contains("G53 G1")).unwrap();
        let before = own.iter().position(|i| *i == back).unwrap();
        let find = |words: &[&str]| {
            own.iter().copied().find(|i| words.iter().all(|word| self.program_lines[*i].contains(word)))
        };
        StepLines {
            first_line: own[0],
            c_rotation_line: find(&["G0", " C"]).or(find(&["G1", " C"])),
            spindle_orientation_line: find(&["M19"]),
            traverse_line: find(&["G0", " X"]).or(find(&["G0", " Y"])),
            approach_line: own[before - 2],
            touch_line: own[before - 1],
            back_off_line: back,
            retract_line: own[before + 1],
            last_line: *own.last().unwrap(),
        }
    }

    /// Index of the first line after `index` that belongs to a step.
    pub fn next_step_line(lines: &[String], index: usize) -> usize {
        (index + 1..lines.len()).find(|i| lines[*i].starts_with('N')).unwrap()
    }
}

/// Lines of a step, as indices from 0.
#[derive(Debug, Clone, Copy)]
pub struct StepLines {
    pub first_line: usize,
    pub c_rotation_line: Option<usize>,
    pub spindle_orientation_line: Option<usize>,
    pub traverse_line: Option<usize>,
    pub approach_line: usize,
    pub touch_line: usize,
    pub back_off_line: usize,
    pub retract_line: usize,
    pub last_line: usize,
}
