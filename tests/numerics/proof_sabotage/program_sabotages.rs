//! Modifications of a program. Each changes a copy of the lines at a step and returns the range of lines (indices
//! into the modified lines, both included) in which the error must be named.

use machine::record::artefact::Artefact;

use super::rendered_plan::{RenderedPlan, StepLines};

pub type ProgramLines = Vec<String>;
/// First and last line that the refusal may name, as indices from 0.
pub type LineRange = (usize, usize);
/// Modifies the lines at the step with this id; `None` if the modification does not apply to this step.
pub type Sabotage = fn(&RenderedPlan, &mut ProgramLines, u32) -> Option<LineRange>;

pub const SABOTAGES: [(&str, Sabotage); 59] = [
    ("wrong sense of C", reverse_c_angle),
    ("C misses a digit", |p, l, id| change_c_angle(p, l, id, |c| c / 10.0)),
    ("C a full turn on", |p, l, id| change_c_angle(p, l, id, |c| c - 360.0 * c.signum())),
    ("inches from the head on", |_, l, _| {
        let at = replace_in_first_line(l, |line| line.starts_with("G21"), "G21", "G20")?;
        let first = RenderedPlan::next_step_line(l, at);
        // Zero is the same position in inches.
        let moves = |line: &str| {
            let words = line.split(' ').filter_map(|word| word.strip_prefix(['X', 'Y', 'Z']));
            words.filter_map(|number| number.parse::<f64>().ok()).any(|number| number != 0.0)
        };
        Some((first, (first..l.len()).find(|i| moves(&l[*i]))?))
    }),
    ("inches before a touch", |p, l, id| insert_line_before(l, p.lines_of_step(id).touch_line, "G20", 1)),
    ("inches before the approach", |p, l, id| insert_line_before(l, p.lines_of_step(id).approach_line, "G20", 1)),
    ("a live G54 from the head on", |_, l, _| {
        let slot = |line: &str| line == "G59" || line == "G59.3";
        let at = l.iter().position(|line| slot(line))?;
        l[at] = "G54".to_owned();
        first_work_move(l, at)
    }),
    ("a live G54 before a touch", |p, l, id| insert_line_before(l, p.lines_of_step(id).touch_line, "G54", 1)),
    ("no G49", |_, l, _| {
        let at = replace_in_first_line(l, |line| line.starts_with("G21"), " G49", "")?;
        first_work_move(l, at)
    }),
    ("no G92.1 and no G92.2", |_, l, _| {
        let at = l.iter().position(|line| line.starts_with("G92."))?;
        l.remove(at);
        first_work_move(l, at)
    }),
    ("G64 for G61", |_, l, _| {
        let at = replace_in_first_line(l, |line| line.starts_with("G21"), "G61", "G64")?;
        Some((at, at))
    }),
    ("no G94", |_, l, _| {
        let at = replace_in_first_line(l, |line| line.starts_with("G21"), " G94", "")?;
        let first = RenderedPlan::next_step_line(l, at);
        Some((first, first))
    }),
    ("a fast first approach", |p, l, _| {
        let down = p.lines_of_step(0).approach_line;
        let fast = p.plan.probe.guarded_feed_mm_min;
        change_word_values(l, down, &['F'], |_| fast).then_some((down, down))
    }),
    ("G43", |p, l, id| insert_line_before(l, p.lines_of_step(id).approach_line, "G43 H1", 0)),
    ("G68", |p, l, id| insert_line_before(l, p.lines_of_step(id).approach_line, "G68 R10", 0)),
    ("G92", |p, l, id| insert_line_before(l, p.lines_of_step(id).touch_line, "G92 X0", 0)),
    ("an offset in the slot", |p, l, id| insert_line_before(l, p.lines_of_step(id).touch_line, "G10 L2 P6 X0.5", 0)),
    ("G0 for the way back", |p, l, id| replace_in_line(l, p.lines_of_step(id).back_off_line, "G1", "G0")),
    ("G0 for the approach", |p, l, id| replace_in_line(l, p.lines_of_step(id).approach_line, "G38.3", "G53 G0")),
    ("G0 for the touch", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, "G38.3", "G53 G0")),
    ("G0 for the way up", |p, l, id| replace_in_line(l, p.lines_of_step(id).retract_line, "G38.3", "G53 G0")),
    ("G1 for the touch", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, "G38.3", "G53 G1")),
    ("G1 for the approach", |p, l, id| replace_in_line(l, p.lines_of_step(id).approach_line, "G38.3", "G53 G1")),
    ("G2 for G1", |p, l, id| replace_in_line(l, p.lines_of_step(id).back_off_line, "G1", "G2")),
    ("G38.5 for G38.3", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, "G38.3", "G38.5")),
    ("contact demanded of the approach", |p, l, id| {
        replace_in_line(l, p.lines_of_step(id).approach_line, "G38.3", "G38.2")
    }),
    ("5 mm too deep", |p, l, id| {
        let at = p.lines_of_step(id).touch_line;
        let deeper = |v: f64| if v.abs() < 6.0 { v + 5.0 } else { v - 5.0 * v.signum() };
        change_word_values(l, at, &['X', 'Y'], deeper).then_some((at, at))
    }),
    ("5 mm short", |p, l, id| {
        let at = p.lines_of_step(id).touch_line;
        change_word_values(l, at, &['X', 'Y'], |v| v + 5.0 * v.signum()).then_some((at, at))
    }),
    ("the approach 5 mm too low", |p, l, id| {
        let StepLines { approach_line: down, touch_line: touch, .. } = p.lines_of_step(id);
        change_word_values(l, down, &['Z'], |z| z - 5.0).then_some((down, touch))
    }),
    ("the approach 0.01 mm too high", |p, l, id| {
        let StepLines { approach_line: down, touch_line: touch, .. } = p.lines_of_step(id);
        change_word_values(l, down, &['Z'], |z| z + 0.01).then_some((touch, touch))
    }),
    ("no way up", |p, l, id| {
        let StepLines { retract_line: up, .. } = p.lines_of_step(id);
        l.remove(up);
        let next = RenderedPlan::next_step_line(l, up - 1);
        Some((up - 1, next))
    }),
    ("no way back", |p, l, id| {
        let StepLines { back_off_line: back, .. } = p.lines_of_step(id);
        l.remove(back);
        let next = RenderedPlan::next_step_line(l, back - 1);
        Some((next, next))
    }),
    ("no touch", |p, l, id| {
        let StepLines { touch_line: touch, .. } = p.lines_of_step(id);
        l.remove(touch);
        let next = RenderedPlan::next_step_line(l, touch - 1);
        Some((next, next))
    }),
    ("no approach", |p, l, id| {
        let StepLines { approach_line: down, touch_line: touch, back_off_line: back, .. } = p.lines_of_step(id);
        l.remove(down);
        // High above, the touch is a harmless guarded move; its back-off is not.
        Some((touch - 1, back - 1))
    }),
    ("no way over", |p, l, id| {
        let StepLines { traverse_line: over, back_off_line: back, .. } = p.lines_of_step(id);
        l.remove(over?);
        Some((over?, back - 1))
    }),
    ("C with the probe down, before the touch", |p, l, id| {
        insert_line_before(l, p.lines_of_step(id).touch_line, &format!("N{id} G53 G0 C17"), 0)
    }),
    ("C with the probe down, after the way back", |p, l, id| {
        insert_line_before(l, p.lines_of_step(id).retract_line, &format!("N{id} G53 G0 C17"), 0)
    }),
    ("the tilting axis with the probe down", |p, l, id| {
        let tilt = p.plan.machine.axes.keys().find(|axis| matches!(axis.letter(), 'A' | 'B'))?;
        insert_line_before(l, p.lines_of_step(id).retract_line, &format!("N{id} G53 G0 {tilt}20"), 0)
    }),
    ("the tilting axis in a guarded move", |p, l, id| {
        let tilt = p.plan.machine.axes.keys().find(|axis| matches!(axis.letter(), 'A' | 'B'))?;
        insert_line_before(l, p.lines_of_step(id).retract_line, &format!("N{id} G38.3 {tilt}20 F100"), 0)
    }),
    ("X and Y swapped in the touch", |p, l, id| {
        let at = p.lines_of_step(id).touch_line;
        swap_x_and_y_words(l, at).then_some((at, at))
    }),
    ("X and Y swapped on the way over", |p, l, id| {
        let StepLines { traverse_line: over, back_off_line: back, .. } = p.lines_of_step(id);
        let [x, y] = ['X', 'Y'].map(|axis| word_value(&l[over?], axis));
        (x != y && swap_x_and_y_words(l, over?)).then_some((over?, back))
    }),
    ("a sign lost on the way over", |p, l, id| {
        let StepLines { traverse_line: over, back_off_line: back, .. } = p.lines_of_step(id);
        replace_in_line(l, over?, "-", "").map(|_| (over.unwrap_or(0), back))
    }),
    ("an unclosed bracket", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, "G38.3", "(G38.3")),
    ("a bracket that swallows the approach", |p, l, id| {
        let StepLines { approach_line: down, touch_line: touch, back_off_line: back, .. } = p.lines_of_step(id);
        l[down] = format!("({})", l[down]);
        Some((touch, back))
    }),
    ("a semicolon before the way back", |p, l, id| {
        let StepLines { back_off_line: back, .. } = p.lines_of_step(id);
        l[back] = format!(";{}", l[back]);
        let next = RenderedPlan::next_step_line(l, back);
        Some((next, next))
    }),
    ("a semicolon in the touch", |p, l, id| {
        let StepLines { touch_line: touch, back_off_line: back, .. } = p.lines_of_step(id);
        l[touch] = l[touch].replacen(" F", "; F", 1);
        Some((touch, back))
    }),
    ("G91", |p, l, id| {
        let StepLines { touch_line: touch, back_off_line: back, .. } = p.lines_of_step(id);
        l.insert(touch, "G91".to_owned());
        Some((touch + 1, back + 1))
    }),
    ("the touch ten times as fast", |p, l, id| {
        let at = p.lines_of_step(id).touch_line;
        change_word_values(l, at, &['F'], |f| 10.0 * f).then_some((at, at))
    }),
    ("the approach ten times as fast", |p, l, id| {
        let at = p.lines_of_step(id).approach_line;
        change_word_values(l, at, &['F'], |f| 10.0 * f).then_some((at, at))
    }),
    ("the way back ten times as fast", |p, l, id| {
        let at = p.lines_of_step(id).back_off_line;
        change_word_values(l, at, &['F'], |f| 10.0 * f).then_some((at, at))
    }),
    ("the N word of another step", |p, l, id| {
        replace_in_line(l, p.lines_of_step(id).touch_line, &format!("N{id} "), &format!("N{} ", id + 3))
    }),
    ("no N word", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, &format!("N{id} "), "")),
    ("the touch twice", |p, l, id| {
        let StepLines { touch_line: touch, .. } = p.lines_of_step(id);
        l.insert(touch, l[touch].clone());
        Some((touch + 1, touch + 1))
    }),
    ("another touch after the way back", |p, l, id| {
        let StepLines { touch_line: touch, back_off_line: back, .. } = p.lines_of_step(id);
        l.insert(back + 1, l[touch].clone());
        Some((back + 1, back + 1))
    }),
    ("a decimal point one place on", |p, l, id| {
        let at = p.lines_of_step(id).touch_line;
        change_word_values(l, at, &['X', 'Y'], |v| 10.0 * v).then_some((at, at))
    }),
    ("two steps in the wrong order", |p, l, id| {
        let (one, other) = (p.lines_of_step(id), p.lines_of_step(id + 1));
        let second: ProgramLines = l.drain(other.first_line..=other.last_line).collect();
        l.splice(one.first_line..one.first_line, second);
        Some((one.first_line, one.first_line))
    }),
    ("a step left out", |p, l, id| {
        let StepLines { first_line: first, last_line: last, .. } = p.lines_of_step(id);
        l.drain(first..=last);
        let next = RenderedPlan::next_step_line(l, first - 1);
        Some((next, next))
    }),
    ("beyond a limit", |p, l, id| replace_in_line(l, p.lines_of_step(id).retract_line, "Z", "Z9")),
    ("cut off", |p, l, id| {
        let StepLines { touch_line: touch, .. } = p.lines_of_step(id);
        l.truncate(touch + 1);
        Some((touch, touch))
    }),
];

/// Modifications that need a spindle that follows, and words that are not allowed there.
pub const EXTRA_SABOTAGES: [(&str, Sabotage); 7] = [
    ("S not oriented", |p, l, id| {
        let StepLines { spindle_orientation_line: orient, touch_line: touch, .. } = p.lines_of_step(id);
        l.remove(orient?);
        Some((touch - 1, touch - 1))
    }),
    ("S with the probe down", |p, l, id| {
        insert_line_before(l, p.lines_of_step(id).retract_line, &format!("N{id} M19 R45"), 0)
    }),
    ("the spindle turns", |p, l, id| insert_line_before(l, p.lines_of_step(id).approach_line, "M3 S1000", 0)),
    ("the program ends early", |p, l, id| {
        let up = p.lines_of_step(id).retract_line;
        l.insert(up, "M2".to_owned());
        let next = RenderedPlan::next_step_line(l, up);
        Some((up, next))
    }),
    ("a decimal comma", |p, l, id| replace_in_line(l, p.lines_of_step(id).touch_line, ".", ",")),
    ("the way up through the part", |p, l, id| {
        // Between balls there is free space.
        let round = matches!(p.plan.artefact, Artefact::Cylinder(_));
        round.then(|| replace_in_line(l, p.lines_of_step(id).retract_line, " Z", " X0 Y0 Z")).flatten()
    }),
    ("an endless number", |p, l, id| {
        replace_in_line(l, p.lines_of_step(id).retract_line, " Z", &format!(" Z{}", "9".repeat(400)))
    }),
];

fn reverse_c_angle(p: &RenderedPlan, l: &mut ProgramLines, id: u32) -> Option<LineRange> {
    change_c_angle(p, l, id, |c| if c.abs() % 180.0 == 0.0 { c } else { -c })
}

fn change_c_angle(p: &RenderedPlan, l: &mut ProgramLines, id: u32, change: fn(f64) -> f64) -> Option<LineRange> {
    let StepLines { c_rotation_line: turn, touch_line: touch, .. } = p.lines_of_step(id);
    change_word_values(l, turn?, &['C'], change).then_some((turn?, touch))
}

/// Inserts a line before the line `at`; the error is expected `later` lines after it.
fn insert_line_before(l: &mut ProgramLines, at: usize, line: &str, later: usize) -> Option<LineRange> {
    l.insert(at, line.to_owned());
    Some((at + later, at + later))
}

fn replace_in_line(l: &mut ProgramLines, at: usize, from: &str, to: &str) -> Option<LineRange> {
    let spoiled = l[at].replacen(from, to, 1);
    let differs = spoiled != l[at];
    l[at] = spoiled;
    differs.then_some((at, at))
}

fn replace_in_first_line(l: &mut ProgramLines, which: fn(&str) -> bool, from: &str, to: &str) -> Option<usize> {
    let at = l.iter().position(|line| which(line))?;
    replace_in_line(l, at, from, to).map(|_| at)
}

/// The first move in work coordinates after the line `at`.
fn first_work_move(l: &ProgramLines, at: usize) -> Option<LineRange> {
    let found = (at..l.len()).find(|i| l[*i].contains("G38.3"))?;
    Some((found, found))
}

fn word_value(line: &str, letter: char) -> Option<f64> {
    let word = line.split(' ').find(|word| word.starts_with(letter))?;
    word[1..].parse().ok()
}

/// Changes the words with these letters in a line; returns false if nothing changed.
pub fn change_word_values(l: &mut ProgramLines, at: usize, letters: &[char], change: impl Fn(f64) -> f64) -> bool {
    let word = |word: &str| {
        let number = word.chars().next().filter(|c| letters.contains(c)).map(|_| &word[1..]);
        match number.and_then(|number| number.parse::<f64>().ok()) {
            Some(value) => format!("{}{:.6}", &word[..1], change(value)),
            None => word.to_owned(),
        }
    };
    let same = |a: &str, b: &str| letters.iter().all(|letter| word_value(a, *letter) == word_value(b, *letter));
    let spoiled = l[at].split(' ').map(word).collect::<Vec<_>>().join(" ");
    let differs = !same(&spoiled, &l[at]);
    l[at] = spoiled;
    differs
}

fn swap_x_and_y_words(l: &mut ProgramLines, at: usize) -> bool {
    let swap = |word: &str| match word.chars().next() {
        Some('X') => word.replacen('X', "Y", 1),
        Some('Y') => word.replacen('Y', "X", 1),
        _ => word.to_owned(),
    };
    l[at] = l[at].split(' ').map(swap).collect::<Vec<_>>().join(" ");
    true
}
