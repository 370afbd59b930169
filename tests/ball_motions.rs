//! Balls, planned: the paper's set of balls on a machine like the one that is built in, 109
//! measurements in 32 indexations.

use trued::base::{Axis, Position};
use trued::gcode::{Dialect, Program};
use trued::methods::{Next, Source};
use trued::planning::{
    Access, Approach, BallTask, Clearance, Start, blocks, end_of, machine_time_s, touch_block, tour,
};
use trued::proof::{Request, Staged, prove};
use trued::record::artefact::{Artefact, Balls};
use trued::record::motion::Motion;
use trued::record::plan::{Plan, Stage, Step, StepKind};

/// The built-in machine with the paper's order of axes, room for its balls and a longer stylus.
fn rumba() -> Plan {
    let file = include_str!("../config/simulated.toml");
    let head = file.split("[artefact]").next().unwrap();
    let mut text = head
        .replace("V[w-C-B-b-Y-X-Z-(C)-t]", "w-C-B-X-F-Z-Y-S-t")
        .replace("tool_mm = [0.0, 0.0, -120.0]", "tool_mm = [0.0, 0.0, -220.0]")
        .replace("min = -250.0", "min = -300.0")
        .replace("max = 250.0", "max = 300.0")
        .replace("max = 450.0", "max = 550.0")
        .replace("stem_length_mm = 95.0", "stem_length_mm = 150.0")
        .replace("body_length_mm = 25.0", "body_length_mm = 70.0");
    text.push_str("[artefact]\nkind = \"balls\"\nuncertainty_mm = 1.0\n");
    for (i, [x, y, z]) in BALLS.iter().enumerate() {
        text.push_str(&format!(
            "[[artefact.balls]]\nid = \"{}\"\ncentre_mm = [{x:?}, {y:?}, {z:?}]\nradius_mm = 9.525\n\
             stem_radius_mm = 4.0\nstem_length_mm = {z:?}\n",
            i + 1
        ));
    }
    text.push_str(
        "[[solid]]\nname = \"spindle nose\"\non = \"spindle\"\nfrom_mm = [0.0, 0.0, 0.0]\n\
         to_mm = [0.0, 0.0, 150.0]\nradius_mm = 50.0\n\
         [[solid]]\nname = \"table\"\non = \"table\"\nfrom_mm = [0.0, 0.0, -40.0]\n\
         to_mm = [0.0, 0.0, 0.0]\nradius_mm = 230.0\n",
    );
    text.push_str("[simulated]\nseed = 1\n");
    let file = trued::setup::MachineFile::parse("rumba.toml", text).unwrap();
    trued::setup::header(&file, "samba", None).unwrap().1
}

/// Paper 4, table 1.
const BALLS: [[f64; 3]; 6] = [
    [-152.4, 0.0, 40.855],
    [152.4, 0.0, 40.435],
    [160.0, 160.0, 177.835],
    [-160.0, 160.0, 177.695],
    [-160.0, -160.0, 75.605],
    [160.0, -160.0, 76.045],
];

fn balls(plan: &Plan) -> &Balls {
    match &plan.artefact {
        Artefact::Balls(balls) => balls,
        Artefact::Cylinder(_) => panic!("balls"),
    }
}

/// One measurement of each ball that is free, at most four of them: 109 in the first positions of a
/// list as one writes it down.
fn design(plan: &Plan, access: &Access) -> Vec<(Position, Vec<usize>)> {
    let tilts = [0.0, 10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0];
    let turns = [0.0, 90.0, 180.0, 270.0];
    let all = tilts.into_iter().enumerate();
    let all = all.flat_map(|(i, b)| turns.into_iter().enumerate().map(move |(k, c)| (b, c, i + k)));
    let mut left = 109;
    let mut visits = Vec::new();
    for (b, c, quarter) in all {
        let s = 90.0 * (quarter % 4) as f64;
        let rotary: Position = [(Axis::B, b), (Axis::C, c), (Axis::S, s)]
            .into_iter()
            .map(|(axis, degrees)| (axis, axis.from_edge(degrees)))
            .collect();
        let free = |ball: &usize| access.accessible(&task(plan, *ball, &rotary, SEARCH)).is_ok();
        // Another ball is left out each time.
        let from = quarter % 6;
        let some: Vec<usize> = (from..from + 6).map(|ball| ball % 6).filter(free).collect();
        let some: Vec<usize> = some.into_iter().take(4.min(left)).collect();
        left -= some.len();
        if !some.is_empty() {
            visits.push((rotary, some));
        }
    }
    assert_eq!(left, 0);
    visits
}

const SEARCH: Approach = Approach::Find { uncertainty_mm: 1.0, standoff_mm: 0.5 };
const SLOW: Approach = Approach::Slow { standoff_mm: 0.5, search_mm: 1.0 };

fn task<'a>(plan: &'a Plan, ball: usize, rotary: &'a Position, approach: Approach) -> BallTask<'a> {
    BallTask { ball: &balls(plan).balls[ball], rotary, approach, touches: 5 }
}

/// Steps of the visits in this order.
fn steps(
    plan: &Plan,
    access: &Access,
    visits: &[(Position, Vec<usize>)],
    passes: &[Approach],
) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for (number, (rotary, balls)) in visits.iter().enumerate() {
        for ball in balls {
            for approach in passes {
                let numbers = (steps.len() as u32, 0);
                let label = |touch: &str| format!("slow/{number:03}/{}/{touch}", ball + 1);
                let task = task(plan, *ball, rotary, *approach);
                let new = access.steps(&task, &plan.probe, StepKind::Touch, numbers, label);
                steps.extend(new.unwrap());
            }
        }
    }
    steps
}

/// By tilt, C forward at one and back at the next; the balls of each on a short way.
fn in_order(
    plan: &Plan,
    access: &Access,
    visits: &[(Position, Vec<usize>)],
) -> Vec<(Position, Vec<usize>)> {
    let mut visits = visits.to_vec();
    let at = |visit: &(Position, Vec<usize>), axis| visit.0.at(axis);
    visits.sort_by(|a, b| {
        let tilts = at(a, Axis::B).total_cmp(&at(b, Axis::B));
        tilts.then(at(a, Axis::C).total_cmp(&at(b, Axis::C)))
    });
    let tilts = visits.chunk_by_mut(|a, b| at(a, Axis::B) == at(b, Axis::B));
    tilts.skip(1).step_by(2).for_each(<[_]>::reverse);
    let mut stands: Option<Position> = None;
    for (rotary, list) in &mut visits {
        let place = |ball: &usize| access.centre(&balls(plan).balls[*ball], rotary).unwrap();
        let places: Vec<Position> = list.iter().map(place).collect();
        let order = tour(&places, stands.as_ref(), &plan.machine);
        stands = order.last().map(|last| places[*last].clone());
        *list = order.iter().map(|place| list[*place]).collect();
    }
    visits
}

/// One touch after the other, to the upper end of Z between any two; as fast and as carefully as our
/// own: guarded only where something is near.
fn naive_s<'a>(plan: &Plan, steps: impl IntoIterator<Item = (&'a Step, &'a Clearance)>) -> f64 {
    let mut stands = Position::new();
    let mut seconds = 0.0;
    for (step, clearance) in steps {
        let block = touch_block(plan, step, 0, Start::default(), clearance).unwrap();
        assert!(matches!(&block.motions[0], Motion::Rapid { to } if to.get(Axis::Z).is_some()));
        seconds += machine_time_s(&block, &stands, &plan.machine);
        stands = end_of(&block, &stands);
    }
    seconds
}

fn share(name: &str, touches: usize, ours_s: f64, naive_s: f64) -> f64 {
    let (ours, naive) = (ours_s / 60.0, naive_s / 60.0);
    println!("{name}: {touches} touches: {ours:.1} min, naive {naive:.1} min: {:.3}", ours / naive);
    ours / naive
}

/// What the program ships: its machine, its design, its stages, as `trued run samba` plans them. Naive:
/// the same indexations as they stand in the list of positions, the balls by their numbers and the
/// touches as in paper 4, searched for and measured at each; without our references.
#[test]
fn regress_109_balls_of_the_built_in_machine_take_at_most_60_percent_of_the_naive_order() {
    let text = include_str!("../config/samba.toml").to_owned();
    let file = trued::setup::MachineFile::parse("samba.toml", text).unwrap();
    let (method, mut plan) = trued::setup::header(&file, "samba", None).unwrap();
    let mut stages: Vec<(Stage, Clearance)> = Vec::new();
    let (mut done, mut found) = (Vec::new(), None);
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal).unwrap()
    {
        plan.steps.extend(new_steps);
        found = stage.found.clone().or(found);
        let artefact = found.as_ref().unwrap_or(&plan.artefact);
        stages.push((stage.clone(), Clearance::over(&plan, artefact).unwrap()));
        done.push(stage);
    }
    let of = |(stage, clearance)| {
        let (stage, clearance): (&Stage, &Clearance) = (stage, clearance);
        stage.steps.iter().map(move |id| (*id as usize, clearance))
    };
    let all: Vec<(&Step, &Clearance)> = stages
        .iter()
        .flat_map(|(stage, clearance)| of((stage, clearance)))
        .map(|(id, clearance)| (&plan.steps[id], clearance))
        .collect();
    let mut stands: Option<Position> = None;
    let mut ours_s = 0.0;
    for (step, clearance) in &all {
        let start = Start { stands: stands.as_ref(), first: stands.is_none() };
        let block = touch_block(&plan, step, 0, start, clearance).unwrap();
        let begins = stands.unwrap_or_default();
        ours_s += machine_time_s(&block, &begins, &plan.machine);
        stands = Some(end_of(&block, &begins));
    }
    let mut list: Vec<_> = all.iter().filter(|(s, _)| s.kind == StepKind::Touch).copied().collect();
    let place = |step: &Step| {
        let [pass, _, ball, touch] = step.label.split('/').collect::<Vec<_>>().try_into().unwrap();
        let touches = ["+45", "-135", "-45", "+135", "pole"];
        let touch = touches.iter().position(|name| *name == touch);
        let rotary =
            [Axis::B, Axis::C, Axis::S].map(|axis| step.from.at(axis).to_degrees().round());
        (rotary.map(|degrees| degrees as i32), pass.to_owned(), ball.to_owned(), touch)
    };
    list.sort_by_key(|(step, _)| place(step));
    assert_eq!(list.len(), 2 * 5 * 109);
    let naive_s = naive_s(&plan, list);
    assert!(share("built in, find and slow", all.len(), ours_s, naive_s) <= 0.5);
}

/// Slow touches alone spend 15 minutes touching, 7 on the way from ball to ball and turning: what is
/// left at 60 % of the naive order, 1.5 minutes for 545 ways from touch to touch, would be 0.16 s each.
#[test]
fn regress_109_balls_take_at_most_60_percent_of_the_naive_order() {
    let mut plan = rumba();
    let access = Access::new(&plan, &plan.artefact).unwrap();
    let visits = design(&plan, &access);
    let ordered = in_order(&plan, &access, &visits);
    let clearance = Clearance::above(&plan).unwrap();
    for (name, passes, most) in
        [("find and slow", &[SEARCH, SLOW][..], 0.6), ("slow", &[SLOW], 0.7)]
    {
        let list = steps(&plan, &access, &visits, passes);
        let naive_s = naive_s(&plan, list.iter().map(|step| (step, &clearance)));
        plan.steps = steps(&plan, &access, &ordered, passes);
        let (_, seconds) = blocks(&plan, &clearance).unwrap();
        assert!(share(name, list.len(), seconds, naive_s) <= most);
    }
}

#[test]
fn regress_the_motions_are_proven() {
    let mut plan = rumba();
    let access = Access::new(&plan, &plan.artefact).unwrap();
    let ordered = in_order(&plan, &access, &design(&plan, &access));
    plan.steps = steps(&plan, &access, &ordered, &[SEARCH]);
    let (blocks, _) = blocks(&plan, &Clearance::above(&plan).unwrap()).unwrap();
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let dialect = Dialect::named("linuxcnc").unwrap();
    let text = dialect.program(&Program { title: "t", axes: &axes, log: None }, &blocks).unwrap();
    let ids: Vec<u32> = plan.steps.iter().map(|step| step.id).collect();
    let staged = [Staged { steps: &ids, found: None }];
    let begun = std::time::Instant::now();
    let proof = prove(&Request {
        plan: &plan,
        stages: &staged,
        stands: None,
        first: true,
        dialect: &dialect,
        text: &text,
    });
    println!("proven in {:?}", begun.elapsed());
    match proof {
        Ok(proof) => println!("{} motions, {:?}", proof.motions, proof.nearest),
        Err(refusal) => {
            let line = text.lines().nth(refusal.line - 1).unwrap();
            let from = refusal.line.saturating_sub(6);
            let around: Vec<&str> = text.lines().skip(from).take(8).collect();
            panic!("{refusal}: {line}\n{}", around.join("\n"));
        }
    }
}
