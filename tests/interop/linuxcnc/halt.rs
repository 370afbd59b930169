//! The halt with a running LinuxCNC: it holds the machine, and its delay on the wire is bounded.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use devices::controllers::linuxcnc::LinuxCncDriver;
use devices::controllers::{ControllerDriver as _, ControllerError, HaltHandle};
use libtest_mimic::Failed;
use machine::record::motion::{Motion, MotionBlock};

use super::driver::{
    block_on, expect_error, open_driver, open_driver_at_port, polar_xy_position, prove_without_collision_check,
    z_position,
};
use super::rig::lock_rig;

/// Maximum time from the request to the wire.
const MAX_HALT_REQUEST_TO_WIRE_TIME: Duration = Duration::from_millis(20);

pub fn halt_stops_the_machine_and_no_motion_follows() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        for (delay_ms, feed) in [(5, 6000.0), (400, 600.0)] {
            let (mut driver, halt) = open_driver(&rig).await?;
            driver.prepare().await?;
            driver
                .execute(prove_without_collision_check(
                    &driver,
                    &MotionBlock { step: 0, repeat: 0, motions: vec![Motion::Rapid { to: z_position(150.0) }] },
                ))
                .await?;
            let motions = vec![Motion::Guarded { to: polar_xy_position(200.0, 1.0), feed_mm_min: feed }];
            let far = MotionBlock { step: 1, repeat: 0, motions };
            let before = rig.joint_position(0)?.hypot(rig.joint_position(1)?);
            let hit = halt.clone();
            let person = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(delay_ms));
                hit.trigger();
            });
            let held = driver.execute(prove_without_collision_check(&driver, &far)).await;
            person.join().map_err(|_| "the halt panicked")?;
            expect_error(held, |error| matches!(error, ControllerError::Halted))?;
            let stands = rig.joint_position(0)?.hypot(rig.joint_position(1)?);
            eprintln!("halted after {delay_ms} ms at {feed} mm/min: {:.3} mm", stands - before);
            expect_error(driver.execute(prove_without_collision_check(&driver, &far)).await, |error| {
                matches!(error, ControllerError::Halted)
            })?;
            if driver.prepare().await.is_ok() || driver.restore_modes().await.is_ok() {
                return Err("it goes on after a halt".into());
            }
            tokio::time::sleep(Duration::from_millis(300)).await;
            if (rig.joint_position(0)?.hypot(rig.joint_position(1)?) - stands).abs() > 1e-6 || stands > 199.0 {
                return Err("it moves after a halt".into());
            }
            let mut person = rig.connect_client()?;
            person.run_mdi("G53 G0 X0 Y0")?;
        }
        Ok(())
    })
}

/// Forwards every connection to `control_port` and reports the time of each abort. If it `loses_first_abort`, the first
/// abort is answered as linuxcncrsh 2.9 does when another line arrives at the same moment, and is not forwarded.
fn start_abort_timing_proxy(
    control_port: u16,
    aborts: &Sender<Instant>,
    loses_first_abort: bool,
) -> Result<u16, Failed> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    let aborts = aborts.clone();
    let to_lose = Arc::new(AtomicBool::new(loses_first_abort));
    std::thread::spawn(move || {
        for near in listener.incoming() {
            let (Ok(near), Ok(far)) = (near, TcpStream::connect(("127.0.0.1", control_port))) else { return };
            let (Ok(near_too), Ok(far_too)) = (near.try_clone(), far.try_clone()) else { return };
            let Ok(mut answer) = near.try_clone() else { return };
            let (aborts, to_lose) = (aborts.clone(), to_lose.clone());
            std::thread::spawn(move || {
                forward_bytes(near, far, |bytes| {
                    if !bytes.windows(9).any(|word| word == b"set abort") {
                        return true;
                    }
                    let _ = aborts.send(Instant::now());
                    let loses = to_lose.swap(false, Ordering::SeqCst);
                    !(loses && answer.write_all(b"SET NAK\n\rSET ABORT NAK\n\r").is_ok())
                })
            });
            std::thread::spawn(move || forward_bytes(far_too, near_too, |_| true));
        }
    });
    Ok(port)
}

fn forward_bytes(mut from: TcpStream, mut to: TcpStream, mut passes: impl FnMut(&[u8]) -> bool) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        if passes(&buffer[..count]) && to.write_all(&buffer[..count]).is_err() {
            return;
        }
    }
}

/// A move of 200 mm at 10 mm/s, held after 0.7 s; returns the time of the request.
async fn halt_during_motion(driver: &mut LinuxCncDriver, halt: HaltHandle) -> Result<Instant, Failed> {
    let motions = vec![
        Motion::Rapid { to: z_position(150.0) },
        Motion::Guarded { to: polar_xy_position(200.0, 1.0), feed_mm_min: 600.0 },
    ];
    let person = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(700));
        let asked = Instant::now();
        halt.trigger();
        asked
    });
    let held =
        driver.execute(prove_without_collision_check(driver, &MotionBlock { step: 1, repeat: 0, motions })).await;
    expect_error(held, |error| matches!(error, ControllerError::Halted))?;
    person.join().map_err(|_| "the halt panicked".into())
}

/// The first hold is lost.
pub fn lost_abort_is_sent_again() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let (told, aborts) = channel();
    let port = start_abort_timing_proxy(rig.rsh_port, &told, true)?;
    block_on(async {
        let (mut driver, halt) = open_driver_at_port(port, &rig).await?;
        driver.prepare().await?;
        halt_during_motion(&mut driver, halt).await?;
        let stands = rig.joint_position(0)?.hypot(rig.joint_position(1)?);
        eprintln!("held at {stands:.3} mm of 200 after {} aborts", aborts.try_iter().count());
        if stands > 100.0 {
            return Err(format!("it went on to {stands} mm").into());
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
        if (rig.joint_position(0)?.hypot(rig.joint_position(1)?) - stands).abs() > 1e-6 {
            return Err("it moves after a halt".into());
        }
        rig.connect_client()?.run_mdi("G53 G0 X0 Y0")
    })
}

/// The driver polls the state every 4 ms during the halt; the delay is measured at the port. The median of five
/// delays counts, because other programs run on the computer, too.
pub fn halt_is_on_the_wire_within_20_ms() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let mut delays = Vec::new();
    for _ in 0..5 {
        let (told, aborts) = channel();
        let port = start_abort_timing_proxy(rig.rsh_port, &told, false)?;
        block_on(async {
            let (mut driver, halt) = open_driver_at_port(port, &rig).await?;
            driver.prepare().await?;
            let asked = halt_during_motion(&mut driver, halt).await?;
            delays.push(aborts.recv_timeout(Duration::from_secs(1))? - asked);
            rig.connect_client()?.run_mdi("G53 G0 X0 Y0")
        })?;
    }
    delays.sort();
    eprintln!("on the wire after {delays:.1?}");
    if delays[2] <= MAX_HALT_REQUEST_TO_WIRE_TIME { Ok(()) } else { Err(format!("{delays:?}").into()) }
}
