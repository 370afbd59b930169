//! `trued simulate`: the simulated firmware on a pseudo-terminal, for any program to drive.

use super::Exit;
use super::args::{SimulateArgs, Speed};
use super::failure::Failure;
use crate::setup::{self, Pace};

pub fn simulate(args: &SimulateArgs) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref())?;
    let pace = match args.speed {
        Speed::Real => Pace::Real,
        Speed::Fast => Pace::Fast,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(Failure::plain)?;
    runtime.block_on(async {
        let simulator = setup::simulator(&machine, pace)?;
        println!("{}", simulator.path.display());
        eprintln!(
            "a simulated grblHAL machine speaks there; in a machine file:\n  [controller]\n  kind = \
             \"grbl\"\n  serial = \"{}\"\nCtrl-C ends it",
            simulator.path.display()
        );
        let ended = tokio::signal::ctrl_c().await;
        drop(simulator);
        ended.map_err(Failure::plain)
    })?;
    Ok(Exit::Pass)
}
