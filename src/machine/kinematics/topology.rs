//! Parser of the topology string: the order of the axes between workpiece and tool.

use std::fmt;
use std::str::FromStr;

use crate::Axis;

/// The two branches of a machine, each written from the bed outwards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topology {
    workpiece: Vec<Axis>,
    tool: Vec<Axis>,
}

impl Topology {
    /// Axes between bed and workpiece, beginning at the bed.
    pub fn workpiece(&self) -> &[Axis] {
        &self.workpiece
    }

    /// Axes between bed and tool, beginning at the bed; the spindle `S`, if any, is last.
    pub fn tool(&self) -> &[Axis] {
        &self.tool
    }

    pub fn contains(&self, axis: Axis) -> bool {
        self.axes().any(|a| a == axis)
    }

    pub fn axes(&self) -> impl Iterator<Item = Axis> + '_ {
        self.workpiece.iter().chain(&self.tool).copied()
    }

    fn check(&self) -> Result<(), Problem> {
        for axis in Axis::ALL {
            if self.axes().filter(|a| *a == axis).count() > 1 {
                return Err(Problem::Twice(axis));
            }
        }
        if let Some(missing) = Axis::LINEAR.into_iter().find(|axis| !self.contains(*axis)) {
            return Err(Problem::NoLinear(missing));
        }
        if self.contains(Axis::S) && self.tool.last() != Some(&Axis::S) {
            return Err(Problem::SpindlePlace);
        }
        match self.axes().filter(|a| *a != Axis::S).count() {
            3..=5 => Ok(()),
            count => Err(Problem::Count(count)),
        }
    }
}

/// Compact form, e.g. `wCBXFZYSt`.
impl fmt::Display for Topology {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let workpiece: String = self.workpiece.iter().rev().map(|a| a.letter()).collect();
        let tool: String = self.tool.iter().map(|a| a.letter()).collect();
        write!(f, "w{workpiece}F{tool}t")
    }
}

/// Parses `w-C-B-X-F-Z-Y-S-t`, `V[w-C-B-b-Y-X-Z-(C)-t]` (ISO 10791 style) and both without dashes: from workpiece
/// to tool, bed `F` or `b`, spindle `S` or `(C)`.
impl FromStr for Topology {
    type Err = TopologyError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        read(text).map_err(|problem| TopologyError { text: text.to_owned(), problem })
    }
}

fn read(text: &str) -> Result<Topology, Problem> {
    let plain: String = unbracketed(text)?
        .replace("(C)", "S")
        .chars()
        .filter(|c| *c != '-' && !c.is_whitespace())
        .collect();
    let middle = plain.strip_prefix('w').ok_or(Problem::Ends)?;
    let middle = middle.strip_suffix('t').ok_or(Problem::Ends)?;
    let mut sides = middle.split(['F', 'b']);
    let (Some(workpiece), Some(tool), None) = (sides.next(), sides.next(), sides.next()) else {
        return Err(Problem::Bed);
    };
    let mut workpiece = axes(workpiece)?;
    workpiece.reverse();
    let topology = Topology { workpiece, tool: axes(tool)? };
    topology.check()?;
    Ok(topology)
}

/// The text between the brackets of `V[..]`, or the whole text without brackets.
fn unbracketed(text: &str) -> Result<&str, Problem> {
    match text.trim().split_once('[') {
        None => Ok(text.trim()),
        Some((_, rest)) => rest.strip_suffix(']').ok_or(Problem::Bracket),
    }
}

fn axes(letters: &str) -> Result<Vec<Axis>, Problem> {
    letters
        .chars()
        .map(|letter| letter.to_string().parse().map_err(|_| Problem::Letter(letter)))
        .collect()
}

/// Error: the topology cannot be parsed; the message contains an example.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "topology `{text}`: {problem} (from workpiece to tool, e.g. `w-C-B-X-F-Z-Y-S-t` or `V[w-C-B-b-Y-X-Z-(C)-t]`)"
)]
pub struct TopologyError {
    pub text: String,
    pub problem: Problem,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    #[error("begin with the workpiece `w` and end with the tool `t`")]
    Ends,
    #[error("close the bracket `[` with `]` at the end")]
    Bracket,
    #[error("name the bed exactly once, as `F` or `b`, between workpiece and tool axes")]
    Bed,
    #[error("`{0}` is no axis; write X, Y, Z, A, B, C, the spindle as `S` or `(C)`")]
    Letter(char),
    #[error("{0} stands twice; write each axis once")]
    Twice(Axis),
    #[error("{0} is missing; a machine needs X, Y and Z")]
    NoLinear(Axis),
    #[error("the spindle `S` or `(C)` stands directly before `t`")]
    SpindlePlace,
    #[error("{0} axes; write three to five and, if there is one, the spindle")]
    Count(usize),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_notations_give_the_same_branches() {
        let expected: Topology = "w-C-B-b-Y-X-Z-S-t".parse().unwrap();
        assert_eq!(expected.workpiece(), [Axis::B, Axis::C]);
        assert_eq!(expected.tool(), [Axis::Y, Axis::X, Axis::Z, Axis::S]);
        for text in
            ["V[w-C-B-b-Y-X-Z-(C)-t]", "V [w-C-B-b-Y-X-Z-(C)-t]", "wCBbYXZ(C)t", "wCBFYXZSt"]
        {
            assert_eq!(text.parse::<Topology>().unwrap(), expected, "{text}");
        }
        assert_eq!(expected.to_string(), "wCBFYXZSt");
    }

    #[test]
    fn three_to_five_axes_with_and_without_a_spindle() {
        for text in ["wFXYZt", "wXYZFt", "wCAYFXZt", "wCBFXYZt", "wAFXYZBt", "wCBXFZYSt"] {
            assert_eq!(text.parse::<Topology>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn a_wrong_topology_says_what_to_write() {
        let problem = |text: &str| text.parse::<Topology>().unwrap_err().problem;
        assert_eq!(problem("C-B-X-F-Z-Y-t"), Problem::Ends);
        assert_eq!(problem("w-C-B-X-F-Z-Y"), Problem::Ends);
        assert_eq!(problem("V[w-C-b-X-Y-Z-t"), Problem::Bracket);
        assert_eq!(problem("wCBXZYt"), Problem::Bed);
        assert_eq!(problem("wCBXFZbYt"), Problem::Bed);
        assert_eq!(problem("wCUFXYZt"), Problem::Letter('U'));
        assert_eq!(problem("wCFXYZ(B)t"), Problem::Letter('('));
        assert_eq!(problem("wCCFXYZt"), Problem::Twice(Axis::C));
        assert_eq!(problem("wCBFXYt"), Problem::NoLinear(Axis::Z));
        assert_eq!(problem("wCFXYSZt"), Problem::SpindlePlace);
        assert_eq!(problem("wSCFXYZt"), Problem::SpindlePlace);
        assert_eq!(problem("wABCFXYZt"), Problem::Count(6));
        assert_eq!(problem(""), Problem::Ends);
    }
}
