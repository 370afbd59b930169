//! The page and the HTTP API. They listen on this computer only; access from other computers needs a proxy.
//!
//! The server has its own thread and reads the gate and the journal, so that no client, however slow, delays a run.
//! A hold goes from here directly to the control.

mod access;
mod actions;
mod api;
mod connections;
mod events;
mod guard;
mod journal;
mod metrics;
mod openapi;
mod page;
mod problem;
mod results;
mod schedule;
mod status;
mod whereabouts;

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use tokio::sync::Semaphore;

use self::access::Access;
pub use self::access::{Role, Token, TokenError, Tokens};
pub use self::page::address;
pub use self::whereabouts::PageAddressFile;
use super::command_gate::CommandGate;
use super::config::{Cycle, Demand, Http};
use super::metrics::Metrics;
use super::{Log, ServeError};
use crate::run::{HTTP_NICE, lower_priority};
use crate::store::Journal;
use machine::record::estimate::Limit;

/// A machine that the page shows.
#[derive(Clone)]
pub struct ServedMachine {
    pub name: String,
    /// SHA-256 of its machine file.
    pub file_sha256: String,
    pub gate: CommandGate,
    pub cycles: Vec<Cycle>,
    /// Conditions that a person must confirm to start a cycle.
    pub demand: Vec<Demand>,
    pub tolerance: Vec<Limit>,
    /// Time for which a verdict stays valid.
    pub verdict_validity: Duration,
}

/// Shared state of all handlers.
#[derive(Clone)]
struct AppState {
    machines: Arc<[ServedMachine]>,
    journal: Arc<Journal>,
    metrics: Metrics,
    access: Arc<Access>,
    readers: Arc<Semaphore>,
    /// Live part of each machine's page.
    live: Arc<BTreeMap<String, page::Shared>>,
    holds: actions::Holds,
}

impl AppState {
    fn machine(&self, name: &str) -> Option<&ServedMachine> {
        self.machines.iter().find(|machine| machine.name == name)
    }

    /// Tolerances of the machine file; empty for a machine that is not served.
    fn tolerance(&self, name: &str) -> Vec<Limit> {
        self.machine(name).map(|machine| machine.tolerance.clone()).unwrap_or_default()
    }
}

/// Starts the server, which runs for as long as the process lives.
///
/// # Errors
/// The address cannot be listened on, the tokens cannot be read, or the thread cannot be started.
pub fn start(
    config: &Http,
    machines: Vec<ServedMachine>,
    journal: Arc<Journal>,
    metrics: Metrics,
    log: &Log,
) -> Result<(), ServeError> {
    let cannot = |source| ServeError::Listen { what: "the page", listen: config.listen, source };
    let listener = TcpListener::bind(config.listen).map_err(cannot)?;
    listener.set_nonblocking(true).map_err(cannot)?;
    let at = listener.local_addr().map_err(cannot)?;
    let names = guard::Names::of(at, &config.names);
    let access = Access::new(config, journal.folder(), log)?;
    let files = machines.iter().map(|one| (one.name.clone(), one.file_sha256.clone()));
    let (pid, machine_files) = (std::process::id(), files.collect());
    let here = PageAddressFile { pid, page: at, machine_files };
    if let Err(error) = here.leave(journal.folder()) {
        log.fault(&format!("commands will not find the page: {error}"));
    }
    for machine in &machines {
        if let Err(error) = machine.gate.query_newest(&journal, &machine.name) {
            log.fault(&format!("what {} was found to be is not known: {error}", machine.name));
        }
    }
    let readers = Arc::new(Semaphore::new(READERS));
    let live = machines.iter().map(|machine| (machine.name.clone(), page::Shared::default()));
    let live = Arc::new(live.collect());
    let (machines, holds) = (machines.into(), actions::Holds::default());
    let web = AppState { machines, journal, metrics, access, readers, live, holds };
    let (followed, router) = (web.clone(), router(web, names));
    let told = log.clone();
    std::thread::Builder::new()
        .name("http".to_owned())
        .spawn(move || {
            // The reader threads that this thread starts inherit its lower priority.
            lower_priority(HTTP_NICE);
            if let Err(error) = serve(listener, followed, router) {
                told.fault(&format!("the page has ended: {error}"));
            }
        })
        .map_err(ServeError::Thread)?;
    log.say(&format!("the page is at http://{at}/"));
    Ok(())
}

/// Maximum number of concurrent readers of the journal; others wait, so that the run has the rest of the computer.
const READERS: usize = 2;

fn serve(listener: TcpListener, web: AppState, router: Router) -> std::io::Result<()> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_all().max_blocking_threads(READERS).build()?;
    runtime.block_on(async {
        for machine in web.machines.iter() {
            tokio::spawn(results::follow(web.clone(), machine.clone()));
        }
        let listener = tokio::net::TcpListener::from_std(listener)?;
        connections::serve(listener, router).await
    })
}

fn router(web: AppState, names: guard::Names) -> Router {
    let access = Arc::clone(&web.access);
    let all = openapi::routes().merge(page::routes()).merge(access::routes());
    let all = all.merge(metrics::routes());
    guard::around(all.with_state(web), names, access)
}
