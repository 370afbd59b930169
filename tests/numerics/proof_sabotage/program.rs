//! Whole programs of real plans, and the lines of each action of a step.

use machine::record::plan::{Plan, Stage};
use machine::record::proof::Proof;
use machine::{Axis, Position};
use planning::SafeHeights;
use planning::gcode::{Dialect, ProgramHeader};
use planning::proof::{ProofRefusal, ProofRequest, StageSteps, prove_programs};
use trued::setup::{MachineFile, configure_method_and_plan};

pub const SIMULATED: &str = include_str!("../../../config/simulated.toml");
pub const LINUXCNC: &str = include_str!("../../../config/linuxcnc-sim.toml");
pub const GRBLHAL: &str = include_str!("../../../config/grblhal-serial.toml");

pub struct RenderedPlan {
    pub plan: Plan,
    pub stages: Vec<Stage>,
    pub dialect: Dialect,
    pub lines: Vec<String>,
}

impl RenderedPlan {
    /// The plan of `file` from nominal positions, in `dialect`.
    pub fn new(file: &str, method: &str, dialect: &str) -> Self {
        let file = MachineFile::parse("shop.toml", file.to_owned()).unwrap();
        let (method, plan) = configure_method_and_plan(&file, method, None).unwrap();
        let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), plan).unwrap();
        Self::render(plan, stages, dialect)
    }

    /// A whole plan.
    pub fn render(plan: Plan, stages: Vec<Stage>, dialect: &str) -> Self {
        let (blocks, _) = planning::plan_blocks(&plan, &SafeHeights::above_plan_artefact(&plan).unwrap()).unwrap();
        let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
        let dialect = Dialect::from_name(dialect).unwrap();
        let text = dialect.render_program(&ProgramHeader { title: "t", axes: &axes, log: None }, &blocks).unwrap();
        Self { plan, stages, dialect, lines: text.lines().map(str::to_owned).collect() }
    }

    pub fn prove(&self, lines: &[String], stands: Option<&Position>) -> Result<Proof, ProofRefusal> {
        let staged: Vec<StageSteps> = self
            .stages
            .iter()
            .map(|stage| StageSteps { step_ids: &stage.steps, found_artefact: stage.found.as_ref() })
            .collect();
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        prove_programs(&ProofRequest {
            plan: &self.plan,
            stages: &staged,
            start_position: stands,
            confirmed: planning::ConfirmedDirections::default(),
            dialect: &self.dialect,
            programs: &[text],
        })
    }

    /// Lines of each action of step `id`; indices into `lines`.
    pub fn lines_of_step(&self, id: u32) -> StepLines {
        let of_step = |line: &String| line.starts_with(&format!("N{id} "));
        let own: Vec<usize> = (0..self.lines.len()).filter(|i| of_step(&self.lines[*i])).collect();
        let back = *own.iter().rev().find(|i| self.lines[**i].contains("G53 G1")).unwrap();
        let before = own.iter().position(|i| *i == back).unwrap();
        let find =
            |words: &[&str]| own.iter().copied().find(|i| words.iter().all(|word| self.lines[*i].contains(word)));
        StepLines {
            first_line: own[0],
            turn_line: find(&["G0", " C"]).or(find(&["G1", " C"])),
            orient_line: find(&["M19"]),
            over_line: find(&["G0", " X"]).or(find(&["G0", " Y"])),
            down_line: own[before - 2],
            touch_line: own[before - 1],
            back_off_line: back,
            up_line: own[before + 1],
            last_line: *own.last().unwrap(),
        }
    }

    /// Index of the first line after `index` that belongs to a step.
    pub fn next_motion_line(lines: &[String], index: usize) -> usize {
        (index + 1..lines.len()).find(|i| lines[*i].starts_with('N')).unwrap()
    }
}

#[derive(Debug, Clone, Copy)]
pub struct StepLines {
    pub first_line: usize,
    pub turn_line: Option<usize>,
    pub orient_line: Option<usize>,
    pub over_line: Option<usize>,
    pub down_line: usize,
    pub touch_line: usize,
    pub back_off_line: usize,
    pub up_line: usize,
    pub last_line: usize,
}
