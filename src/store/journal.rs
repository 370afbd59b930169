//! The journal. One thread writes, one job after the other; the caller gets the answer after the commit is on
//! the disk. Readers use connections of their own and never wait for the writer.

use std::future::Future;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::mpsc;
use std::task::{Context, Poll};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rusqlite::Connection;
use tokio::sync::oneshot;

use super::folder::{self, JOURNAL};
use super::{
    Fault, MachineLock, Measured, NewRun, Progress, RunId, RunState, RunSummary, Signature,
    StoreError, StoredRun,
};
use super::{connection, read, scan, signature, write};
use machine::record::estimate::Estimate;
use machine::record::event::Event;
use machine::record::plan::{Stage, Step};
use machine::record::reading::Reading;

type Job = Box<dyn FnOnce(&mut Connection) + Send>;

/// The journal of one state directory. Dropping it first completes all submitted jobs.
pub struct Journal {
    path: PathBuf,
    jobs: Option<mpsc::Sender<Job>>,
    writer: Option<JoinHandle<()>>,
}

/// Result of a job, available once the job is durable or has failed: `.await` it in async code, use
/// [`Pending::wait`] elsewhere. The job runs even if the `Pending` is dropped.
#[must_use = "nothing is known to be durable before the answer is here"]
pub struct Pending<T> {
    path: PathBuf,
    answer: oneshot::Receiver<Result<T, Fault>>,
}

impl<T> Pending<T> {
    /// Blocks this thread until the result is available. Async code must use `.await` instead.
    pub fn wait(self) -> Result<T, StoreError> {
        let answer = self.answer.blocking_recv();
        answer.unwrap_or(Err(Fault::WriterGone)).map_err(StoreError::at(&self.path))
    }
}

impl<T> Future for Pending<T> {
    type Output = Result<T, StoreError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let answer = Pin::new(&mut self.answer).poll(context);
        answer.map(|answer| {
            answer.unwrap_or(Err(Fault::WriterGone)).map_err(StoreError::at(&self.path))
        })
    }
}

impl Journal {
    /// Opens or creates the journal in `dir` (which is created as well) and migrates its tables. A copy of a
    /// journal of an older version is kept beside it. A file is refused and not changed if it is no journal, or
    /// if its heads of runs, audit log, armings or schedules are damaged.
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        Self::watched(dir, |_| {})
    }

    /// The state directory.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// As [`Self::open`]; `wrote` is called on the writer's thread with the duration of each job.
    pub fn watched(
        dir: &Path,
        wrote: impl Fn(Duration) + Send + 'static,
    ) -> Result<Self, StoreError> {
        let path = dir.join(JOURNAL);
        Self::start(dir, &path, wrote).map_err(StoreError::at(&path))
    }

    fn start(
        dir: &Path,
        path: &Path,
        wrote: impl Fn(Duration) + Send + 'static,
    ) -> Result<Self, Fault> {
        folder::make(dir)?;
        let connection = connection::open_writer(path)?;
        // SQLite syncs the directory as well, but ignores an error.
        folder::sync(dir)?;
        let (jobs, inbox) = mpsc::channel();
        let writer = thread::Builder::new()
            .name("journal".to_owned())
            .spawn(move || work(connection, &inbox, wrote))?;
        Ok(Self { path: path.to_owned(), jobs: Some(jobs), writer: Some(writer) })
    }

    /// Adds a run in state `running`, with this program's version and the hashes of its inputs.
    pub fn begin(&self, new: &NewRun) -> Pending<RunId> {
        let new = new.clone();
        self.submit(move |connection| write::begin(connection, &new))
    }

    /// Adds a stage that is about to run, and its new steps to the plan.
    pub fn stage(&self, run: RunId, stage: &Stage, new_steps: &[Step]) -> Pending<()> {
        let (stage, steps) = (stage.clone(), new_steps.to_vec());
        self.submit(move |connection| write::stage(connection, run, &stage, &steps))
    }

    pub fn reading(&self, run: RunId, reading: &Reading) -> Pending<()> {
        let reading = reading.clone();
        self.submit(move |connection| write::reading(connection, run, &reading))
    }

    /// Adds all samples of one scan.
    pub fn scan(&self, run: RunId, samples: &[Reading]) -> Pending<()> {
        let samples = samples.to_vec();
        self.submit(move |connection| scan::keep(connection, run, &samples))
    }

    pub fn event(&self, run: RunId, event: &Event) -> Pending<()> {
        let event = event.clone();
        self.submit(move |connection| write::event(connection, run, &event))
    }

    /// Adds an estimate; earlier estimates of the run stay. Returns its [`super::sha256`].
    pub fn estimate(&self, run: RunId, estimate: &Estimate) -> Pending<String> {
        let estimate = estimate.clone();
        self.submit(move |connection| write::estimate(connection, run, &estimate))
    }

    /// Adds a signature that is never changed or removed.
    pub fn sign(&self, run: RunId, signature: &Signature) -> Pending<()> {
        let signature = signature.clone();
        self.submit(move |connection| signature::add(connection, run, &signature))
    }

    /// Sets the state of the run.
    pub fn set_state(&self, run: RunId, state: RunState) -> Pending<()> {
        self.submit(move |connection| write::set_state(connection, run, state))
    }

    /// Marks the runs that a dead process left `running`. Holding the machine's lock proves that the process is
    /// dead.
    pub fn mark_interrupted(&self, lock: &MachineLock) -> Pending<Vec<RunId>> {
        let machine = lock.machine().to_owned();
        self.submit(move |connection| write::mark_interrupted(connection, &machine))
    }

    /// All runs, oldest first.
    pub fn runs(&self) -> Result<Vec<RunSummary>, StoreError> {
        self.look(|connection| read::runs(connection))
    }

    /// The newest finished run of `method` on `machine`.
    pub fn newest_of(&self, machine: &str, method: &str) -> Result<Option<RunId>, StoreError> {
        self.look(|connection| read::newest_of(connection, machine, method))
    }

    /// Calls `tell` with the last estimates of the `newest` finished runs of each method on `machine`, oldest
    /// first.
    pub fn measured(
        &self,
        machine: &str,
        newest: u32,
        tell: impl FnMut(Measured),
    ) -> Result<(), StoreError> {
        self.look(|connection| read::measured(connection, machine, newest, tell))
    }

    /// All data of one run, as of one instant.
    pub fn load(&self, run: RunId) -> Result<StoredRun, StoreError> {
        self.look(|connection| read::run(connection, run))
    }

    /// Progress of a run, without its readings.
    pub fn progress(&self, run: RunId) -> Result<Progress, StoreError> {
        self.look(|connection| read::progress(connection, run))
    }

    pub(super) fn look<T>(
        &self,
        read: impl FnOnce(&mut Connection) -> Result<T, Fault>,
    ) -> Result<T, StoreError> {
        connection::open_reader(&self.path)
            .and_then(|mut connection| read(&mut connection))
            .map_err(StoreError::at(&self.path))
    }

    pub(super) fn submit<T: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Connection) -> Result<T, Fault> + Send + 'static,
    ) -> Pending<T> {
        let (answer, pending) = oneshot::channel();
        let job: Job = Box::new(move |connection| drop(answer.send(job(connection))));
        // A refused job drops its sender; the caller gets `WriterGone`.
        if let Some(jobs) = &self.jobs {
            let _ = jobs.send(job);
        }
        Pending { path: self.path.clone(), answer: pending }
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        drop(self.jobs.take());
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }
}

fn work(mut connection: Connection, inbox: &mpsc::Receiver<Job>, wrote: impl Fn(Duration)) {
    while let Ok(job) = inbox.recv() {
        let began = Instant::now();
        job(&mut connection);
        wrote(began.elapsed());
    }
}
