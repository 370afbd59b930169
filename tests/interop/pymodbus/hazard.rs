//! The late reply: first shown with a plain client, then excluded for ours.

use std::time::Duration;

use libtest_mimic::Failed;
use link::LinkConfig;
use link::modbus::{AccessList, Framing, ModbusClient, ModbusError, RegisterRange, RegisterSpace};
use tokio::time::{sleep, timeout};
use tokio_modbus::Slave;
use tokio_modbus::client::{Reader, rtu};
use tokio_serial::SerialPortBuilderExt;

use super::server::{Server, on_a_runtime};

const PATIENCE: Duration = Duration::from_millis(1500);
const LATE: &str = "delay:2.6";

/// Shows that the test can fail: after a timeout, tokio-modbus's RTU client takes the old reply for the new one.
pub fn of_a_plain_client() -> Result<(), Failed> {
    on_a_runtime(async {
        let mut server = Server::start(Framing::Rtu);
        let LinkConfig::Serial { path, baud } = server.at() else {
            return Err("no serial line".into());
        };
        let stream = tokio_serial::new(path.display().to_string(), baud).open_native_async()?;
        let mut plain = rtu::attach_slave(stream, Slave(1));
        server.value(111);
        assert_eq!(plain.read_input_registers(0, 4).await??, [111; 4]);
        server.faults(&[LATE]);
        assert!(timeout(PATIENCE, plain.read_input_registers(0, 4)).await.is_err());
        server.value(222);
        sleep(2 * PATIENCE).await;
        assert_eq!(plain.read_input_registers(0, 4).await??, [111; 4], "no hazard any more?");
        Ok(())
    })
}

async fn is_fresh_after_a_late_one(framing: Framing, pause: Duration) -> Result<(Server, ModbusClient), Failed> {
    let mut server = Server::start(framing);
    let link = server.link(PATIENCE).await;
    server.value(111);
    assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [111; 4]);
    server.faults(&[LATE]);
    let late = link.read(RegisterSpace::Input, 0, 4).await.unwrap_err();
    assert!(matches!(late, ModbusError::Timeout { .. }), "{late}");
    server.value(222);
    sleep(pause).await;
    assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [222; 4]);
    Ok((server, link))
}

pub fn not_of_ours_rtu() -> Result<(), Failed> {
    on_a_runtime(is_fresh_after_a_late_one(Framing::Rtu, 2 * PATIENCE)).map(drop)
}

pub fn not_of_ours_tcp() -> Result<(), Failed> {
    on_a_runtime(is_fresh_after_a_late_one(Framing::Tcp, 2 * PATIENCE)).map(drop)
}

/// The next request does not wait for the late reply: the link checks that the line is clear.
pub fn not_even_while_it_is_owed() -> Result<(), Failed> {
    on_a_runtime(async {
        let (mut server, link) = is_fresh_after_a_late_one(Framing::Rtu, Duration::ZERO).await?;
        // A late confirmation of a write: the write was executed once, and the repeated write is a new one.
        server.faults(&[LATE]);
        let late = link.write(50, &[1]).await.unwrap_err();
        assert!(late.may_have_arrived(), "{late}");
        link.write(50, &[2]).await?;
        assert_eq!(server.writes(), [(50, vec![1]), (50, vec![2])]);
        Ok(())
    })
}

/// Only one register, so that all replies have the same shape. The line is then kept quiet for the same time again.
pub fn not_where_nothing_tells_replies_apart() -> Result<(), Failed> {
    on_a_runtime(async {
        let mut server = Server::start(Framing::Rtu);
        let one = RegisterRange { space: RegisterSpace::Input, first: 0, last: 0 };
        let allowed = AccessList { read: vec![one], write: Vec::new() };
        let link = server.link_to(PATIENCE, allowed).await;
        server.value(111);
        server.faults(&[LATE]);
        let late = link.read(RegisterSpace::Input, 0, 1).await.unwrap_err();
        assert!(matches!(late, ModbusError::Timeout { .. }), "{late}");
        server.value(222);
        assert_eq!(link.read(RegisterSpace::Input, 0, 1).await?, [222]);
        Ok(())
    })
}
