//! Whole programs of real plans, and the lines of each action of a step.

use machine::record::plan::{Plan, Stage};
use machine::record::proof::Proof;
use machine::{Axis, Position};
use planning::SafeHeights;
use planning::gcode::{Dialect, ProgramHeader};
use planning::proof::{ProofRefusal, ProofRequest, StageSteps, prove_programs};
use trued::setup::{MachineFile, plan_header};

pub const SIMULATED: &str = include_str!("../../../config/simulated.toml");
pub const LINUXCNC: &str = include_str!("../../../config/linuxcnc-sim.toml");
pub const GRBLHAL: &str = include_str!("../../../config/grblhal-serial.toml");

pub struct Rendered {
    pub plan: Plan,
    pub stages: Vec<Stage>,
    pub dialect: Dialect,
    pub lines: Vec<String>,
}

impl Rendered {
    /// The plan of `file` from nominal positions, in `dialect`.
    pub fn new(file: &str, method: &str, dialect: &str) -> Self {
        let file = MachineFile::parse("shop.toml", file.to_owned()).unwrap();
        let (method, plan) = plan_header(&file, method, None).unwrap();
        let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), plan).unwrap();
        Self::of(plan, stages, dialect)
    }

    /// A whole plan.
    pub fn of(plan: Plan, stages: Vec<Stage>, dialect: &str) -> Self {
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
            .map(|stage| StageSteps { steps: &stage.steps, found_artefact: stage.found.as_ref() })
            .collect();
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        prove_programs(&ProofRequest {
            plan: &self.plan,
            stages: &staged,
            position: stands,
            confirmed: planning::ConfirmedDirections::default(),
            dialect: &self.dialect,
            programs: &[text],
        })
    }

    /// Lines of each action of step `id`; indices into `lines`.
    pub fn place(&self, id: u32) -> Place {
        let of_step = |line: &String| line.starts_with(&format!("N{id} "));
        let own: Vec<usize> = (0..self.lines.len()).filter(|i| of_step(&self.lines[*i])).collect();
        let back = *own.iter().rev().find(|i| self.lines[**i].contains("G53 G1")).unwrap();
        let before = own.iter().position(|i| *i == back).unwrap();
        let find =
            |words: &[&str]| own.iter().copied().find(|i| words.iter().all(|word| self.lines[*i].contains(word)));
        Place {
            first: own[0],
            turn: find(&["G0", " C"]).or(find(&["G1", " C"])),
            orient: find(&["M19"]),
            over: find(&["G0", " X"]).or(find(&["G0", " Y"])),
            down: own[before - 2],
            touch: own[before - 1],
            back,
            up: own[before + 1],
            last: *own.last().unwrap(),
        }
    }

    /// Index of the first line after `index` that belongs to a step.
    pub fn next(lines: &[String], index: usize) -> usize {
        (index + 1..lines.len()).find(|i| lines[*i].starts_with('N')).unwrap()
    }
}

#[derive(Debug, Clone, Copy)]
pub struct Place {
    pub first: usize,
    pub turn: Option<usize>,
    pub orient: Option<usize>,
    pub over: Option<usize>,
    pub down: usize,
    pub touch: usize,
    pub back: usize,
    pub up: usize,
    pub last: usize,
}
