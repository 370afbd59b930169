//! Balls, planned: the paper's set of balls on a machine like the one that is built in, 109
//! measurements in 32 indexations.

use trued::base::{Axis, Position};
use trued::gcode::{Dialect, Program};
use trued::planning::{
    Access, Approach, BallTask, Clearance, Start, Visit, blocks, end_of, machine_time_s, order,
    touch_block,
};
use trued::proof::{Request, Staged, prove};
use trued::record::artefact::{Artefact, Balls, Cylinder};
use trued::record::motion::Motion;
use trued::record::plan::{Plan, Step, StepKind};

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

fn in_order(
    plan: &Plan,
    access: &Access,
    visits: &[(Position, Vec<usize>)],
) -> Vec<(Position, Vec<usize>)> {
    let place =
        |rotary: &Position, ball: &usize| access.centre(&balls(plan).balls[*ball], rotary).unwrap();
    let list: Vec<Visit> = visits
        .iter()
        .map(|(rotary, balls)| Visit {
            rotary: rotary.clone(),
            places: balls.iter().map(|ball| place(rotary, ball)).collect(),
            follows: false,
        })
        .collect();
    let turns = order(&list, &plan.machine);
    let visit = |turn: &trued::planning::Turn| {
        let (rotary, balls) = &visits[turn.visit];
        (rotary.clone(), turn.places.iter().map(|place| balls[*place]).collect())
    };
    turns.iter().map(visit).collect()
}

/// In the order of the list, and over the upper end of Z between any two touches. `guarded`: as long
/// as it is lower than all that turns below anywhere in the plan, which is all that one knows without
/// looking at each way; otherwise fast as soon as nothing is near, which is kinder than naive.
fn naive_s(plan: &Plan, guarded: bool) -> f64 {
    let clearance = Clearance::above(plan).unwrap();
    // As high as a round part would have it that reaches as far out as the balls and their stems.
    let mut round = plan.clone();
    round.artefact = Artefact::Cylinder(Cylinder {
        centre_mm: [0.0, 0.0, 0.0],
        axis: [0.0, 0.0, 1.0],
        radius_mm: 160.0_f64.hypot(160.0),
        height_mm: 177.835 + 9.525,
        uncertainty_mm: 1.0,
    });
    let over_all = touch_block(
        &round,
        &plan.steps[0],
        0,
        Start::default(),
        &Clearance::above(&round).unwrap(),
    );
    let over_all = end_of(&over_all.unwrap(), &Position::new());
    let mut stands = Position::new();
    let mut seconds = 0.0;
    for step in &plan.steps {
        let mut block = touch_block(plan, step, 0, Start::default(), &clearance).unwrap();
        if guarded {
            let last = block.motions.len() - 1;
            let touch =
                block.motions.iter().position(|motion| matches!(motion, Motion::Probe { .. }));
            for (index, motion) in [(touch.unwrap() - 2, "down"), (last, "up")] {
                let z = over_all.only(|axis| axis == Axis::Z);
                match (&mut block.motions[index], motion) {
                    (Motion::Rapid { to } | Motion::Guarded { to, .. }, _) => *to = z,
                    (other, motion) => panic!("{motion}: {other:?}"),
                }
            }
        }
        seconds += machine_time_s(&block, &stands, &plan.machine);
        stands = end_of(&block, &stands);
    }
    seconds
}

#[test]
fn regress_109_balls_take_at_most_60_percent_of_the_naive_order() {
    let mut plan = rumba();
    let access = Access::new(&plan, &plan.artefact).unwrap();
    let visits = design(&plan, &access);
    let ordered = in_order(&plan, &access, &visits);
    for (name, passes) in [("slow", &[SLOW][..]), ("find and slow", &[SEARCH, SLOW])] {
        plan.steps = steps(&plan, &access, &visits, passes);
        let [naive, kind] = [true, false].map(|guarded| naive_s(&plan, guarded) / 60.0);
        plan.steps = steps(&plan, &access, &ordered, passes);
        let (_, seconds) = blocks(&plan, &Clearance::above(&plan).unwrap()).unwrap();
        let minutes = seconds / 60.0;
        println!(
            "{name}: {} indexations, {} touches: {minutes:.1} min; naive {naive:.1} min, {:.3} of it; \
             naive but fast as soon as nothing is near {kind:.1} min, {:.3} of it",
            visits.len(),
            plan.steps.len(),
            minutes / naive,
            minutes / kind
        );
        assert!(minutes <= 0.6 * naive && minutes <= 0.78 * kind);
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
