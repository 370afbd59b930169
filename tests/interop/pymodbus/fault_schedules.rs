//! Seeded fault schedules: no value is older than its request, no write arrives twice.

use std::time::Duration;

use estimation::random::seeded_stream;
use libtest_mimic::Failed;
use link::modbus::{Framing, ModbusClient, ModbusError, RegisterSpace};
use rand::{Rng, RngExt};

use testing::population::population_size;

use super::server::{PymodbusServer, block_on, write_may_have_arrived};

const FULL_SCHEDULE_COUNT: u64 = 150;
const STEPS_PER_SCHEDULE: u64 = 4;
const REPLY_TIMEOUT: Duration = Duration::from_millis(40);

/// A fault for two of five requests; the delays are around the timeout, and up to five times longer.
fn random_fault(draw: &mut impl Rng, framing: Framing) -> String {
    let faults = ["drop", "exception:6", "unit", "function", "address", "fewer", "more", "short", "double"];
    match draw.random_range(0..36) {
        index @ 0..9 => faults[index].to_owned(),
        9..12 => format!("delay:{:.3}", draw.random_range(0.0..0.2)),
        12 => format!("trickle:{:.3}", draw.random_range(0.0..0.03)),
        13 if framing == Framing::Tcp => "transaction".to_owned(),
        14 if framing == Framing::Tcp => "reset".to_owned(),
        13 | 14 => "corrupt".to_owned(),
        _ => "none".to_owned(),
    }
}

/// Results of the writes, and numbers of requests that succeeded and failed.
#[derive(Default)]
struct RequestResults {
    /// Value of each write, and whether it arrived. `None`: unknown.
    write_values_and_arrivals: Vec<(u16, Option<bool>)>,
    success_count: usize,
    error_count: usize,
}

async fn run_request_with_random_faults(
    (server, link): (&mut PymodbusServer, &ModbusClient),
    (framing, seed, step): (Framing, u64, u64),
    results: &mut RequestResults,
) {
    let mut draw = seeded_stream(seed, &[step]);
    let mark = (1 + seed * STEPS_PER_SCHEDULE + step) as u16;
    server.set_register_value(mark);
    let drawn: Vec<String> = (0..4).map(|_| random_fault(&mut draw, framing)).collect();
    server.set_faults(&drawn.iter().map(String::as_str).collect::<Vec<_>>());
    let place = format!("seed {seed}, step {step}: {drawn:?}");
    let ended = match draw.random_range(0..5) {
        0..3 => {
            let read = link.read(RegisterSpace::Input, 0, 4).await;
            read.map(|words| assert_eq!(words, [mark; 4], "stale: {place}"))
        }
        3 => record_write(link.write(60, &[mark]).await, mark, results),
        _ => record_write(link.write_without_read_back(70, &[mark]).await, mark, results),
    };
    let count = if ended.is_ok() { &mut results.success_count } else { &mut results.error_count };
    *count += 1;
}

fn record_write(ended: Result<(), ModbusError>, mark: u16, results: &mut RequestResults) -> Result<(), ModbusError> {
    let fate = match &ended {
        Ok(()) => Some(true),
        Err(error) if write_may_have_arrived(error) => None,
        Err(_) => Some(false),
    };
    results.write_values_and_arrivals.push((mark, fate));
    ended
}

fn check_fault_schedules(framing: Framing) -> Result<(), Failed> {
    let schedules = population_size(FULL_SCHEDULE_COUNT);
    block_on(async {
        let mut server = PymodbusServer::start(framing);
        let link = server.open_client(REPLY_TIMEOUT).await;
        let mut results = RequestResults::default();
        for seed in 0..schedules {
            for count in 0..STEPS_PER_SCHEDULE {
                run_request_with_random_faults((&mut server, &link), (framing, seed, count), &mut results).await;
            }
        }
        let arrived = server.received_writes();
        let times = |mark| arrived.iter().filter(|(_, words)| *words == [mark]).count();
        for (mark, fate) in &results.write_values_and_arrivals {
            match fate {
                Some(true) => assert_eq!(times(*mark), 1, "confirmed write {mark}"),
                Some(false) => assert_eq!(times(*mark), 0, "write {mark} was called not sent"),
                None => assert!(times(*mark) <= 1, "write {mark} came twice"),
            }
        }
        let unknown = results.write_values_and_arrivals.iter().filter(|(_, fate)| fate.is_none()).count();
        println!(
            "{} good, {} bad; {} writes, {unknown} of unknown fate, {} arrived",
            results.success_count,
            results.error_count,
            results.write_values_and_arrivals.len(),
            arrived.len()
        );
        // A link that always fails or a server that never fails would make the test meaningless.
        let share = |full: u64| (full * schedules / FULL_SCHEDULE_COUNT) as usize;
        assert!(results.success_count > share(100) && results.error_count > share(100));
        assert!(unknown > share(10) && arrived.len() > share(50));
        Ok(())
    })
}

pub fn no_stale_value_or_double_write_in_fault_schedules_over_rtu() -> Result<(), Failed> {
    check_fault_schedules(Framing::Rtu)
}

pub fn no_stale_value_or_double_write_in_fault_schedules_over_tcp() -> Result<(), Failed> {
    check_fault_schedules(Framing::Tcp)
}
