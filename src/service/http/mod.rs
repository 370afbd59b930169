//! The web page and the HTTP API. They listen on this computer only; access from other computers needs a proxy.
//!
//! The server has its own thread and reads the gate and the journal, so that no client, however slow, delays a run.
//! A hold request triggers the halt handle of the control directly, without the machine's worker.

mod access;
mod actions;
mod api;
mod api_errors;
mod compensation;
mod connections;
mod events;
mod machine_status;
mod newest_result;
mod openapi;
mod page;
mod page_address_file;
mod percent_encode;
mod problem;
mod request_checks;
mod run_files;
mod run_list_query;
mod schedule;

use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{FromRequestParts, Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use jiff::Timestamp;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use self::access::{AccessControl, Caller};
pub use self::access::{Role, Token, TokenError, TokenStore};
pub use self::page::machine_page_path;
pub use self::page_address_file::PageAddressFile;
use self::problem::Problem;
use super::command_gate::CommandGate;
use super::config::HttpConfig;
use super::machine_state::Refusal;
use super::metrics::Metrics;
use super::{Log, ServeError, spawn_thread};
use crate::compensation::{CompensationError, MachineCompensation, needs_control_link};
use crate::run::{HTTP_NICE, lower_priority};
use crate::setup::MachineFile;
use crate::store::{Journal, MachineLock, sha256_text};

/// A machine that the web page and the HTTP API serve.
#[derive(Clone)]
pub struct ServedMachine {
    pub name: String,
    pub machine_file: Arc<MachineFile>,
    pub gate: CommandGate,
    /// Cache of the rendered live part of the machine's page.
    pub live_part_cache: Arc<page::RenderingCache>,
}

/// State that all request handlers share.
#[derive(Clone)]
struct AppState {
    machines: Arc<[ServedMachine]>,
    journal: Arc<Journal>,
    metrics: Metrics,
    access: Arc<AccessControl>,
    /// Permits to read the journal, [`MAX_JOURNAL_READERS`] in number.
    journal_reader_permits: Arc<Semaphore>,
    /// Permits to read values of the controls without the link of the control, [`MAX_CONTROL_READERS`] in number.
    control_reader_permits: Arc<Semaphore>,
    hold_log: actions::HoldLog,
}

impl AppState {
    fn find_machine(&self, name: &str) -> Result<&ServedMachine, Problem> {
        self.machines.iter().find(|machine| machine.name == name).ok_or_else(|| Problem::not_found(name))
    }

    /// Reads the journal outside the thread of the HTTP server, because the disk may be slow.
    async fn read_journal<T: Send + 'static>(
        &self,
        read: impl FnOnce(&Journal) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let journal = Arc::clone(&self.journal);
        read_with_permit(&self.journal_reader_permits, move || read(&journal)).await
    }

    /// Reads values of the control of `machine`, which may be slow, and the journal. If the values need the link of
    /// the control, the worker reads them while the machine waits for a start, and a metrologist must request it.
    /// `target`: key of `[compensation]`, if there are several.
    async fn read_control<T: Send + 'static>(
        &self,
        caller: &Caller,
        machine: &ServedMachine,
        target: Option<String>,
        read: impl FnOnce(&MachineCompensation<'_>) -> Result<T, CompensationError> + Send + 'static,
    ) -> Result<T, Problem> {
        if needs_control_link(&machine.machine_file, target.as_deref()) {
            caller.require_metrologist()?;
            let read = move |compensation: &MachineCompensation<'_>, _: &MachineLock| read(compensation);
            let accepted = machine.gate.compensate("reading of values of the control", target, read)?;
            let result = timeout(MAX_RESPONSE_TIME, accepted).await.map_err(|_| Refusal::NotReady)?;
            return Ok(result.map_err(|_| Refusal::NotReady)??);
        }
        let (journal, file) = (Arc::clone(&self.journal), Arc::clone(&machine.machine_file));
        let read = move || read(&MachineCompensation::open(&file, &journal, target.as_deref())?);
        Ok(read_with_permit(&self.control_reader_permits, read).await??)
    }
}

/// Calls `read` when a permit is free. If the client disconnects during the wait, `read` is not called.
async fn read_with_permit<T: Send + 'static>(
    permits: &Arc<Semaphore>,
    read: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let permit = Arc::clone(permits).acquire_owned().await;
    let read = move || {
        let read = read();
        drop(permit);
        read
    };
    tokio::task::spawn_blocking(read).await.map_err(|_| {
        let status = StatusCode::INTERNAL_SERVER_ERROR;
        Problem::new(status, "no-answer", "the query ended without a result", "repeat the request")
    })
}

/// The machine that the path names.
impl FromRequestParts<AppState> for ServedMachine {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, app: &AppState) -> Result<Self, Response> {
        let name = Path::<String>::from_request_parts(parts, app).await.map_err(IntoResponse::into_response)?;
        app.find_machine(&name).cloned().map_err(IntoResponse::into_response)
    }
}

/// Starts the HTTP server, which runs for as long as the process lives.
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
    let names = request_checks::OwnHostNames::new(at, &config.proxy_names);
    let access = AccessControl::new(config, journal.state_dir(), log)?;
    let files = machines.iter().map(|machine| (machine.name.clone(), sha256_text(machine.machine_file.text())));
    let address_file =
        PageAddressFile { pid: std::process::id(), page: at, machine_file_sha256_by_machine: files.collect() };
    if let Err(error) = address_file.write(journal.state_dir()) {
        log.error(&format!(
            "the address file of the page cannot be written, so commands will not find the page: {error}"
        ));
    }
    for machine in &machines {
        if let Err(error) = machine.gate.refresh_newest_runs(&journal, &machine.name) {
            log.error(&format!("the last result of {} cannot be read: {error}", machine.name));
        }
    }
    let app = AppState {
        machines: machines.into(),
        journal,
        metrics,
        access,
        journal_reader_permits: Arc::new(Semaphore::new(MAX_JOURNAL_READERS)),
        control_reader_permits: Arc::new(Semaphore::new(MAX_CONTROL_READERS)),
        hold_log: actions::HoldLog::default(),
    };
    let (router, server_log) = (build_router(app.clone(), names), log.clone());
    spawn_thread("http", move || {
        // The threads that read the journal for this server inherit its lower priority.
        lower_priority(HTTP_NICE);
        if let Err(error) = run_http_server(listener, app, router) {
            server_log.error(&format!("the page server stopped: {error}"));
        }
    })?;
    log.info(&format!("the page is at http://{at}/"));
    Ok(())
}

/// Maximum time that a response waits for the worker, which continues its work after that: less than the time limit
/// of a request that changes something.
const MAX_RESPONSE_TIME: Duration = Duration::from_secs(7);
/// Maximum number of concurrent readers of the journal; further readers wait, so that runs keep their computing time.
const MAX_JOURNAL_READERS: usize = 2;
/// Maximum number of concurrent reads of control values that do not use the worker; such a read may wait for another
/// computer.
const MAX_CONTROL_READERS: usize = 1;

fn run_http_server(listener: TcpListener, app: AppState, router: Router) -> std::io::Result<()> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_all().max_blocking_threads(MAX_JOURNAL_READERS + MAX_CONTROL_READERS).build()?;
    runtime.block_on(async {
        for machine in app.machines.iter() {
            tokio::spawn(newest_result::refresh_newest_runs(app.clone(), machine.clone()));
        }
        let listener = tokio::net::TcpListener::from_std(listener)?;
        connections::accept_connections(listener, router).await
    })
}

fn build_router(app: AppState, names: request_checks::OwnHostNames) -> Router {
    let access = Arc::clone(&app.access);
    let all = openapi::openapi_routes().merge(page::page_routes()).merge(access::login_routes());
    let all = all.route("/metrics", get(serve_metrics));
    let all = all.with_state(app).layer(from_fn(api_errors::unify_api_errors));
    request_checks::with_request_checks(all, names, access)
}

const OPEN_METRICS_CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// `/metrics`, for Prometheus.
async fn serve_metrics(State(app): State<AppState>) -> Response {
    let (machines, now) = (Arc::clone(&app.machines), Timestamp::now());
    // After an error a machine has no results; the other metrics remain available.
    let read_results = move |journal: &Journal| {
        let of_machine = |machine| newest_result::newest_result_of_each_method(journal, machine, now);
        machines.iter().filter_map(|machine| of_machine(machine).ok()).flatten().collect::<Vec<_>>()
    };
    let results = app.read_journal(read_results).await.unwrap_or_default();
    for ServedMachine { name, gate, .. } in app.machines.iter() {
        app.metrics.update_machine(name, &gate.machine_state(), gate.progress_age());
    }
    match app.metrics.encode_text(&results) {
        Ok(text) => ([(CONTENT_TYPE, OPEN_METRICS_CONTENT_TYPE)], text).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
