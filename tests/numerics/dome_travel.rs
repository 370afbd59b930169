//! The order in which the balls of the dome are measured against a long search: simulated annealing within the balls of
//! each indexation, with the way from one indexation to the next. Its times are reckoned from the machine file.

use machine::Axis;
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use rand::{Rng, RngExt};
use trued::setup::{self, MachineFile};

use estimation::random::stream;
use testing::population::is_full;

/// Centre of a ball in X and Y, mm.
type Place = [f64; 2];

/// Of each indexation the balls in the order of the plan, by the touches at their poles.
fn visits(plan: &Plan) -> Vec<Vec<Place>> {
    let mut visits: Vec<(String, Vec<Place>)> = Vec::new();
    let poles = plan.steps.iter().filter(|step| step.label.ends_with("/pole"));
    for step in poles.filter(|step| step.label.starts_with("slow/")) {
        let visit = step.label.split('/').nth(1).unwrap();
        if visits.last().is_none_or(|(last, _)| last != visit) {
            visits.push((visit.to_owned(), Vec::new()));
        }
        let place = [Axis::X, Axis::Y].map(|axis| step.to.at(axis));
        visits.last_mut().unwrap().1.push(place);
    }
    visits.into_iter().map(|(_, places)| places).collect()
}

/// From rest to rest, s: both axes within their speed and acceleration.
fn way_s(machine: &Machine, from: Place, to: Place) -> f64 {
    let of_axis = |(k, axis): (usize, Axis)| {
        let (way, spec) = ((to[k] - from[k]).abs(), &machine.axes[&axis]);
        let (speed, acceleration) = (spec.rapid_per_min / 60.0, spec.acceleration_per_s2);
        match way > speed * speed / acceleration {
            true => way / speed + speed / acceleration,
            false => 2.0 * (way / acceleration).sqrt(),
        }
    };
    [Axis::X, Axis::Y].into_iter().enumerate().map(of_axis).fold(0.0, f64::max)
}

/// Places of all indexations, one after the other, with the bounds of each.
struct Tour {
    order: Vec<usize>,
    bounds: Vec<[usize; 2]>,
    between: Vec<Vec<f64>>,
}

impl Tour {
    fn new(machine: &Machine, visits: &[Vec<Place>]) -> Self {
        let all: Vec<Place> = visits.concat();
        let mut bounds: Vec<[usize; 2]> = Vec::new();
        for visit in visits {
            let first = bounds.last().map_or(0, |[_, end]| *end);
            bounds.push([first, first + visit.len()]);
        }
        let from = |a: &Place| all.iter().map(|b| way_s(machine, *a, *b)).collect();
        Self { order: (0..all.len()).collect(), bounds, between: all.iter().map(from).collect() }
    }

    fn step_s(&self, at: usize) -> f64 {
        let next = self.order.get(at + 1);
        next.map_or(0.0, |next| self.between[self.order[at]][*next])
    }

    fn time_s(&self) -> f64 {
        (0..self.order.len()).map(|at| self.step_s(at)).sum()
    }

    /// Change of the time by turning a piece round: only its ends change.
    fn turned_s(&self, [from, to]: [usize; 2]) -> f64 {
        let cost = |a: Option<usize>, b: Option<usize>| match (a, b) {
            (Some(a), Some(b)) => self.between[self.order[a]][self.order[b]],
            _ => 0.0,
        };
        let (before, after) =
            (from.checked_sub(1), Some(to + 1).filter(|at| *at < self.order.len()));
        cost(before, Some(to)) + cost(Some(from), after)
            - cost(before, Some(from))
            - cost(Some(to), after)
    }

    /// The best time that turning pieces round and moving single balls finds from here on.
    fn anneal(&mut self, random: &mut impl Rng, tries: u64) -> f64 {
        let (mut time, mut best) = (self.time_s(), self.time_s());
        for number in 0..tries {
            let heat_s = 0.1 * (1.0 - number as f64 / tries as f64).powi(3);
            let [first, end] = self.bounds[random.random_range(0..self.bounds.len())];
            let mut ends = [0; 2].map(|_| random.random_range(first..end));
            ends.sort_unstable();
            let moves = random.random::<bool>();
            // Turning a piece and then all of it but one end moves that end to the other side.
            let pieces = [
                ends,
                if moves { [ends[0], ends[1].saturating_sub(1).max(ends[0])] } else { ends },
            ];
            let mut change = 0.0;
            for piece in &pieces[..1 + usize::from(moves)] {
                change += self.turned_s(*piece);
                self.order[piece[0]..=piece[1]].reverse();
            }
            if change < 0.0 || random.random::<f64>() < (-change / heat_s).exp() {
                time += change;
                best = best.min(time);
            } else {
                for piece in pieces[..1 + usize::from(moves)].iter().rev() {
                    self.order[piece[0]..=piece[1]].reverse();
                }
            }
        }
        assert!((time - self.time_s()).abs() < 1e-6 * time);
        best
    }
}

#[test]
fn no_long_search_finds_a_way_shorter_by_a_twentieth() {
    let file = MachineFile::embedded_for("ball-dome").unwrap();
    let (method, header) = setup::header(&file, "ball-dome", None).unwrap();
    let (plan, _) = methods::nominal(method.as_ref(), header).unwrap();
    let visits = visits(&plan);
    assert_eq!(visits.len(), 24);
    let mut tour = Tour::new(&file.machine, &visits);
    let planned = tour.time_s();
    let tries = if is_full() { 1_000_000_000 } else { 4_000_000 };
    let best = tour.anneal(&mut stream(1, &[0x746f_7572]), tries);
    println!("planned {planned:.2} s, found in {tries} tries {best:.2} s");
    assert!(planned < 1.05 * best, "{planned} {best}");
}
