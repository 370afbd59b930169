//! The page and the HTTP API. They listen on this computer only; access from other computers needs a proxy.
//!
//! The server has its own thread and reads the gate and the journal, so that no client, however slow, delays a run.
//! A hold goes from here directly to the control.

mod access;
mod actions;
mod api;
mod connections;
mod events;
mod journal;
mod metrics;
mod newest_result;
mod openapi;
mod page;
mod page_address;
mod problem;
mod request_checks;
mod schedule;
mod status;

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use tokio::sync::Semaphore;

use self::access::Access;
pub use self::access::{Role, Token, TokenError, Tokens};
pub use self::page::machine_page_path;
pub use self::page_address::PageAddressFile;
use super::command_gate::CommandGate;
use super::config::{CycleConfig, HttpConfig, StartInterlock};
use super::metrics::Metrics;
use super::{Log, ServeError};
use crate::run::{HTTP_NICE, lower_priority};
use crate::store::Journal;
use machine::record::estimate::ParameterLimit;

/// A machine that the page shows.
#[derive(Clone)]
pub struct ServedMachine {
    pub name: String,
    /// SHA-256 of its machine file.
    pub file_sha256: String,
    pub gate: CommandGate,
    pub cycles: Vec<CycleConfig>,
    /// Conditions that a person must confirm to start a cycle.
    pub required_interlocks: Vec<StartInterlock>,
    pub tolerance: Vec<ParameterLimit>,
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
    reader_permits: Arc<Semaphore>,
    /// Live part of each machine's page.
    live_parts: Arc<BTreeMap<String, page::RenderingCache>>,
    hold_log: actions::HoldLog,
}

impl AppState {
    fn find_machine(&self, name: &str) -> Option<&ServedMachine> {
        self.machines.iter().find(|machine| machine.name == name)
    }

    /// Tolerances of the machine file; empty for a machine that is not served.
    fn tolerance_limits(&self, name: &str) -> Vec<ParameterLimit> {
        self.find_machine(name).map(|machine| machine.tolerance.clone()).unwrap_or_default()
    }
}

/// Starts the server, which runs for as long as the process lives.
///
/// # Errors
/// The address cannot be listened on, the tokens cannot be read, or the thread cannot be started.
pub fn start_http_server(
    config: &HttpConfig,
    machines: Vec<ServedMachine>,
    journal: Arc<Journal>,
    metrics: Metrics,
    log: &Log,
) -> Result<(), ServeError> {
    let listen_error = |source| ServeError::Listen { server: "the page server", listen: config.listen, source };
    let listener = TcpListener::bind(config.listen).map_err(listen_error)?;
    listener.set_nonblocking(true).map_err(listen_error)?;
    let at = listener.local_addr().map_err(listen_error)?;
    let names = request_checks::HostNames::new(at, &config.proxy_names);
    let access = Access::new(config, journal.state_dir(), log)?;
    let files = machines.iter().map(|machine| (machine.name.clone(), machine.file_sha256.clone()));
    let (pid, machine_files) = (std::process::id(), files.collect());
    let address_file = PageAddressFile { pid, page: at, machine_files };
    if let Err(error) = address_file.write(journal.state_dir()) {
        log.error(&format!(
            "the address file of the page cannot be written, so commands will not find the page: {error}"
        ));
    }
    for machine in &machines {
        if let Err(error) = machine.gate.query_newest(&journal, &machine.name) {
            log.error(&format!("the last result of {} cannot be read: {error}", machine.name));
        }
    }
    let readers = Arc::new(Semaphore::new(MAX_READERS));
    let live = machines.iter().map(|machine| (machine.name.clone(), page::RenderingCache::default()));
    let live = Arc::new(live.collect());
    let (machines, holds) = (machines.into(), actions::HoldLog::default());
    let app =
        AppState { machines, journal, metrics, access, reader_permits: readers, live_parts: live, hold_log: holds };
    let (server_app, router) = (app.clone(), build_router(app, names));
    let server_log = log.clone();
    std::thread::Builder::new()
        .name("http".to_owned())
        .spawn(move || {
            // The reader threads that this thread starts inherit its lower priority.
            lower_priority(HTTP_NICE);
            if let Err(error) = run_http_server(listener, server_app, router) {
                server_log.error(&format!("the page server stopped: {error}"));
            }
        })
        .map_err(ServeError::Thread)?;
    log.info(&format!("the page is at http://{at}/"));
    Ok(())
}

/// Maximum number of concurrent readers of the journal; others wait, so that the run has the rest of the computer.
const MAX_READERS: usize = 2;

fn run_http_server(listener: TcpListener, app: AppState, router: Router) -> std::io::Result<()> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_all().max_blocking_threads(MAX_READERS).build()?;
    runtime.block_on(async {
        for machine in app.machines.iter() {
            tokio::spawn(newest_result::refresh_on_changes(app.clone(), machine.clone()));
        }
        let listener = tokio::net::TcpListener::from_std(listener)?;
        connections::accept_connections(listener, router).await
    })
}

fn build_router(app: AppState, names: request_checks::HostNames) -> Router {
    let access = Arc::clone(&app.access);
    let all = openapi::openapi_routes().merge(page::page_routes()).merge(access::login_routes());
    let all = all.merge(metrics::metrics_routes());
    request_checks::with_checks(all.with_state(app), names, access)
}
