//! Usual topology of a machine with the given axes. The operator corrects it.

use machine::Axis;

/// Topology of trunnion tables, after ISO 10791, with at most two rotary axes of `driven`: the rotary axes carry the
/// part, the linear axes the spindle.
pub(super) fn default_topology(driven: &[Axis]) -> String {
    let has = |axis: &Axis| driven.contains(axis);
    let rotary: &[Axis] = match [Axis::A, Axis::B, Axis::C].map(|axis| has(&axis)) {
        [_, true, true] => &[Axis::C, Axis::B],
        [true, false, true] => &[Axis::C, Axis::A],
        [true, true, false] => &[Axis::B, Axis::A],
        [true, ..] => &[Axis::A],
        [_, true, _] => &[Axis::B],
        [_, _, true] => &[Axis::C],
        _ => &[],
    };
    let linear = [Axis::Y, Axis::X, Axis::Z].into_iter().filter(has);
    let name = |axis: Axis| axis.to_string();
    let start = std::iter::once("w".to_owned()).chain(rotary.iter().copied().map(name));
    let end = std::iter::once("b".to_owned()).chain(linear.map(name));
    let all: Vec<String> = start.chain(end).chain(["(C)".to_owned(), "t".to_owned()]).collect();
    format!("V[{}]", all.join("-"))
}

/// Axes of the topology that move, sorted; the spindle is left out.
pub(super) fn moving_axes(topology: &str) -> Vec<Axis> {
    let mut axes: Vec<Axis> = topology_components(topology)
        .filter_map(|letter| letter.parse().ok())
        .filter(|axis| *axis != Axis::S)
        .collect();
    axes.sort();
    axes
}

/// Components from the workpiece `w` to the tool `t`, as written.
fn topology_components(topology: &str) -> impl Iterator<Item = &str> {
    let inside = topology.trim_start_matches("V[").trim_end_matches(']');
    inside.split('-')
}

/// The topology in words, for readers who do not know the notation.
pub(super) fn describe_topology(topology: &str) -> String {
    let component_name = |letter: &str| match letter {
        "w" => "workpiece".to_owned(),
        "b" | "F" => "bed".to_owned(),
        "t" => "tool".to_owned(),
        "(C)" | "S" => "spindle".to_owned(),
        axis => axis.to_owned(),
    };
    let words: Vec<String> = topology_components(topology).map(component_name).collect();
    words.join(", ")
}
