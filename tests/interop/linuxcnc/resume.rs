//! `trued resume` against a running LinuxCNC.

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::cycle::TRUTH_UM;
use super::desk::{Desk, complaint, result};
use super::faults::{TRAVELLING, wait_for, wait_until};
use super::rig::{Rig, rig};

/// Number of touches before the stop: the part is located; the references, Test 1a, and some of Test 1b.
const BEFORE: u64 = 18;

/// A run that an emergency stop has ended between two touches.
fn stopped(rig: &Rig, positions: u32, touches: u64) -> Result<Desk, Failed> {
    let desk = Desk::with_care(rig, positions)?;
    let before = rig.touches()?;
    let mut run = desk.start()?;
    wait_for(rig, before + touches, &mut run)?;
    wait_until(TRAVELLING, rig, &mut run)?;
    rig.emergency_stop()?;
    let output = run.wait_with_output()?;
    if output.status.code() == Some(5) { Ok(desk) } else { Err(complaint(&output).into()) }
}

/// Releases the machine as an operator does after an inspection, without manual motion.
pub fn release(rig: &Rig) -> Result<(), Failed> {
    rig.release()?;
    let mut person = rig.person()?;
    person.say("set estop off")?;
    person.say("set machine on").map(drop)
}

/// The part is 1 mm off its stated position.
pub fn after_an_emergency_stop() -> Result<(), Failed> {
    let rig = rig()?;
    rig.make_true("ecc-x", 1.120)?;
    let desk = stopped(&rig, 6, BEFORE)?;
    let stands = rig.stands()?;
    let early = desk.resume()?.wait_with_output()?;
    let said = complaint(&early);
    if early.status.success() || !said.contains("the emergency stop is pressed") {
        return Err(said.into());
    }
    if rig.stands()? != stands {
        return Err("it moved although the stop was pressed".into());
    }
    release(&rig)?;
    let output = desk.resume()?.wait_with_output()?;
    if output.status.code() != Some(0) {
        return Err(complaint(&output).into());
    }
    desk.is("finished")?;
    eprintln!("{}", complaint(&output));
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    for (symbol, truth) in TRUTH_UM {
        let (value, expanded) = result(&estimate, symbol)?;
        eprintln!("{symbol} = {value:.3} um, U = {expanded:.3} um");
        if (value - truth).abs() > expanded || expanded > 3.0 {
            return Err(format!("{symbol} = {value} um, U = {expanded} um").into());
        }
    }
    Ok(())
}

/// The part moved by 20 µm along Y: the reference in Y detects it, the one in X does not.
pub fn not_when_the_part_has_moved() -> Result<(), Failed> {
    let rig = rig()?;
    let desk = stopped(&rig, 8, 13)?;
    release(&rig)?;
    let kept = desk.kept()?;
    let before = rig.touches()?;
    rig.make_true("ecc-y", -0.060)?;
    let output = desk.resume()?.wait_with_output()?;
    let said = complaint(&output);
    eprintln!("{said}");
    let refused = "the references have shifted since the stop";
    if output.status.success() || !said.contains(refused) {
        return Err(said.into());
    }
    let named = |place: &str| said.contains(&format!("{place} moved by"));
    if !named("P090") || named("P000") || named("P180") {
        return Err(said.into());
    }
    desk.is("closed")?;
    let (touched, more) = (rig.touches()? - before, desk.kept()? - kept);
    eprintln!("{touched} touches more, {more} kept");
    if touched == 4 && more == 4 { Ok(()) } else { Err("other than the references".into()) }
}
