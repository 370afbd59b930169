//! Plays each fault of the server once, and checks the error that the link reports.

use std::time::Duration;

use libtest_mimic::Failed;
use link::modbus::{Framing, ModbusError, RegisterSpace};
use tokio::time::{Instant, sleep};

use super::server::{PymodbusServer, block_on, write_may_have_arrived};

const REPLY_TIMEOUT: Duration = Duration::from_millis(1500);

/// A fault, and the first word of the error's kind for a read and for a write; empty if the request succeeds.
const EXPECTED_ERRORS_BY_FAULT: [(&str, &str, &str); 13] = [
    ("none", "", ""),
    ("drop", "Timeout", "Timeout"),
    ("exception:4", "ExceptionReply", "ExceptionReply"),
    ("unit", "UnexpectedReply", "UnexpectedReply"),
    ("transaction", "UnexpectedReply", "UnexpectedReply"),
    ("function", "UnexpectedReply", "UnexpectedReply"),
    ("address", "", "UnexpectedReply"),
    ("fewer", "UnexpectedReply", ""),
    ("more", "UnexpectedReply", ""),
    ("short", "Timeout", "Timeout"),
    ("corrupt", "Timeout", "Timeout"),
    ("double", "", ""),
    ("trickle:0.03", "", ""),
];

fn error_kind(error: Option<&ModbusError>) -> String {
    let text = error.map_or(String::new(), |error| format!("{error:?}"));
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default().to_owned()
}

/// The table entry, changed where the framing makes a difference.
fn expected_error(framing: Framing, fault: &str, table_entry: &'static str) -> &'static str {
    match (framing, fault) {
        // RTU has no transaction number.
        (Framing::Rtu, "transaction") => "",
        // TCP has no CRC: the reply is accepted. Counting registers detect the error.
        (Framing::Tcp, "corrupt") => "corrupt",
        _ => table_entry,
    }
}

async fn check_each_fault(framing: Framing) -> Result<(), Failed> {
    let mut server = PymodbusServer::start(framing);
    let link = server.open_client(REPLY_TIMEOUT).await;
    for (count, (fault, of_read, of_write)) in (1_u16..).zip(EXPECTED_ERRORS_BY_FAULT) {
        if framing == Framing::Tcp && fault == "corrupt" {
            continue;
        }
        server.set_register_value(count);
        server.set_faults(&[fault]);
        let read = link.read(RegisterSpace::Input, 0, 4).await;
        assert_eq!(error_kind(read.as_ref().err()), expected_error(framing, fault, of_read), "read {fault}");
        if let Ok(words) = read {
            assert_eq!(words, [count; 4], "{fault}");
        }
        assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [count; 4], "after {fault}");

        server.set_faults(&[fault]);
        let wrote = link.write_without_read_back(60, &[count, count]).await;
        assert_eq!(error_kind(wrote.as_ref().err()), expected_error(framing, fault, of_write), "write {fault}");
        let arrived = server.received_writes().iter().filter(|(_, words)| words[0] == count).count();
        assert_eq!(arrived, usize::from(fault != "exception:4"), "{fault}");
        if let Err(error) = wrote {
            assert_eq!(write_may_have_arrived(&error), arrived == 1, "{error}");
            assert!(!error.remedy().is_empty());
        }
        assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [count; 4], "after {fault}");
    }
    Ok(())
}

pub fn each_fault_gives_the_expected_error_over_rtu() -> Result<(), Failed> {
    block_on(check_each_fault(Framing::Rtu))
}

pub fn each_fault_gives_the_expected_error_over_tcp() -> Result<(), Failed> {
    block_on(async {
        check_each_fault(Framing::Tcp).await?;
        let mut server = PymodbusServer::start(Framing::Tcp);
        let link = server.open_client(REPLY_TIMEOUT).await;
        server.set_faults(&["reset"]);
        let lost = link.write(60, &[7]).await.unwrap_err();
        assert!(matches!(lost, ModbusError::ConnectionLost { .. }), "{lost:?}");
        assert!(write_may_have_arrived(&lost));
        assert_eq!(link.read(RegisterSpace::Holding, 60, 1).await?, [7]);
        assert_eq!(server.received_writes().len(), 1);
        Ok(())
    })
}

pub fn coils_discretes_and_holding_registers_return_their_values() -> Result<(), Failed> {
    block_on(async {
        let server = PymodbusServer::start(Framing::Tcp);
        let link = server.open_client(REPLY_TIMEOUT).await;
        let bits = [0, 1, 1, 0, 1, 1, 0, 1, 1, 0, 1];
        assert_eq!(link.read(RegisterSpace::Coil, 0, 11).await?, bits);
        assert_eq!(link.read(RegisterSpace::Discrete, 1, 10).await?, bits[1..]);
        link.write(60, &[0xFFFF, 0, 258]).await?;
        assert_eq!(link.read(RegisterSpace::Holding, 59, 5).await?, [0, 0xFFFF, 0, 258, 0]);
        Ok(())
    })
}

/// Over TCP, a hold waits neither for a slow reply nor for queued requests.
pub fn hold_overtakes_pending_requests() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Tcp);
        let link = server.open_client(Duration::from_secs(20)).await;
        let hold = link.prepare_urgent_write(70, &[1])?;
        server.set_faults(&["delay:15"]);
        let begun = Instant::now();
        let (slow, queued, ()) = tokio::join!(
            link.read(RegisterSpace::Input, 0, 4),
            async {
                sleep(Duration::from_millis(100)).await;
                link.write(60, &[1]).await
            },
            async {
                sleep(Duration::from_millis(200)).await;
                hold.send_and_refuse_ordinary_writes();
            }
        );
        assert!(matches!(slow, Err(ModbusError::Timeout { .. })), "{slow:?}");
        assert!(matches!(queued, Err(ModbusError::HoldActive { .. })), "{queued:?}");
        // Well below the 15 s of the reply.
        assert!(begun.elapsed() < Duration::from_secs(8));
        assert_eq!(server.received_writes(), [(70, vec![1])]);
        assert_eq!(link.read(RegisterSpace::Holding, 70, 1).await?, [1]);
        Ok(())
    })
}

pub fn ended_server_is_reported() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Tcp);
        let link = server.open_client(REPLY_TIMEOUT).await;
        server.set_register_value(5);
        assert_eq!(link.read(RegisterSpace::Input, 0, 1).await?, [5]);
        assert_eq!(server.request_count(), 1);
        drop(server);
        let gone = link.read(RegisterSpace::Input, 0, 1).await.unwrap_err();
        assert!(!write_may_have_arrived(&gone), "{gone:?}");
        assert!(gone.to_string().contains("no server listens at"), "{gone}");
        Ok(())
    })
}
