//! How a control receives text, and the text of blocks as it is sent.

use super::dialect::Dialect;
use super::error::RenderError;
use super::render::Program;
use machine::Axis;
use machine::record::motion::{Block, Motion};

/// How a control receives blocks. The driver states it; what is proven is what is sent so.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Transmission {
    /// Single lines, each shorter than `max_line_bytes`. The modes that the head sets hold until the foot.
    Lines { max_line_bytes: usize },
    /// A program with a head and a foot for each part of a block; a part ends after a back-off, since the
    /// probe must read open before anything else moves. The control writes its results to the file `log`.
    Programs { log: String },
    /// Rows of a table that a resident program executes: the motions as they are read from the text.
    Rows,
}

/// What is sent at once: the lines of one motion, or one program.
#[derive(Debug, Clone, PartialEq)]
pub struct Unit {
    pub motions: Vec<Motion>,
    /// Each line ends with a newline.
    pub text: String,
    /// Time that clamps rest in it, s.
    pub clamps_rest_s: f64,
}

/// Blocks as they are sent.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Transmitted {
    /// The units of each block.
    pub blocks: Vec<Vec<Unit>>,
    /// The programs that a reader must read, each from an unknown state: all of the text, in the order in
    /// which it is sent.
    pub programs: Vec<String>,
    /// Lines of the programs before the first unit.
    pub head_lines: usize,
}

impl Dialect {
    /// The text of `blocks` as `transmission` sends it.
    ///
    /// # Errors
    /// What cannot be written.
    pub(crate) fn transmitted(
        &self,
        transmission: &Transmission,
        axes: &[Axis],
        blocks: &[Block],
    ) -> Result<Transmitted, RenderError> {
        match transmission {
            Transmission::Lines { .. } | Transmission::Rows => self.as_lines(axes, blocks),
            Transmission::Programs { log } => self.as_programs(axes, log, blocks),
        }
    }

    /// One program; a unit for each motion.
    fn as_lines(&self, axes: &[Axis], blocks: &[Block]) -> Result<Transmitted, RenderError> {
        let program = Program { title: "stage", axes, log: None };
        let mut text = joined(self.head(&program)?);
        let head_lines = text.lines().count();
        let mut all = Vec::new();
        for block in blocks {
            let units: Vec<Unit> =
                block.motions.iter().map(|m| self.line_unit(block, m)).collect::<Result<_, _>>()?;
            text.extend(units.iter().map(|unit| unit.text.as_str()));
            all.push(units);
        }
        text += &joined(self.foot(&program)?);
        Ok(Transmitted { blocks: all, programs: vec![text], head_lines })
    }

    fn line_unit(&self, block: &Block, motion: &Motion) -> Result<Unit, RenderError> {
        let motions = vec![motion.clone()];
        let lines = self.block(&Block { motions: motions.clone(), ..*block })?;
        Ok(Unit { motions, text: joined(lines), clamps_rest_s: self.clamps_rest_s(motion) })
    }

    /// A program for each part of a block. The probe stays on from program to program.
    fn as_programs(
        &self,
        axes: &[Axis],
        log: &str,
        blocks: &[Block],
    ) -> Result<Transmitted, RenderError> {
        let dialect = self.keeping_probe_on();
        let mut all = Vec::new();
        for block in blocks {
            let parts = block.motions.split_inclusive(backs_off);
            let units: Vec<Unit> = parts
                .map(|motions| dialect.program_unit(axes, log, block, motions))
                .collect::<Result<_, _>>()?;
            all.push(units);
        }
        let programs = all.iter().flatten().map(|unit| unit.text.clone()).collect();
        Ok(Transmitted { blocks: all, programs, head_lines: 0 })
    }

    fn program_unit(
        &self,
        axes: &[Axis],
        log: &str,
        block: &Block,
        motions: &[Motion],
    ) -> Result<Unit, RenderError> {
        let title = format!("step {} repeat {}", block.step, block.repeat);
        let program = Program { title: &title, axes, log: Some(log) };
        let motions = motions.to_vec();
        let part = Block { motions: motions.clone(), ..*block };
        let text = self.program(&program, std::slice::from_ref(&part))?;
        let clamps_rest_s = motions.iter().map(|motion| self.clamps_rest_s(motion)).sum();
        Ok(Unit { motions, text, clamps_rest_s })
    }
}

fn joined(lines: Vec<String>) -> String {
    lines.into_iter().map(|line| line + "\n").collect()
}

fn backs_off(motion: &Motion) -> bool {
    matches!(motion, Motion::BackOff { .. })
}
