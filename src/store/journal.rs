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
use super::{StoreError, StoreFault, connection};

/// Job of the writer thread; it sends its own result.
type WriterJob = Box<dyn FnOnce(&mut Connection) + Send>;

/// The journal of one state directory. Dropping it first completes all submitted jobs.
pub struct Journal {
    path: PathBuf,
    /// `None` only while the journal is dropped.
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
    /// journal of an older version is kept beside it. A file is refused and not changed if it is no journal or has a
    /// newer format, or if its heads of runs or a table outside of the runs (such as the audit log) is damaged.
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        Self::open_with_job_callback(dir, |_| {})
    }

    /// The state directory.
    pub fn state_dir(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// As [`Self::open`]; `on_job_done` is called on the writer's thread with the duration of each job, without its
    /// wait in the queue.
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

    /// Calls `read` with a new read-only connection, which does not wait for the writer.
    pub(super) fn query<T>(
        &self,
        read: impl FnOnce(&mut Connection) -> Result<T, StoreFault>,
    ) -> Result<T, StoreError> {
        connection::open_reader(&self.path)
            .and_then(|mut connection| read(&mut connection))
            .map_err(StoreError::from_fault_at(&self.path))
    }

    /// Queues `job` for the writer thread. `job` begins and commits its own transaction.
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

/// Executes the jobs in their order until the sender is dropped.
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
