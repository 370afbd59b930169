//! Balls, planned: the paper's set of balls on a machine like the one that is built in, 109
//! measurements in 32 indexations.

use trued::base::{Axis, Position};
use trued::gcode::{Dialect, Program};
use trued::planning::{
    Access, Approach, BallTask, Clearance, Start, Visit, blocks, end_of, machine_time_s, order,
    touch_block,
};
use trued::proof::{Request, Staged, prove};
use trued::record::artefact::{Artefact, Balls};
use trued::record::motion::{Block, Motion};
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

/// Tilt, turn and spindle in degrees and the balls measured there: 109 in 32, in the order in which one
/// writes them down.
fn design(plan: &Plan, access: &Access) -> Vec<(Position, Vec<usize>)> {
    let mut all = Vec::new();
    for (i, b) in [0.0, 10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0].into_iter().enumerate()
    {
        for (k, c) in [0.0, 90.0, 180.0, 270.0].into_iter().enumerate() {
            let s = 90.0 * ((i + k) % 4) as f64;
            let rotary: Position = [(Axis::B, b), (Axis::C, c), (Axis::S, s)]
                .into_iter()
                .map(|(axis, degrees)| (axis, axis.from_edge(degrees)))
                .collect();
            let free: Vec<usize> = (0..6)
                .filter(|ball| {
                    let ball = &balls(plan).balls[*ball];
                    let approach = Approach::Find { uncertainty_mm: 1.0, standoff_mm: 0.5 };
                    let task = BallTask { ball, rotary: &rotary, approach, touches: 5 };
                    let found = access.accessible(&task);
                    if let Err(why) = &found {
                        println!("B{b} C{c} ball {}: {why}", ball.id);
                    }
                    found.is_ok()
                })
                .collect();
            println!("B{b} C{c}: {free:?}");
            all.push((rotary, free));
        }
    }
    all
}

#[test]
fn look() {
    let plan = rumba();
    let access = Access::new(&plan, &plan.artefact).unwrap();
    let all = design(&plan, &access);
    println!("{}", all.iter().map(|(_, free)| free.len()).sum::<usize>());
}
