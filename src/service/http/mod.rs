//! The page and its interface for programs, over HTTP. On this computer alone: beyond it stands a proxy.
//!
//! It runs on a thread of its own and looks at the desk and the journal; whoever asks, and however slowly
//! they listen, disturbs no run. A hold goes to the control from here at once.

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
mod standing;
mod whereabouts;

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::Arc;

use axum::Router;
use tokio::sync::Semaphore;

use self::access::Access;
pub use self::access::{Role, Token, TokenError, Tokens};
pub use self::page::address;
pub use self::results::Last;
pub use self::whereabouts::Whereabouts;
use super::config::{Cycle, Demand, Http};
use super::desk::Desk;
use super::metrics::Metrics;
use super::{Log, ServeError};
use crate::run::{ANSWERING, behind};
use crate::store::Journal;
use machine::record::estimate::Limit;

/// A machine that is shown.
#[derive(Clone)]
pub struct Shown {
    pub name: String,
    /// Of its machine file.
    pub file_sha256: String,
    pub desk: Desk,
    pub cycles: Vec<Cycle>,
    /// What a person must vouch for to start one of them.
    pub demand: Vec<Demand>,
    pub tolerance: Vec<Limit>,
    /// What it was found to be.
    pub last: Last,
}

/// What all answers are made from.
#[derive(Clone)]
struct Web {
    machines: Arc<[Shown]>,
    journal: Arc<Journal>,
    metrics: Metrics,
    access: Arc<Access>,
    readers: Arc<Semaphore>,
    /// Of each machine.
    live: Arc<BTreeMap<String, page::Shared>>,
    holds: actions::Holds,
}

impl Web {
    fn machine(&self, name: &str) -> Option<&Shown> {
        self.machines.iter().find(|machine| machine.name == name)
    }

    /// As its file has it; of a machine that is not served here nothing is known.
    fn tolerance(&self, name: &str) -> Vec<Limit> {
        self.machine(name).map(|machine| machine.tolerance.clone()).unwrap_or_default()
    }
}

/// Listen, and serve for as long as the process lives.
///
/// # Errors
/// The address is another's; the tokens cannot be read; no thread.
pub fn start(
    config: &Http,
    machines: Vec<Shown>,
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
    let here = Whereabouts { pid, page: at, machine_files };
    if let Err(error) = here.leave(journal.folder()) {
        log.fault(&format!("commands will not find the page: {error}"));
    }
    for machine in &machines {
        if let Err(error) = machine.last.look(&journal, &machine.name) {
            log.fault(&format!("what {} was found to be is not known: {error}", machine.name));
        }
    }
    let readers = Arc::new(Semaphore::new(READERS));
    let live = machines.iter().map(|machine| (machine.name.clone(), page::Shared::default()));
    let live = Arc::new(live.collect());
    let (machines, holds) = (machines.into(), actions::Holds::default());
    let web = Web { machines, journal, metrics, access, readers, live, holds };
    let (followed, router) = (web.clone(), router(web, names));
    let told = log.clone();
    std::thread::Builder::new()
        .name("http".to_owned())
        .spawn(move || {
            // So do the readers that it starts.
            behind(ANSWERING);
            if let Err(error) = serve(listener, followed, router) {
                told.fault(&format!("the page has ended: {error}"));
            }
        })
        .map_err(ServeError::Thread)?;
    log.say(&format!("the page is at http://{at}/"));
    Ok(())
}

/// Readers of the journal at a time; others wait, and the run has the rest of the computer.
const READERS: usize = 2;

fn serve(listener: TcpListener, web: Web, router: Router) -> std::io::Result<()> {
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

fn router(web: Web, names: guard::Names) -> Router {
    let access = Arc::clone(&web.access);
    let all = openapi::routes().merge(page::routes()).merge(access::routes());
    let all = all.merge(metrics::routes());
    guard::around(all.with_state(web), names, access)
}
