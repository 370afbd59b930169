//! Each fault once, and the error that the link reports.

use std::time::Duration;

use libtest_mimic::Failed;
use link::modbus::{Framing, ModbusError, RegisterSpace};
use tokio::time::{Instant, sleep};

use super::server::{Server, on_a_runtime};

const PATIENCE: Duration = Duration::from_millis(1500);

/// A fault, and the first word of the error's kind for a read and for a write; empty if the answer is still good.
const FAULTS: [(&str, &str, &str); 13] = [
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

fn kind(error: Option<&ModbusError>) -> String {
    let text = error.map_or(String::new(), |error| format!("{error:?}"));
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default().to_owned()
}

/// The table entry, changed where the framing makes a difference.
fn expected(framing: Framing, fault: &str, told: &'static str) -> &'static str {
    match (framing, fault) {
        // RTU has no transaction number.
        (Framing::Rtu, "transaction") => "",
        // TCP has no CRC: the reply is accepted. Counting registers detect the error.
        (Framing::Tcp, "corrupt") => "corrupt",
        _ => told,
    }
}

async fn each(framing: Framing) -> Result<(), Failed> {
    let mut server = Server::start(framing);
    let link = server.link(PATIENCE).await;
    for (count, (fault, of_read, of_write)) in (1_u16..).zip(FAULTS) {
        if framing == Framing::Tcp && fault == "corrupt" {
            continue;
        }
        server.value(count);
        server.faults(&[fault]);
        let read = link.read(RegisterSpace::Input, 0, 4).await;
        assert_eq!(kind(read.as_ref().err()), expected(framing, fault, of_read), "read {fault}");
        if let Ok(words) = read {
            assert_eq!(words, [count; 4], "{fault}");
        }
        assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [count; 4], "after {fault}");

        server.faults(&[fault]);
        let wrote = link.write_without_echo(60, &[count, count]).await;
        assert_eq!(kind(wrote.as_ref().err()), expected(framing, fault, of_write), "write {fault}");
        let arrived = server.writes().iter().filter(|(_, words)| words[0] == count).count();
        assert_eq!(arrived, usize::from(fault != "exception:4"), "{fault}");
        if let Err(error) = wrote {
            assert_eq!(error.may_have_arrived(), arrived == 1, "{error}");
            assert!(!error.remedy().is_empty());
        }
        assert_eq!(link.read(RegisterSpace::Input, 0, 4).await?, [count; 4], "after {fault}");
    }
    Ok(())
}

pub fn each_rtu() -> Result<(), Failed> {
    on_a_runtime(each(Framing::Rtu))
}

pub fn each_tcp() -> Result<(), Failed> {
    on_a_runtime(async {
        each(Framing::Tcp).await?;
        let mut server = Server::start(Framing::Tcp);
        let link = server.link(PATIENCE).await;
        server.faults(&["reset"]);
        let lost = link.write(60, &[7]).await.unwrap_err();
        assert!(matches!(lost, ModbusError::Lost { .. }), "{lost:?}");
        assert!(lost.may_have_arrived());
        assert_eq!(link.read(RegisterSpace::Holding, 60, 1).await?, [7]);
        assert_eq!(server.writes().len(), 1);
        Ok(())
    })
}

pub fn spaces() -> Result<(), Failed> {
    on_a_runtime(async {
        let server = Server::start(Framing::Tcp);
        let link = server.link(PATIENCE).await;
        let bits = [0, 1, 1, 0, 1, 1, 0, 1, 1, 0, 1];
        assert_eq!(link.read(RegisterSpace::Coil, 0, 11).await?, bits);
        assert_eq!(link.read(RegisterSpace::Discrete, 1, 10).await?, bits[1..]);
        link.write(60, &[0xFFFF, 0, 258]).await?;
        assert_eq!(link.read(RegisterSpace::Holding, 59, 5).await?, [0, 0xFFFF, 0, 258, 0]);
        Ok(())
    })
}

/// Over TCP, a hold waits neither for a slow reply nor for queued requests.
pub fn a_hold_overtakes() -> Result<(), Failed> {
    on_a_runtime(async {
        let mut server = Server::start(Framing::Tcp);
        let link = server.link(Duration::from_secs(20)).await;
        let hold = link.urgent(70, &[1])?;
        server.faults(&["delay:15"]);
        let begun = Instant::now();
        let (slow, queued, ()) = tokio::join!(
            link.read(RegisterSpace::Input, 0, 4),
            async {
                sleep(Duration::from_millis(100)).await;
                link.write(60, &[1]).await
            },
            async {
                sleep(Duration::from_millis(200)).await;
                hold.send_and_drop_ordinary();
            }
        );
        assert!(matches!(slow, Err(ModbusError::Timeout { .. })), "{slow:?}");
        assert!(matches!(queued, Err(ModbusError::HoldActive { .. })), "{queued:?}");
        // Well below the 15 s of the reply.
        assert!(begun.elapsed() < Duration::from_secs(8));
        assert_eq!(server.writes(), [(70, vec![1])]);
        assert_eq!(link.read(RegisterSpace::Holding, 70, 1).await?, [1]);
        Ok(())
    })
}

pub fn a_server_that_goes_and_comes_back() -> Result<(), Failed> {
    on_a_runtime(async {
        let mut server = Server::start(Framing::Tcp);
        let link = server.link(PATIENCE).await;
        server.value(5);
        assert_eq!(link.read(RegisterSpace::Input, 0, 1).await?, [5]);
        assert_eq!(server.requests(), 1);
        drop(server);
        let gone = link.read(RegisterSpace::Input, 0, 1).await.unwrap_err();
        assert!(!gone.may_have_arrived(), "{gone:?}");
        assert!(gone.to_string().contains("no server listens at"), "{gone}");
        Ok(())
    })
}
