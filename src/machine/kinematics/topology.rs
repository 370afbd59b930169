//! Parser of the topology string: the order of the axes between workpiece and tool.

use std::fmt;
use std::str::FromStr;

use crate::Axis;

/// The two branches of a machine, each written from the bed outwards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topology {
    workpiece_branch: Vec<Axis>,
    tool_branch: Vec<Axis>,
}

impl Topology {
    /// Axes between bed and workpiece, beginning at the bed.
    pub fn workpiece_branch(&self) -> &[Axis] {
        &self.workpiece_branch
    }

    /// Axes between bed and tool, beginning at the bed; the spindle `S`, if any, is last.
    pub fn tool_branch(&self) -> &[Axis] {
        &self.tool_branch
    }

    /// Whether `carrier` moves `axis`: it is nearer to the bed in the same branch.
    pub fn is_carried_by(&self, axis: Axis, carrier: Axis) -> bool {
        [&self.workpiece_branch, &self.tool_branch].into_iter().any(|branch| {
            let index = |wanted: Axis| branch.iter().position(|own| *own == wanted);
            index(carrier).zip(index(axis)).is_some_and(|(carrier, axis)| carrier < axis)
        })
    }

    pub fn contains(&self, axis: Axis) -> bool {
        self.axes().any(|a| a == axis)
    }

    /// All axes, each branch from the bed outwards: the workpiece branch, then the tool branch with `S`.
    pub fn axes(&self) -> impl Iterator<Item = Axis> + '_ {
        self.workpiece_branch.iter().chain(&self.tool_branch).copied()
    }

    /// Checks that no axis occurs twice, that X, Y and Z occur, that `S`, if any, is the last axis of the tool branch,
    /// and that there are three to five axes besides `S`.
    fn check_axes(&self) -> Result<(), TopologyProblem> {
        for axis in Axis::ALL {
            if self.axes().filter(|a| *a == axis).count() > 1 {
                return Err(TopologyProblem::DuplicateAxis(axis));
            }
        }
        if let Some(missing) = Axis::LINEAR.into_iter().find(|axis| !self.contains(*axis)) {
            return Err(TopologyProblem::MissingLinearAxis(missing));
        }
        if self.contains(Axis::S) && self.tool_branch.last() != Some(&Axis::S) {
            return Err(TopologyProblem::SpindleNotLast);
        }
        match self.axes().filter(|a| *a != Axis::S).count() {
            3..=5 => Ok(()),
            count => Err(TopologyProblem::UnsupportedAxisCount(count)),
        }
    }
}

/// Compact form, e.g. `wCBXFZYSt`.
impl fmt::Display for Topology {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let workpiece: String = self.workpiece_branch.iter().rev().map(|a| a.letter()).collect();
        let tool: String = self.tool_branch.iter().map(|a| a.letter()).collect();
        write!(f, "w{workpiece}F{tool}t")
    }
}

/// Parses `w-C-B-X-F-Z-Y-S-t`, `V[w-C-B-b-Y-X-Z-(C)-t]` (ISO 10791 style) and both without dashes: from workpiece
/// to tool, bed `F` or `b`, spindle `S` or `(C)`.
impl FromStr for Topology {
    type Err = TopologyError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse_topology(text).map_err(|problem| TopologyError { text: text.to_owned(), problem })
    }
}

fn parse_topology(text: &str) -> Result<Topology, TopologyProblem> {
    let plain: String =
        strip_brackets(text)?.replace("(C)", "S").chars().filter(|c| *c != '-' && !c.is_whitespace()).collect();
    let middle = plain.strip_prefix('w').ok_or(TopologyProblem::MissingWorkpieceOrTool)?;
    let middle = middle.strip_suffix('t').ok_or(TopologyProblem::MissingWorkpieceOrTool)?;
    let mut sides = middle.split(['F', 'b']);
    let (Some(workpiece), Some(tool), None) = (sides.next(), sides.next(), sides.next()) else {
        return Err(TopologyProblem::NotExactlyOneBed);
    };
    let mut workpiece = parse_axes(workpiece)?;
    workpiece.reverse();
    let topology = Topology { workpiece_branch: workpiece, tool_branch: parse_axes(tool)? };
    topology.check_axes()?;
    Ok(topology)
}

/// The text between the brackets of `V[..]`, or the whole text without brackets.
fn strip_brackets(text: &str) -> Result<&str, TopologyProblem> {
    match text.trim().split_once('[') {
        None => Ok(text.trim()),
        Some((_, rest)) => rest.strip_suffix(']').ok_or(TopologyProblem::UnclosedBracket),
    }
}

fn parse_axes(letters: &str) -> Result<Vec<Axis>, TopologyProblem> {
    letters
        .chars()
        .map(|letter| letter.to_string().parse().map_err(|_| TopologyProblem::UnknownLetter(letter)))
        .collect()
}

/// Error: the topology cannot be parsed; the message contains an example.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("topology `{text}`: {problem} (from workpiece to tool, e.g. `w-C-B-X-F-Z-Y-S-t` or `V[w-C-B-b-Y-X-Z-(C)-t]`)")]
pub struct TopologyError {
    pub text: String,
    pub problem: TopologyProblem,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TopologyProblem {
    #[error("the ends are missing; begin with the workpiece `w` and end with the tool `t`")]
    MissingWorkpieceOrTool,
    #[error("the bracket `[` is not closed; add `]` at the end")]
    UnclosedBracket,
    #[error("the bed must occur exactly once; write it as `F` or `b` between workpiece and tool axes")]
    NotExactlyOneBed,
    #[error("`{0}` is not an axis; write X, Y, Z, A, B or C, and the spindle as `S` or `(C)`")]
    UnknownLetter(char),
    #[error("axis {0} occurs twice; write each axis once")]
    DuplicateAxis(Axis),
    #[error("axis {0} is missing; a machine needs X, Y and Z")]
    MissingLinearAxis(Axis),
    #[error("the spindle is not the last axis; write `S` or `(C)` directly before `t`")]
    SpindleNotLast,
    #[error("the topology has {0} axes; write three to five, and the spindle if it can be oriented")]
    UnsupportedAxisCount(usize),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_notations_give_the_same_branches() {
        let expected: Topology = "w-C-B-b-Y-X-Z-S-t".parse().unwrap();
        assert_eq!(expected.workpiece_branch(), [Axis::B, Axis::C]);
        assert_eq!(expected.tool_branch(), [Axis::Y, Axis::X, Axis::Z, Axis::S]);
        for text in ["V[w-C-B-b-Y-X-Z-(C)-t]", "V [w-C-B-b-Y-X-Z-(C)-t]", "wCBbYXZ(C)t", "wCBFYXZSt"] {
            assert_eq!(text.parse::<Topology>().unwrap(), expected, "{text}");
        }
        assert_eq!(expected.to_string(), "wCBFYXZSt");
    }

    #[test]
    fn topologies_of_three_to_five_axes_parse_and_print_unchanged() {
        for text in ["wFXYZt", "wXYZFt", "wCAYFXZt", "wCBFXYZt", "wAFXYZBt", "wCBXFZYSt"] {
            assert_eq!(text.parse::<Topology>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn each_topology_error_has_its_own_variant() {
        let problem = |text: &str| text.parse::<Topology>().unwrap_err().problem;
        assert_eq!(problem("C-B-X-F-Z-Y-t"), TopologyProblem::MissingWorkpieceOrTool);
        assert_eq!(problem("w-C-B-X-F-Z-Y"), TopologyProblem::MissingWorkpieceOrTool);
        assert_eq!(problem("V[w-C-b-X-Y-Z-t"), TopologyProblem::UnclosedBracket);
        assert_eq!(problem("wCBXZYt"), TopologyProblem::NotExactlyOneBed);
        assert_eq!(problem("wCBXFZbYt"), TopologyProblem::NotExactlyOneBed);
        assert_eq!(problem("wCUFXYZt"), TopologyProblem::UnknownLetter('U'));
        assert_eq!(problem("wCFXYZ(B)t"), TopologyProblem::UnknownLetter('('));
        assert_eq!(problem("wCCFXYZt"), TopologyProblem::DuplicateAxis(Axis::C));
        assert_eq!(problem("wCBFXYt"), TopologyProblem::MissingLinearAxis(Axis::Z));
        assert_eq!(problem("wCFXYSZt"), TopologyProblem::SpindleNotLast);
        assert_eq!(problem("wSCFXYZt"), TopologyProblem::SpindleNotLast);
        assert_eq!(problem("wABCFXYZt"), TopologyProblem::UnsupportedAxisCount(6));
        assert_eq!(problem(""), TopologyProblem::MissingWorkpieceOrTool);
    }
}
