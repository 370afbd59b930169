//! A plain client accepts a late reply as the reply to a later request; our client must reject it.

use std::time::Duration;

use libtest_mimic::Failed;
use link::LinkConfig;
use link::modbus::{AccessList, Framing, ModbusClient, ModbusError, RegisterRange, RegisterSpace};
use tokio::time::{sleep, timeout};
use tokio_modbus::Slave;
use tokio_modbus::client::{Reader, rtu};
use tokio_serial::SerialPortBuilderExt;

use super::server::{PymodbusServer, block_on, write_may_have_arrived};

const REPLY_TIMEOUT: Duration = Duration::from_millis(1500);
const LATE_REPLY_FAULT: &str = "delay:2.6";

/// Shows that the test can fail: after a timeout, tokio-modbus's RTU client takes the old reply for the new one.
pub fn plain_client_accepts_a_late_reply() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Rtu);
        let LinkConfig::Serial { path, baud } = server.link_config() else {
            return Err("no serial line".into());
        };
        let stream = tokio_serial::new(path.display().to_string(), baud).open_native_async()?;
        let mut plain = rtu::attach_slave(stream, Slave(1));
        server.set_register_value(111);
        assert_eq!(plain.read_input_registers(0, 4).await??, [111; 4]);
        server.set_faults(&[LATE_REPLY_FAULT]);
        assert!(timeout(REPLY_TIMEOUT, plain.read_input_registers(0, 4)).await.is_err());
        server.set_register_value(222);
        sleep(2 * REPLY_TIMEOUT).await;
        assert_eq!(plain.read_input_registers(0, 4).await??, [111; 4], "no hazard any more?");
        Ok(())
    })
}

async fn check_fresh_value_after_late_reply(
    framing: Framing,
    pause: Duration,
) -> Result<(PymodbusServer, ModbusClient), Failed> {
    let mut server = PymodbusServer::start(framing);
    let link = server.open_client(REPLY_TIMEOUT).await;
    server.set_register_value(111);
    assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [111; 4]);
    server.set_faults(&[LATE_REPLY_FAULT]);
    let late = link.read(RegisterSpace::Input, 0, 4).await.unwrap_err();
    assert!(matches!(late, ModbusError::Timeout { .. }), "{late}");
    server.set_register_value(222);
    sleep(pause).await;
    assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [222; 4]);
    Ok((server, link))
}

pub fn own_client_rejects_a_late_reply_over_rtu() -> Result<(), Failed> {
    block_on(check_fresh_value_after_late_reply(Framing::Rtu, 2 * REPLY_TIMEOUT)).map(drop)
}

pub fn own_client_rejects_a_late_reply_over_tcp() -> Result<(), Failed> {
    block_on(check_fresh_value_after_late_reply(Framing::Tcp, 2 * REPLY_TIMEOUT)).map(drop)
}

/// The next request does not wait for the late reply: the link checks that the line is clear.
pub fn late_replies_are_rejected_without_a_pause_over_rtu() -> Result<(), Failed> {
    block_on(async {
        let (mut server, link) = check_fresh_value_after_late_reply(Framing::Rtu, Duration::ZERO).await?;
        // A late confirmation of a write: the write was executed once, and the repeated write is a new one.
        server.set_faults(&[LATE_REPLY_FAULT]);
        let late = link.write(50, &[1]).await.unwrap_err();
        assert!(write_may_have_arrived(&late), "{late}");
        link.write(50, &[2]).await?;
        assert_eq!(server.received_writes(), [(50, vec![1]), (50, vec![2])]);
        Ok(())
    })
}

/// Only one register, so that all replies have the same shape. The line is then kept quiet for the same time again.
pub fn indistinguishable_late_reply_is_rejected() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Rtu);
        let one = RegisterRange { space: RegisterSpace::Input, first: 0, last: 0 };
        let allowed = AccessList { readable: vec![one], writable: Vec::new() };
        let link = server.open_client_with_access(REPLY_TIMEOUT, allowed).await;
        server.set_register_value(111);
        server.set_faults(&[LATE_REPLY_FAULT]);
        let late = link.read(RegisterSpace::Input, 0, 1).await.unwrap_err();
        assert!(matches!(late, ModbusError::Timeout { .. }), "{late}");
        server.set_register_value(222);
        assert_eq!(link.read(RegisterSpace::Input, 0, 1).await?, [222]);
        Ok(())
    })
}
