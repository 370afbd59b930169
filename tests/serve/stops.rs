//! A run that is stopped holds, and so does the service, until somebody has been there.

use super::client::{ACCEPTED, Client, PROGRESS, REFUSAL, RUN, STATE};
use super::shop::{MODBUS, Shop};

/// Well under way, on a machine that takes its time: its references are measured.
fn under_way(client: &mut Client) {
    client.enable();
    client.press(11);
    client.until(|status| status[STATE] == 2 && status[PROGRESS] >= 1);
}

pub fn by_a_coil() {
    let shop = Shop::new(MODBUS);
    let daemon = shop.serve("real");
    let mut client = Client::new(daemon.port);
    under_way(&mut client);
    assert_eq!(client.ask("coil 3 1"), "ok");
    client.until(|status| status[STATE] == 3);
    assert_eq!(shop.states(), ["held"]);
    assert_eq!(client.ask("coil 3 0"), "ok");
    assert_eq!(client.refused(11), 2);
    // The machine is free for a person, who is not told that a daemon has it.
    let resumed = shop.trued(&["resume", "1"]);
    let told = String::from_utf8_lossy(&resumed.stderr).into_owned();
    assert!(told.contains("nobody has acknowledged"), "{told}");
    client.press(4);
    client.until(|status| status[STATE] == 1);
    under_way(&mut client);
    let status = client.status();
    assert_eq!((status[RUN], status[ACCEPTED]), (2, 2), "{status:?}");
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.states(), ["held", "held"]);
}

pub fn by_sigterm() {
    let shop = Shop::new(MODBUS);
    let daemon = shop.serve("real");
    let mut client = Client::new(daemon.port);
    under_way(&mut client);
    drop(client);
    assert_eq!(daemon.terminate(), 5);
    assert_eq!(shop.states(), ["held"]);
    // The next one waits for a person.
    let daemon = shop.serve("fast");
    let mut client = Client::new(daemon.port);
    client.enable();
    assert_eq!(client.status()[STATE], 3);
    assert_eq!(client.refused(11), 2);
    client.press(4);
    client.until(|status| status[STATE] == 1);
    drop(client);
    assert_eq!(daemon.terminate(), 0);
    // Acknowledged is acknowledged; killed is not.
    let mut daemon = shop.serve("real");
    let mut client = Client::new(daemon.port);
    assert_eq!(client.status()[STATE], 1);
    under_way(&mut client);
    daemon.child.kill().unwrap();
    daemon.child.wait().unwrap();
    let next = shop.serve("fast");
    let mut client = Client::new(next.port);
    assert_eq!((client.status()[STATE], client.status()[REFUSAL]), (3, 0));
}
