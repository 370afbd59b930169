//! Ctrl-C, SIGTERM and SIGHUP hold the machine; the run then ends by itself, and all its data is kept.

use std::io;
use std::sync::mpsc::{Sender, channel};

use tokio::signal::unix::{SignalKind, signal};

use super::failure::CommandFailure;
use devices::controllers::HaltHandle;

/// Starts a thread that holds the machine when a signal arrives. Signals are received from the return of this call
/// on. The thread is separate, so that a stop does not wait for a computation of the run.
pub fn start_signal_halt_thread(halt: HaltHandle) -> Result<(), CommandFailure> {
    let (ready, is_ready) = channel();
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || run_signal_thread(&halt, &ready))
        .map_err(CommandFailure::without_remedy)?;
    let listening = is_ready.recv().unwrap_or_else(|_| Err(io::ErrorKind::BrokenPipe.into()));
    listening
        .map_err(|error| CommandFailure::without_remedy(format!("the signal handler could not be started: {error}")))
}

/// Body of the signal thread; sends on `ready` once the signals are received, or the error.
fn run_signal_thread(halt: &HaltHandle, ready: &Sender<io::Result<()>>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let ended = runtime.and_then(|runtime| runtime.block_on(halt_on_signals(halt, ready)));
    // The error was reported already, or no receiver is left.
    let _ = ended.map_err(|error| ready.send(Err(error)));
}

async fn halt_on_signals(halt: &HaltHandle, ready: &Sender<io::Result<()>>) -> io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    // Sent when the terminal is closed.
    let mut hang_up = signal(SignalKind::hangup())?;
    let _ = ready.send(Ok(()));
    // `recv` is cancel safe: no signal is lost.
    while let Some(()) = tokio::select! {
        received = interrupt.recv() => received,
        received = terminate.recv() => received,
        received = hang_up.recv() => received,
    } {
        halt.trigger();
    }
    Ok(())
}
