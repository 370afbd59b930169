//! Lists trials and runs them with libtest-mimic, in pools. All trials are submitted at once; a trial starts when
//! its pool has a free slot, the longest first. Trials of `Pool::Alone` start after all others have ended.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use libtest_mimic::{Arguments, Completion, Failed, Trial};

use testing::population::is_full_test_run;

/// Time limit of a trial. A trial that exceeds it is named, and the process exits.
const TRIAL_TIME_LIMIT: Duration = Duration::from_secs(10 * 60);
/// The same for a trial that runs in `.ci/long` only, or at full size.
const LONG_TRIAL_TIME_LIMIT: Duration = Duration::from_secs(60 * 60);
/// Shortest duration that is printed.
const MIN_PRINTED_DURATION: Duration = Duration::from_secs(5);
/// Maximum number of runs of a trial whose failure is the peer's own.
const MAX_TRIAL_RUNS: usize = 3;
const WAITING_POOL_SIZE: usize = 6;
const BROWSER_POOL_SIZE: usize = 2;

/// Resource that a trial needs; limits how many of these trials run at the same time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pool {
    /// CPU-bound, or with its own thread pool: one trial per core.
    Computing,
    /// Mostly waits for a child process, a timer or a simulated machine.
    Waiting,
    /// Starts a browser.
    Browser,
    /// Runs LinuxCNC, whose real-time environment exists once per computer.
    LinuxCnc,
    /// Runs grblHAL, which computes its steps in real time: a busy core would delay them.
    GrblHal,
    /// Measures time, load or memory, or must reply in time: no other trial runs meanwhile.
    Alone,
}

impl Pool {
    fn size(self) -> usize {
        match self {
            Pool::Computing => available_parallelism().map_or(2, usize::from),
            Pool::Waiting => WAITING_POOL_SIZE,
            Pool::Browser => BROWSER_POOL_SIZE,
            Pool::LinuxCnc | Pool::GrblHal | Pool::Alone => 1,
        }
    }
}

/// Returns the reason why a trial cannot run on this computer, or `None`.
pub type MissingPeerCheck = fn() -> Option<&'static str>;

struct TrialEntry {
    name: String,
    pool: Pool,
    typical_s: u32,
    ignored: bool,
    missing_peer: MissingPeerCheck,
    /// Whether a missing peer is a failure with `TRUED_REQUIRE_PEERS=1`.
    fails_without_peer: bool,
    /// Whether a failure is the peer's own: the trial is then repeated.
    repeated_if: fn(&Failed) -> bool,
    run: fn() -> Result<(), Failed>,
}

/// Trials of a suite.
#[derive(Default)]
pub struct Trials(Vec<TrialEntry>);

impl Trials {
    pub fn add(&mut self, (module, path): (&str, &str), pool: Pool, typical_s: u32, run: fn() -> Result<(), Failed>) {
        let path = format!("{module}::{path}");
        // The path without the name of the binary.
        let name = path.split_once("::").map_or(path.as_str(), |(_, name)| name).to_owned();
        self.0.push(TrialEntry {
            name,
            pool,
            typical_s,
            ignored: false,
            missing_peer: || None,
            fails_without_peer: true,
            repeated_if: |_| false,
            run,
        });
    }

    pub fn with_trials(mut self, other: Trials) -> Self {
        self.0.extend(other.0);
        self
    }

    /// The trials run with `--ignored` only, as in `.ci/long`.
    pub fn mark_ignored(mut self) -> Self {
        self.0.iter_mut().for_each(|entry| entry.ignored = true);
        self
    }

    pub fn repeat_if(mut self, repeated_if: fn(&Failed) -> bool) -> Self {
        self.0.iter_mut().for_each(|entry| entry.repeated_if = repeated_if);
        self
    }

    /// The trials are skipped where the peer is missing; with `TRUED_REQUIRE_PEERS=1` they fail.
    pub fn requires_peer(mut self, missing_peer: MissingPeerCheck) -> Self {
        self.0.iter_mut().for_each(|entry| entry.missing_peer = missing_peer);
        self
    }

    /// The trials are skipped where the peer is missing, also with `TRUED_REQUIRE_PEERS=1`: it is not publicly
    /// available.
    pub fn skipped_without_peer(mut self, missing_peer: MissingPeerCheck) -> Self {
        self = self.requires_peer(missing_peer);
        self.0.iter_mut().for_each(|entry| entry.fails_without_peer = false);
        self
    }
}

/// Whether `PATH` has this command.
pub fn is_command_in_path(name: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(name).is_file()))
}

/// Result of a trial function: it panics, or it returns a failure.
pub trait IntoResult {
    fn into_result(self) -> Result<(), Failed>;
}

impl IntoResult for () {
    fn into_result(self) -> Result<(), Failed> {
        Ok(())
    }
}

impl IntoResult for Result<(), Failed> {
    fn into_result(self) -> Result<(), Failed> {
        self
    }
}

/// `trials![pool, typical duration in seconds; function, ...]`, named by the paths of the functions. A trial
/// function that no list contains is dead code, which clippy rejects.
macro_rules! trials {
    ($pool:expr, $typical_s:expr; $($trial:path),* $(,)?) => {{
        let mut trials = $crate::support::harness::Trials::default();
        $(
            trials.add((module_path!(), stringify!($trial)), $pool, $typical_s, || {
                $crate::support::harness::IntoResult::into_result($trial())
            });
        )*
        trials
    }};
}
pub(crate) use trials;

/// Runs the trials selected on the command line, and exits.
pub fn run_trials(trials: Trials) -> ! {
    let mut arguments = Arguments::from_args();
    let mut entries = trials.0;
    entries.sort_by_key(|entry| (entry.pool == Pool::Alone, Reverse(entry.typical_s)));
    arguments.test_threads.get_or_insert(entries.len().max(2));
    let admission = Arc::new(PoolAdmission::default());
    let trials = entries.into_iter().enumerate();
    let trials = trials.map(|(rank, entry)| build_trial(entry, rank, &admission)).collect();
    libtest_mimic::run(&arguments, trials).exit()
}

fn build_trial(entry: TrialEntry, rank: usize, admission: &Arc<PoolAdmission>) -> Trial {
    let TrialEntry { name, pool, ignored, missing_peer, fails_without_peer, repeated_if, run, .. } = entry;
    let admission = Arc::clone(admission);
    let unfinished = (pool != Pool::Alone).then(|| UnfinishedTrial::new(&admission));
    let limit = if ignored || is_full_test_run() { LONG_TRIAL_TIME_LIMIT } else { TRIAL_TIME_LIMIT };
    let watched_name = name.clone();
    let trial = Trial::ignorable_test(name, move || {
        let _unfinished = unfinished;
        if let Some(reason) = missing_peer() {
            return match std::env::var("TRUED_REQUIRE_PEERS") {
                Ok(value) if value == "1" && fails_without_peer => Err(reason.into()),
                _ => Ok(Completion::ignored_with(reason)),
            };
        }
        let _place = PoolAdmission::wait_for_slot(&admission, pool, rank);
        run_with_time_limit(&watched_name, limit, || run_with_repeats(run, repeated_if)).map(|()| Completion::Completed)
    });
    trial.with_ignored_flag(ignored)
}

fn run_with_repeats(run: fn() -> Result<(), Failed>, repeated_if: fn(&Failed) -> bool) -> Result<(), Failed> {
    let mut result = run();
    for _ in 1..MAX_TRIAL_RUNS {
        match &result {
            Err(failed) if repeated_if(failed) => {
                println!("repeated: {}", failed.message().unwrap_or_default());
                result = run();
            }
            _ => break,
        }
    }
    result
}

fn run_with_time_limit<T>(name: &str, limit: Duration, run: impl FnOnce() -> T) -> T {
    let (_end, ended) = channel::<()>();
    let watched_name = name.to_owned();
    std::thread::spawn(move || {
        if ended.recv_timeout(limit) == Err(RecvTimeoutError::Timeout) {
            eprintln!("{watched_name} exceeds its limit of {} s: exit", limit.as_secs());
            std::process::exit(101);
        }
    });
    let started = Instant::now();
    let result = run();
    let duration = started.elapsed();
    if duration >= MIN_PRINTED_DURATION {
        eprintln!("{name}: {:.0} s", duration.as_secs_f64());
    }
    result
}

/// Occupied slots, and trials that wait for one.
#[derive(Default)]
struct PoolAdmission {
    state: Mutex<PoolAdmissionState>,
    changed: Condvar,
}

#[derive(Default)]
struct PoolAdmissionState {
    running_trials: BTreeMap<Pool, usize>,
    waiting_ranks: BTreeSet<(Pool, usize)>,
    /// Number of unfinished trials of all pools except `Alone`.
    unfinished_trials: usize,
}

impl PoolAdmissionState {
    fn admits(&self, pool: Pool, rank: usize) -> bool {
        let first = self.waiting_ranks.iter().find(|(other, _)| *other == pool);
        first == Some(&(pool, rank))
            && self.running_trials.get(&pool).copied().unwrap_or(0) < pool.size()
            && (pool != Pool::Alone || self.unfinished_trials == 0)
    }
}

impl PoolAdmission {
    fn change_state(&self, change: impl FnOnce(&mut PoolAdmissionState)) {
        change(&mut self.state());
        self.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, PoolAdmissionState> {
        self.state.lock().expect("no panic under this lock")
    }

    /// Blocks until the pool has a slot for the trial of this rank.
    fn wait_for_slot(admission: &Arc<Self>, pool: Pool, rank: usize) -> PoolSlot {
        let mut state = admission.state();
        state.waiting_ranks.insert((pool, rank));
        let blocked = |state: &mut PoolAdmissionState| !state.admits(pool, rank);
        let mut state = admission.changed.wait_while(state, blocked).expect("no panic");
        state.waiting_ranks.remove(&(pool, rank));
        *state.running_trials.entry(pool).or_default() += 1;
        drop(state);
        // The next trial of the pool may have a slot as well.
        admission.changed.notify_all();
        PoolSlot { admission: Arc::clone(admission), pool }
    }
}

/// A slot of a pool, until dropped.
struct PoolSlot {
    admission: Arc<PoolAdmission>,
    pool: Pool,
}

impl Drop for PoolSlot {
    fn drop(&mut self) {
        self.admission.change_state(|state| *state.running_trials.entry(self.pool).or_default() -= 1);
    }
}

/// A trial that has not ended: dropped after it ran, and also if it is filtered out or ignored.
struct UnfinishedTrial(Arc<PoolAdmission>);

impl UnfinishedTrial {
    fn new(admission: &Arc<PoolAdmission>) -> Self {
        admission.change_state(|state| state.unfinished_trials += 1);
        Self(Arc::clone(admission))
    }
}

impl Drop for UnfinishedTrial {
    fn drop(&mut self) {
        self.0.change_state(|state| state.unfinished_trials -= 1);
    }
}
