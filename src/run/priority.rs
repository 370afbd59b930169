//! Thread priorities on a small computer: the run first, then HTTP requests such as a hold, then long
//! computations.

use tokio::sync::oneshot;

/// Nice increment of long computations: proofs and identifications.
const COMPUTATION_NICE: i32 = 10;
/// Nice increment of threads that serve pages and other HTTP requests.
pub const HTTP_NICE: i32 = 5;

/// Lowers the priority of this thread by `nice_increment` (nice(2); on Linux it applies to the thread alone). The
/// priority stays the same where the system refuses.
pub fn lower_priority(nice_increment: i32) {
    let _ = rustix::process::nice(nice_increment);
}

/// Runs the computation on a thread of its own with a low priority. If the receiver is dropped, the thread ends
/// with the computation or with the program.
pub(super) fn spawn_computation<T: Send + 'static>(
    computation: impl FnOnce() -> T + Send + 'static,
) -> oneshot::Receiver<T> {
    let (answer, result) = oneshot::channel();
    std::thread::spawn(move || {
        lower_priority(COMPUTATION_NICE);
        drop(answer.send(computation()));
    });
    result
}

#[cfg(test)]
mod tests {
    use rustix::process::getpriority_process;

    use super::*;

    #[test]
    fn priority_of_other_threads_is_unchanged() {
        let before = getpriority_process(None).unwrap();
        let stepped = std::thread::spawn(|| {
            lower_priority(HTTP_NICE);
            getpriority_process(None).unwrap()
        });
        // 19 is the lowest priority.
        assert_eq!(stepped.join().unwrap(), (before + HTTP_NICE).min(19));
        assert_eq!(getpriority_process(None).unwrap(), before);
    }
}
