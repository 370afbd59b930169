//! The journal. One thread executes all write jobs in sequence; the caller gets the result after the commit is on the
//! disk. Readers use their own connections and never wait for the writer.

use std::future::Future;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::mpsc;
use std::task::{Context, Poll};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rusqlite::Connection;
use tokio::sync::oneshot;

use super::durable_dir::{self, JOURNAL_FILE_NAME};
use super::{
    EstimateSelection, EstimateSignature, FinishedRunResult, MachineLock, NewRun, RunId, RunProgress, RunState,
    RunSummary, StoreError, StoreFault, StoredRun,
};
use super::{connection, read, scan, signature, write};
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::plan::{Stage, Step};
use machine::record::reading::Reading;

type WriterJob = Box<dyn FnOnce(&mut Connection) + Send>;

/// The journal of one state directory. Dropping it first completes all submitted jobs.
pub struct Journal {
    path: PathBuf,
    job_sender: Option<mpsc::Sender<WriterJob>>,
    writer_thread: Option<JoinHandle<()>>,
}

/// Result of a job, available once the job is durable or has failed: `.await` it in async code, use
/// [`AwaitableWrite::wait`] elsewhere. The job runs even if the `AwaitableWrite` is dropped.
#[must_use = "the job is durable only after the result is received"]
pub struct AwaitableWrite<T> {
    path: PathBuf,
    result_receiver: oneshot::Receiver<Result<T, StoreFault>>,
}

impl<T> AwaitableWrite<T> {
    /// Blocks this thread until the result is available. Async code must use `.await` instead.
    pub fn wait(self) -> Result<T, StoreError> {
        let result = self.result_receiver.blocking_recv();
        result.unwrap_or(Err(StoreFault::WriterEnded)).map_err(StoreError::from_fault_at(&self.path))
    }
}

impl<T> Future for AwaitableWrite<T> {
    type Output = Result<T, StoreError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let result = Pin::new(&mut self.result_receiver).poll(context);
        result
            .map(|result| result.unwrap_or(Err(StoreFault::WriterEnded)).map_err(StoreError::from_fault_at(&self.path)))
    }
}

impl Journal {
    /// Opens or creates the journal in `dir` (which is created as well) and migrates its tables. A copy of a
    /// journal of an older version is kept beside it. A file is refused and not changed if it is no journal, or
    /// if its heads of runs, audit log, armings or schedules are damaged.
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        Self::open_with_job_callback(dir, |_| {})
    }

    /// The state directory.
    pub fn state_dir(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// As [`Self::open`]; `on_job_done` is called on the writer's thread with the duration of each job.
    pub fn open_with_job_callback(
        dir: &Path,
        on_job_done: impl Fn(Duration) + Send + 'static,
    ) -> Result<Self, StoreError> {
        let path = dir.join(JOURNAL_FILE_NAME);
        Self::open_and_spawn_writer(dir, &path, on_job_done).map_err(StoreError::from_fault_at(&path))
    }

    fn open_and_spawn_writer(
        dir: &Path,
        path: &Path,
        on_job_done: impl Fn(Duration) + Send + 'static,
    ) -> Result<Self, StoreFault> {
        durable_dir::create_dir_durably(dir)?;
        let connection = connection::open_writer(path)?;
        // SQLite syncs the directory as well, but ignores an error.
        durable_dir::sync_dir(dir)?;
        let (jobs, job_queue) = mpsc::channel();
        let writer = thread::Builder::new()
            .name("journal".to_owned())
            .spawn(move || execute_writer_jobs(connection, &job_queue, on_job_done))?;
        Ok(Self { path: path.to_owned(), job_sender: Some(jobs), writer_thread: Some(writer) })
    }

    /// Adds a run in state `running`, with this program's version and the hashes of its inputs.
    pub fn begin_run(&self, new: &NewRun) -> AwaitableWrite<RunId> {
        let new = new.clone();
        self.submit_job(move |connection| write::insert_run(connection, &new))
    }

    /// Adds a stage that is about to run, and its new steps to the plan.
    pub fn add_stage(&self, run: RunId, stage: &Stage, new_steps: &[Step]) -> AwaitableWrite<()> {
        let (stage, steps) = (stage.clone(), new_steps.to_vec());
        self.submit_job(move |connection| write::insert_stage(connection, run, &stage, &steps))
    }

    pub fn add_reading(&self, run: RunId, reading: &Reading) -> AwaitableWrite<()> {
        let reading = reading.clone();
        self.submit_job(move |connection| write::insert_reading(connection, run, &reading))
    }

    /// Adds all samples of one scan.
    pub fn add_scan(&self, run: RunId, samples: &[Reading]) -> AwaitableWrite<()> {
        let samples = samples.to_vec();
        self.submit_job(move |connection| scan::insert_scan(connection, run, &samples))
    }

    pub fn add_event(&self, run: RunId, event: &RunEvent) -> AwaitableWrite<()> {
        let event = event.clone();
        self.submit_job(move |connection| write::insert_event(connection, run, &event))
    }

    /// Adds an estimate; earlier estimates of the run stay. Returns its [`super::sha256_of_json`].
    pub fn add_estimate(&self, run: RunId, estimate: &Estimate) -> AwaitableWrite<String> {
        let estimate = estimate.clone();
        self.submit_job(move |connection| write::insert_estimate(connection, run, &estimate))
    }

    /// Adds a signature that is never changed or removed.
    pub fn add_signature(&self, run: RunId, signature: &EstimateSignature) -> AwaitableWrite<()> {
        let signature = signature.clone();
        self.submit_job(move |connection| signature::insert_signature(connection, run, &signature))
    }

    /// Sets the state of the run.
    pub fn set_state(&self, run: RunId, state: RunState) -> AwaitableWrite<()> {
        self.submit_job(move |connection| write::set_state(connection, run, state))
    }

    /// Marks as interrupted the runs whose process died in state `running`. Holding the machine's lock proves that the
    /// process is dead.
    pub fn mark_running_runs_interrupted(&self, lock: &MachineLock) -> AwaitableWrite<Vec<RunId>> {
        let machine = lock.machine().to_owned();
        self.submit_job(move |connection| write::mark_interrupted(connection, &machine))
    }

    /// All runs, oldest first.
    pub fn runs(&self) -> Result<Vec<RunSummary>, StoreError> {
        self.query(|connection| read::select_all_runs(connection))
    }

    /// The newest run of `method` on `machine` that is finished and has an estimate.
    pub fn newest_run_with_estimate(&self, machine: &str, method: &str) -> Result<Option<RunId>, StoreError> {
        self.query(|connection| read::newest_run_with_estimate(connection, machine, method))
    }

    /// Calls `visit` with the selected estimate of each of the newest `runs_per_method` finished runs of each method on
    /// `machine`, oldest first.
    pub fn visit_finished_run_results(
        &self,
        machine: &str,
        runs_per_method: u32,
        selection: EstimateSelection,
        visit: impl FnMut(FinishedRunResult),
    ) -> Result<(), StoreError> {
        self.query(|connection| {
            read::visit_finished_run_results(connection, machine, runs_per_method, selection, visit)
        })
    }

    /// All data of one run, as of one instant.
    pub fn load_run(&self, run: RunId) -> Result<StoredRun, StoreError> {
        self.query(|connection| read::load_run(connection, run))
    }

    /// Progress of a run, without its readings.
    pub fn load_run_progress(&self, run: RunId) -> Result<RunProgress, StoreError> {
        self.query(|connection| read::load_progress(connection, run))
    }

    pub(super) fn query<T>(
        &self,
        read: impl FnOnce(&mut Connection) -> Result<T, StoreFault>,
    ) -> Result<T, StoreError> {
        connection::open_reader(&self.path)
            .and_then(|mut connection| read(&mut connection))
            .map_err(StoreError::from_fault_at(&self.path))
    }

    pub(super) fn submit_job<T: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Connection) -> Result<T, StoreFault> + Send + 'static,
    ) -> AwaitableWrite<T> {
        let (sender, receiver) = oneshot::channel();
        let job: WriterJob = Box::new(move |connection| drop(sender.send(job(connection))));
        // A refused job drops its sender; the caller gets `WriterEnded`.
        if let Some(jobs) = &self.job_sender {
            let _ = jobs.send(job);
        }
        AwaitableWrite { path: self.path.clone(), result_receiver: receiver }
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        drop(self.job_sender.take());
        if let Some(writer) = self.writer_thread.take() {
            let _ = writer.join();
        }
    }
}

fn execute_writer_jobs(
    mut connection: Connection,
    job_queue: &mpsc::Receiver<WriterJob>,
    on_job_done: impl Fn(Duration),
) {
    while let Ok(job) = job_queue.recv() {
        let began = Instant::now();
        job(&mut connection);
        on_job_done(began.elapsed());
    }
}
