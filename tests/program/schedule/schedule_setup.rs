//! A daemon with one schedule, on a clock that the test sets, with a machine that reports its interlocks.

use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::fake_clock_and_interlocks::{FakeClock, InterlockServer};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::MACHINE_API_PATH;
use crate::support::machine_shop::{MachineShop, stderr};

pub const MACHINE_NAME: &str = "simulated five-axis machine";
const SCHEDULED_START_TIMEOUT: Duration = Duration::from_secs(300);

pub struct ScheduleSetup {
    pub clock: FakeClock,
    pub machine: InterlockServer,
    pub shop: MachineShop,
}

impl ScheduleSetup {
    /// `now`: time that the clock shows; `schedule_time`: of the schedule, in Berlin; `other_keys`: further
    /// lines of the schedule's table.
    pub fn new(now: &str, schedule_time: &str, other_keys: &str) -> Self {
        let (wall, machine) = (FakeClock::with_time(now), InterlockServer::new());
        let port = machine.port;
        let mut shop = MachineShop::with_serve(&format!(
            "[[serve.schedule]]\nname = \"dawn\"\ncycle = 1\nat = \"{schedule_time}\"\nzone = \"Europe/Berlin\"\n\
             {other_keys}\n\
             [serve.line]\ntcp = \"127.0.0.1:{port}\"\n[serve.http]\nlisten = \"127.0.0.1:0\"\n"
        ));
        shop.environment_variables = wall.environment_variables();
        Self { clock: wall, machine, shop }
    }

    pub fn arm(&self) {
        let arm = ["arm", MACHINE_NAME, "1", "--who", "Ada", "--until", "300d"];
        let output = self.shop.run_trued(&arm);
        assert!(output.status.success(), "{}", stderr(&output));
    }

    /// Instant, outcome and reason of each slot in the journal, newest first.
    pub fn slot_times_outcomes_and_reasons(&self) -> Vec<[String; 3]> {
        let told = self.shop.run_json(&["schedule", MACHINE_NAME, "--json"]);
        let text = |slot: &Value, key: &str| slot[key].as_str().unwrap().to_owned();
        let slots = told[0]["last"].as_array().unwrap().iter();
        slots.map(|slot| ["at", "outcome", "why"].map(|key| text(slot, key))).collect()
    }

    /// Waits until the newest slot has the outcome `outcome`; returns all slots.
    pub fn wait_for_newest_slot_outcome(&self, outcome: &str) -> Vec<[String; 3]> {
        let started = Instant::now();
        loop {
            let slots = self.slot_times_outcomes_and_reasons();
            if slots.first().is_some_and(|[_, became, _]| became == outcome) {
                return slots;
            }
            assert!(started.elapsed() < SCHEDULED_START_TIMEOUT, "{slots:?}");
            sleep(Duration::from_millis(100));
        }
    }

    /// Waits until the newest slot has `outcome`; asserts that it is the only one, with this time and reason.
    pub fn wait_for_single_slot(&self, at: &str, outcome: &str, reason: &str) {
        let slots = self.wait_for_newest_slot_outcome(outcome);
        let [[instant, _, why]] = slots.as_slice() else { panic!("{slots:?}") };
        assert!(instant == at && why.contains(reason), "{slots:?}");
    }
}

pub fn start_cycle_1(daemon: &DaemonProcess) {
    assert_eq!(daemon.http().start_cycle(1), 202);
}

/// The schedule of the built-in machine as the daemon reports it.
pub fn schedule_json(daemon: &DaemonProcess) -> Value {
    daemon.http().get_json(&format!("{MACHINE_API_PATH}/schedule"))
}

/// Waits until the newest slot has its run, which is run 1.
pub fn wait_until_newest_slot_has_run(daemon: &DaemonProcess) {
    let started = Instant::now();
    loop {
        let schedule = schedule_json(daemon);
        if schedule["last"][0]["run"] == 1 {
            return;
        }
        assert!(started.elapsed() < SCHEDULED_START_TIMEOUT, "{schedule}");
        sleep(Duration::from_millis(100));
    }
}
