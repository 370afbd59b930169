//! `trued simulate`: runs the simulated firmware on a pseudo-terminal or a TCP port, for use by other programs.

use std::io::IsTerminal as _;
use std::time::Duration;

use super::args::SimulateMachineArgs;
use super::failure::CommandFailure;
use super::run::build_runtime;
use crate::setup::{self, SimulatedMachine};
use machine::Axis;
use machine::record::question::{OperatorQuestion, StylusState};
use simulator::SimulatedOperator;
use simulator::faulty_wire::{FaultyWire, PlannedFault};

/// `trued simulate`: serves a simulated control until Ctrl-C.
pub fn simulate_command(args: &SimulateMachineArgs) -> Result<(), CommandFailure> {
    let machine = setup::load_machine_file(args.machine.as_deref(), &args.method)?;
    let (_, plan_without_steps) = setup::configure_method_and_plan_without_steps(&machine, &args.method, None)?;
    let pace = args.speed.into();
    build_runtime()?.block_on(async {
        let simulated = SimulatedMachine::new(&machine)?;
        if let Some(sensor) = plan_without_steps.sensors.iter().find(|sensor| sensor.mount.is_spindle()) {
            simulated.remove_probe();
            errln!("the sensor `{}` is mounted in the spindle instead of the touch probe", sensor.name);
        }
        let simulator = match args.faults {
            None => simulated.serve_control(pace)?,
            Some(seed) => {
                simulated.serve_control_with_faulty_wire(pace, FaultyWire::with_few_faults(seed), print_fault)?
            }
        };
        outln!("{simulator}");
        let orients = machine.machine.axes.contains_key(&Axis::S);
        let dialect = if orients { "\ndialect = \"grbl-m19\"" } else { "" };
        errln!(
            "A simulated {} is running on this port. To connect, write in a machine file:\n{}\nPress Ctrl-C \
            to end the simulation.",
            simulator.control_description(),
            format!("[controller]\n{}{dialect}", simulator.controller_toml())
                .lines()
                .map(|line| format!("  {line}"))
                .collect::<Vec<_>>()
                .join("\n")
        );
        start_stylus_input(simulated.simulated_operator());
        let ended = tokio::signal::ctrl_c().await;
        drop(simulator);
        ended.map_err(CommandFailure::without_remedy)
    })
}

/// Lets the person at this terminal deflect the simulated stylus.
fn start_stylus_input(mut simulated_operator: SimulatedOperator) {
    if !std::io::stdin().is_terminal() {
        return;
    }
    errln!("Type `press` to deflect the simulated stylus, `free` to release it.");
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            let stylus = match line.trim() {
                "press" => StylusState::Deflected,
                "free" => StylusState::Free,
                _ => continue,
            };
            simulated_operator.answer(&OperatorQuestion::StylusState(stylus));
            errln!("{stylus:?}");
        }
    });
}

fn print_fault(at: Duration, planned_fault: PlannedFault) {
    let PlannedFault { direction, line_index: line, byte_index: byte, fault } = planned_fault;
    errln!("{:9.3} s  {direction:?}, line {line}, byte {byte}: {fault:?}", at.as_secs_f64());
}
