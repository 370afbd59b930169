//! Blocks whose text was proven: a driver executes nothing else.

use sha2::{Digest as _, Sha256};

use super::refusal::{Reason, Refusal};
use super::{Request, Staged, prove_motions};
use crate::gcode::rs274::ReadMotion;
use crate::gcode::{Dialect, Disagreement, RenderError, Transmission, Transmitted, Unit};
use crate::{Confirmed, target};
use machine::record::motion::{Block, Motion};
use machine::record::plan::Plan;
use machine::record::proof::Proof;
use machine::{Axis, Position};

/// A stage in the form in which it is sent.
#[derive(Debug, Clone, Copy)]
pub struct StageRequest<'a> {
    pub plan: &'a Plan,
    pub stages: &'a [Staged<'a>],
    /// As in [`Request`].
    pub stands: Option<&'a Position>,
    pub confirmed: Confirmed,
    pub dialect: &'a Dialect,
    pub transmission: &'a Transmission,
    /// The motions that the text must contain, in order.
    pub blocks: &'a [Block],
}

/// Error: a stage has no proven blocks. Nothing has moved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Unproven {
    #[error(transparent)]
    Unwritable(#[from] RenderError),
    #[error(transparent)]
    Refused(#[from] Refusal),
}

impl Unproven {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Unwritable(error) => error.remedy(),
            Self::Refused(refusal) => refusal.remedy().to_owned(),
        }
    }
}

/// Text of one block in the form in which it is sent, and the position at which the machine must be for it. Only
/// the proof creates it; it is executed once, and not changed in between.
#[derive(Debug)]
pub struct ProvenBlock {
    step: u32,
    begins: Position,
    transmission: Transmission,
    units: Vec<ProvenUnit>,
    digest: [u8; 32],
}

/// A unit, and the motions that the reader found in its text.
#[derive(Debug, Clone, PartialEq)]
pub struct ProvenUnit {
    pub unit: Unit,
    /// One motion for each of `unit.motions`.
    pub read: Vec<ReadMotion>,
}

/// Error: a block was changed after its proof.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("step {step}: the block is not the one that was proven")]
pub struct Altered {
    pub step: u32,
}

impl ProvenBlock {
    fn new(
        block: &Block,
        begins: Position,
        transmission: Transmission,
        units: Vec<ProvenUnit>,
    ) -> Self {
        let mut block = Self { step: block.step, begins, transmission, units, digest: [0; 32] };
        block.digest = block.computed_digest();
        block
    }

    /// Digest of all other fields.
    fn computed_digest(&self) -> [u8; 32] {
        let Self { step, begins, transmission, units, digest: _ } = self;
        Sha256::digest(format!("{step}{begins:?}{transmission:?}{units:?}")).into()
    }

    /// Form in which the control receives the block.
    pub fn transmission(&self) -> &Transmission {
        &self.transmission
    }

    pub fn step(&self) -> u32 {
        self.step
    }

    /// Position of the machine at the start of the block, machine coordinates: the axes whose position the proof
    /// knows.
    pub fn begins(&self) -> &Position {
        &self.begins
    }

    pub fn motions(&self) -> impl Iterator<Item = &Motion> {
        self.units.iter().flat_map(|part| &part.unit.motions)
    }

    /// Units to be sent.
    ///
    /// # Errors
    /// They differ from the proven units.
    pub fn units(&self) -> Result<&[ProvenUnit], Altered> {
        let is_proven = self.computed_digest() == self.digest;
        if is_proven { Ok(&self.units) } else { Err(Altered { step: self.step }) }
    }
}

/// Renders the blocks of a stage for their transmission, proves that text, and keeps it.
///
/// # Errors
/// A block cannot be rendered; the first line that is wrong or cannot be proven.
pub fn prove_blocks(request: &StageRequest<'_>) -> Result<(Proof, Vec<ProvenBlock>), Unproven> {
    let StageRequest { plan, stages, stands, confirmed, dialect, transmission, blocks } = *request;
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let sent = dialect.transmitted(transmission, &axes, blocks)?;
    let read = read_programs(dialect, &sent.programs)?;
    let programs = &sent.programs;
    let request = Request { plan, stages, stands, confirmed, dialect, programs };
    let proof = prove_motions(&request, read.clone())?;
    let begins = stands.cloned().unwrap_or_default();
    Ok((proof, proven_units(dialect, blocks, transmission, sent, read, begins)?))
}

/// Renders a block and reads it back; bodies are not checked.
///
/// # Errors
/// As [`prove_blocks`], except the checks of bodies.
pub(super) fn without_bodies(
    block: &Block,
    begins: Position,
    axes: &[Axis],
    dialect: &Dialect,
    transmission: &Transmission,
) -> Result<ProvenBlock, Unproven> {
    let sent = dialect.transmitted(transmission, axes, std::slice::from_ref(block))?;
    read_block(block, begins, dialect, transmission, sent)
}

/// Reads one rendered block back.
///
/// # Errors
/// The first fault that the reader finds.
pub(super) fn read_block(
    block: &Block,
    begins: Position,
    dialect: &Dialect,
    transmission: &Transmission,
    sent: Transmitted,
) -> Result<ProvenBlock, Unproven> {
    let blocks = std::slice::from_ref(block);
    let read = read_programs(dialect, &sent.programs)?;
    let mut proven = proven_units(dialect, blocks, transmission, sent, read, begins)?;
    proven.pop().ok_or(Unproven::Refused(refusal(1, Reason::Missing(block.step))))
}

/// Assigns to each unit its motions of `read`, and compares them with the rendered motions.
fn proven_units(
    dialect: &Dialect,
    blocks: &[Block],
    transmission: &Transmission,
    sent: Transmitted,
    read: Vec<ReadMotion>,
    mut begins: Position,
) -> Result<Vec<ProvenBlock>, Refusal> {
    check_line_lengths(transmission, &sent)?;
    let mut read = read.into_iter().peekable();
    let mut proven = Vec::new();
    let mut last_line = sent.head_lines;
    for (block, units) in blocks.iter().zip(sent.blocks) {
        let mut parts = Vec::new();
        for unit in units {
            last_line += unit.text.lines().count();
            let own = std::iter::from_fn(|| read.next_if(|motion| motion.line <= last_line));
            let read: Vec<ReadMotion> = own.collect();
            dialect.says(block.step, &unit.motions, &read).map_err(differs)?;
            parts.push(ProvenUnit { unit, read });
        }
        proven.push(ProvenBlock::new(block, begins.clone(), transmission.clone(), parts));
        begins = block.motions.iter().fold(begins, after);
    }
    match read.next() {
        None => Ok(proven),
        Some(motion) => Err(refusal(motion.line, Reason::NoStep)),
    }
}

/// Motions of programs that are sent one after the other, each read from an unknown state. The line numbers
/// continue from program to program.
pub(super) fn read_programs(
    dialect: &Dialect,
    programs: &[String],
) -> Result<Vec<ReadMotion>, Refusal> {
    let (mut all, mut before) = (Vec::new(), 0);
    for program in programs {
        let read = dialect
            .read_back(program)
            .map_err(|error| refusal(before + error.line, Reason::Unreadable(error.why)))?;
        all.extend(
            read.into_iter().map(|motion| ReadMotion { line: before + motion.line, ..motion }),
        );
        before += program.lines().count();
    }
    Ok(all)
}

fn check_line_lengths(transmission: &Transmission, sent: &Transmitted) -> Result<(), Refusal> {
    let Transmission::Lines { max_line_bytes } = *transmission else { return Ok(()) };
    let mut lines = sent.blocks.iter().flatten().flat_map(|unit| unit.text.lines());
    match lines.find(|line| line.len() >= max_line_bytes) {
        Some(line) => Err(refusal(1, Reason::LongLine(line.to_owned()))),
        None => Ok(()),
    }
}

/// Position of the machine after a motion; after a touch, the position of its axes is unknown.
fn after(stands: Position, motion: &Motion) -> Position {
    match motion {
        Motion::Probe { to, .. } => stands.only(|axis| to.get(axis).is_none()),
        motion => target(motion).map_or(stands.clone(), |to| stands.updated_by(&to)),
    }
}

fn differs(disagreement: Disagreement) -> Refusal {
    let line = match &disagreement {
        Disagreement::Motion { line, .. } => *line,
        _ => 1,
    };
    refusal(line, Reason::Differs(disagreement.to_string()))
}

fn refusal(line: usize, reason: Reason) -> Refusal {
    Refusal { step: None, line, reason }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{beside, plan};
    use super::*;

    fn proven() -> Vec<ProvenBlock> {
        let to = Position::new().with(Axis::X, 90.0);
        let motions = vec![Motion::Guarded { to, feed_mm_min: 100.0 }];
        let block = Block { step: 0, repeat: 0, motions };
        let axes: Vec<Axis> = plan(|_| {}).machine.axes.keys().copied().collect();
        let dialect = Dialect::named("grbl").unwrap();
        let transmission = Transmission::Lines { max_line_bytes: 80 };
        vec![without_bodies(&block, beside(), &axes, &dialect, &transmission).unwrap()]
    }

    #[test]
    fn a_unit_that_was_changed_after_the_proof_is_refused() {
        for change in 0..4 {
            let mut block = proven().remove(0);
            assert_eq!(block.units().unwrap().len(), 1);
            match change {
                0 => block.units[0].unit.text = block.units[0].unit.text.replace("X90", "X91"),
                1 => block.units[0].read[0].target = Position::new().with(Axis::X, 91.0),
                2 => block.begins = Position::new(),
                _ => block.transmission = Transmission::Rows,
            }
            assert_eq!(block.units(), Err(Altered { step: 0 }));
        }
    }

    #[test]
    fn motions_that_stand_in_another_unit_have_no_proof() {
        let dialect = Dialect::named("grbl").unwrap();
        let to = |x: f64| Position::new().with(Axis::X, x);
        let motions = [90.0, 95.0].map(|x| Motion::Guarded { to: to(x), feed_mm_min: 100.0 });
        let blocks = [Block { step: 0, repeat: 0, motions: motions.to_vec() }];
        let lines = Transmission::Lines { max_line_bytes: 80 };
        let sent = dialect.transmitted(&lines, &[Axis::X], &blocks).unwrap();
        let proven = |sent: Transmitted| {
            let read = read_programs(&dialect, &sent.programs)?;
            proven_units(&dialect, &blocks, &lines, sent, read, beside())
        };
        assert!(proven(sent.clone()).is_ok());
        let mut moved = sent;
        let [first, second] = moved.blocks[0].as_mut_slice() else { panic!("two units") };
        second.text = std::mem::take(&mut first.text) + &second.text;
        assert!(proven(moved).is_err());
    }

    #[test]
    fn a_block_whose_text_does_not_mean_it_has_no_proof() {
        // The block can be rendered, but a control reads no feed in it.
        let to = Position::new().with(Axis::Z, -20.0);
        let motions = vec![Motion::Guarded { to, feed_mm_min: -300.0 }];
        let block = Block { step: 3, repeat: 0, motions };
        let (dialect, lines) =
            (Dialect::named("grbl").unwrap(), Transmission::Lines { max_line_bytes: 80 });
        let refused = without_bodies(&block, Position::new(), &[Axis::Z], &dialect, &lines);
        assert!(matches!(refused, Err(Unproven::Refused(_))), "{refused:?}");
    }
}
