//! `trued simulate`: serves the simulated firmware on a wire of its own, for any program to drive.

use std::io::IsTerminal as _;
use std::time::Duration;

use super::Exit;
use super::args::SimulateArgs;
use super::failure::Failure;
use super::run::runtime;
use crate::setup::{self, Rehearsal};
use machine::Axis;
use machine::record::question::{Question, Stylus};
use simulator::SimulatedOperator;
use simulator::faulty_wire::{BadWire, Planned};

pub fn simulate(args: &SimulateArgs) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref(), &args.method)?;
    let (_, plan) = setup::header(&machine, &args.method, None)?;
    let pace = args.speed.into();
    runtime()?.block_on(async {
        let rehearsal = Rehearsal::of(&machine)?;
        if let Some(sensor) = plan.sensors.iter().find(|sensor| sensor.mount.is_spindle()) {
            rehearsal.without_probe();
            tell!("`{}` is in the spindle, the probe is not", sensor.name);
        }
        let simulator = match args.faults {
            None => rehearsal.serve(pace)?,
            Some(seed) => rehearsal.serve_badly(pace, BadWire::to_rehearse(seed), planned)?,
        };
        say!("{simulator}");
        let orients = machine.machine.axes.contains_key(&Axis::S);
        let dialect = if orients { "\ndialect = \"grbl-m19\"" } else { "" };
        tell!(
            "a simulated {} speaks there; in a machine file:\n{}\nCtrl-C ends it",
            simulator.what(),
            format!("[controller]\n{}{dialect}", simulator.keys())
                .lines()
                .map(|line| format!("  {line}"))
                .collect::<Vec<_>>()
                .join("\n")
        );
        beside(rehearsal.bystander());
        let ended = tokio::signal::ctrl_c().await;
        drop(simulator);
        ended.map_err(Failure::plain)
    })?;
    Ok(Exit::Pass)
}

/// Lets the person at this terminal deflect the simulated stylus.
fn beside(mut bystander: SimulatedOperator) {
    if !std::io::stdin().is_terminal() {
        return;
    }
    tell!("type `press` to press the stylus aside, `free` to let it go");
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            let stylus = match line.trim() {
                "press" => Stylus::Deflected,
                "free" => Stylus::Free,
                _ => continue,
            };
            bystander.answer(&Question::Stylus(stylus));
            tell!("{stylus:?}");
        }
    });
}

fn planned(at: Duration, harm: Planned) {
    let Planned { direction, line, byte, harm } = harm;
    tell!("{:9.3} s  {direction:?}, line {line}, byte {byte}: {harm:?}", at.as_secs_f64());
}
