//! The halt against a running LinuxCNC: that it holds, and how fast it is on the wire.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use trued::controllers::{ControllerError, Driver as _};
use trued::record::motion::{Block, Motion};

use super::machine::{expect, open, open_through, run, xy, z};
use super::rig::rig;

/// From the request to the wire.
const BOUND: Duration = Duration::from_millis(20);

pub fn it_holds_and_nothing_moves_after_it() -> Result<(), Failed> {
    let rig = rig()?;
    run(async {
        for (delay_ms, feed) in [(5, 6000.0), (400, 600.0)] {
            let (mut driver, halt) = open(&rig).await?;
            driver.prepare().await?;
            driver
                .execute(&Block {
                    step: 0,
                    repeat: 0,
                    motions: vec![Motion::Rapid { to: z(150.0) }],
                })
                .await?;
            let motions = vec![Motion::Guarded { to: xy(200.0, 1.0), feed_mm_min: feed }];
            let far = Block { step: 1, repeat: 0, motions };
            let before = rig.joint(0)?.hypot(rig.joint(1)?);
            let hit = halt.clone();
            let person = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(delay_ms));
                hit.now();
            });
            let held = driver.execute(&far).await;
            person.join().map_err(|_| "the halt panicked")?;
            expect(held, |error| matches!(error, ControllerError::Halted))?;
            let stands = rig.joint(0)?.hypot(rig.joint(1)?);
            eprintln!("halted after {delay_ms} ms at {feed} mm/min: {:.3} mm", stands - before);
            expect(driver.execute(&far).await, |error| matches!(error, ControllerError::Halted))?;
            if driver.prepare().await.is_ok() || driver.finish().await.is_ok() {
                return Err("it goes on after a halt".into());
            }
            tokio::time::sleep(Duration::from_millis(300)).await;
            if (rig.joint(0)?.hypot(rig.joint(1)?) - stands).abs() > 1e-6 || stands > 199.0 {
                return Err("it moves after a halt".into());
            }
            let mut person = rig.person()?;
            person.mdi("G53 G0 X0 Y0")?;
        }
        Ok(())
    })
}

/// Pass on every connection to `to`; tell when an abort comes by.
fn listen_in(to: u16, aborts: &Sender<Instant>) -> Result<u16, Failed> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    let aborts = aborts.clone();
    std::thread::spawn(move || {
        for near in listener.incoming() {
            let (Ok(near), Ok(far)) = (near, TcpStream::connect(("127.0.0.1", to))) else { return };
            let (Ok(near_too), Ok(far_too)) = (near.try_clone(), far.try_clone()) else { return };
            let aborts = aborts.clone();
            std::thread::spawn(move || {
                pass_on(near, far, |bytes| {
                    if bytes.windows(9).any(|word| word == b"set abort") {
                        let _ = aborts.send(Instant::now());
                    }
                })
            });
            std::thread::spawn(move || pass_on(far_too, near_too, |_| {}));
        }
    });
    Ok(port)
}

fn pass_on(mut from: TcpStream, mut to: TcpStream, look: impl Fn(&[u8])) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        look(&buffer[..count]);
        if to.write_all(&buffer[..count]).is_err() {
            return;
        }
    }
}

/// The driver asks for the state every 4 ms meanwhile; measured at the port. Of five the middle one
/// counts: other programs run here, too.
pub fn it_is_on_the_wire_at_once() -> Result<(), Failed> {
    let rig = rig()?;
    let mut delays = Vec::new();
    for _ in 0..5 {
        let (told, aborts) = channel();
        let port = listen_in(rig.port, &told)?;
        run(async {
            let (mut driver, halt) = open_through(port, &rig).await?;
            driver.prepare().await?;
            let motions = vec![
                Motion::Rapid { to: z(150.0) },
                Motion::Guarded { to: xy(200.0, 1.0), feed_mm_min: 600.0 },
            ];
            let person = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(700));
                let asked = Instant::now();
                halt.now();
                asked
            });
            let held = driver.execute(&Block { step: 1, repeat: 0, motions }).await;
            expect(held, |error| matches!(error, ControllerError::Halted))?;
            let asked = person.join().map_err(|_| "the halt panicked")?;
            delays.push(aborts.recv_timeout(Duration::from_secs(1))? - asked);
            rig.person()?.mdi("G53 G0 X0 Y0")
        })?;
    }
    delays.sort();
    eprintln!("on the wire after {delays:.1?}");
    if delays[2] <= BOUND { Ok(()) } else { Err(format!("{delays:?}").into()) }
}
