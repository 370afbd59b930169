//! Exchange through the window: one line is accepted and executed; the status is polled meanwhile.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use super::fault::{check_idle_or_running, is_transient, refusal_error, reset_error, unexpected_sequence_error};
use super::map::WindowRegisterMap;
use super::status::{WindowState, WindowStatus};
use super::timeouts::{HeartbeatMonitor, ModbusTimeouts};
use crate::controllers::stall_detector::StallDetector;
use crate::controllers::{ControllerError, HaltHandle};
use link::modbus::number_format::RegisterValueError;
use link::modbus::{ModbusClient, ModbusDeviceConfig, ModbusError, UrgentWriteSender};
use machine::Position;

/// Interval of trued's own heartbeat while nothing else is written.
const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(500);

/// A chunk whose execution was started.
pub(super) struct RunningChunk {
    /// Text that identifies the chunk in errors: the line, or the program and its step.
    error_label: String,
    pub(super) sequence: u16,
    /// Time for which the machine may be at rest while it executes the chunk.
    planned_standstill_time: Duration,
    /// Time at which the sequence number was written; the reply timeout begins here.
    started_at: Instant,
    stall_detector: StallDetector<(WindowState, Position)>,
    /// Delay before the next read of the status; `None` before the first read for this chunk.
    next_poll_delay: Option<Duration>,
}

impl RunningChunk {
    /// Waits before the next read of the status. The delay grows with each read, up to `max_delay`. The second read
    /// follows at once: a line that takes no time, such as a modal word, is complete by then.
    async fn wait_before_poll(&mut self, max_delay: Duration) {
        let delay = self.next_poll_delay.unwrap_or_default();
        if !delay.is_zero() {
            sleep(delay).await;
        }
        self.next_poll_delay = Some(match self.next_poll_delay {
            None => Duration::ZERO,
            Some(delay) => (delay * 2).max(Duration::from_millis(1)).min(max_delay),
        });
    }
}

/// Modbus connection to the window of one control, with the state of the exchange.
pub(super) struct WindowConnection {
    pub(super) link: Arc<ModbusClient>,
    pub(super) map: WindowRegisterMap,
    /// Writes `hold` before all pending requests; afterwards no other write is accepted.
    hold_sender: UrgentWriteSender,
    halt: HaltHandle,
    /// Value of the last heartbeat of `trued`.
    pub(super) own_heartbeat: Arc<AtomicU16>,
    /// Task that writes the heartbeat; [`WindowConnection::exchange_first_heartbeats`] starts it.
    heartbeat_task: OnceLock<JoinHandle<()>>,
    /// Sequence number of the last chunk that the control has checked, accepted or refused.
    pub(super) checked_sequence: u16,
    /// Whether this driver sent the chunk of `checked_sequence`. The outcome of a chunk from another client or run does
    /// not matter.
    pub(super) is_checked_chunk_own: bool,
    /// Number of the last result that was read from a resident program; `None` without a resident program.
    pub(super) last_result_number: Option<u16>,
    /// Step whose positioning move is running, at rapid or at feed: the stylus should touch nothing.
    pub(super) positioning_step: Option<u32>,
    pub(super) timeouts: ModbusTimeouts,
    heartbeat_monitor: HeartbeatMonitor,
}

impl Drop for WindowConnection {
    /// Stops the heartbeat of trued: the control then stops all motion.
    fn drop(&mut self) {
        if let Some(heartbeat_task) = self.heartbeat_task.get() {
            heartbeat_task.abort();
        }
    }
}

/// Sequence number after `sequence`. It is never 0, which means that no chunk was checked.
pub(super) fn sequence_after(sequence: u16) -> u16 {
    sequence.checked_add(1).unwrap_or(1)
}

/// Error if the configured format of a command register cannot hold a value.
pub(super) fn encoding_error(error: RegisterValueError) -> ControllerError {
    ControllerError::UnsupportedByControl {
        reason: error.to_string(),
        remedy: "compare [controller.registers.command] with docs/line-window.md".to_owned(),
    }
}

impl WindowConnection {
    /// Opens the Modbus line to the control. The returned handle writes `hold`; after that nothing is written.
    pub(super) async fn open(
        device: &ModbusDeviceConfig,
        map: WindowRegisterMap,
    ) -> Result<(Self, HaltHandle), ControllerError> {
        let settings = device.settings(map.access_ranges());
        let (at, words) = map.command.hold.encode_value(1).map_err(encoding_error)?;
        let link = Arc::new(ModbusClient::open(device.line.clone(), settings).await?);
        let hold_sender = link.prepare_urgent_write(at, &words)?;
        let urgent = hold_sender.clone();
        let halt = HaltHandle::new(move || urgent.send_and_refuse_ordinary_writes());
        let window = Self {
            link,
            map,
            hold_sender,
            halt: halt.clone(),
            own_heartbeat: Arc::default(),
            heartbeat_task: OnceLock::new(),
            checked_sequence: 0,
            is_checked_chunk_own: false,
            last_result_number: None,
            positioning_step: None,
            timeouts: ModbusTimeouts::default(),
            heartbeat_monitor: HeartbeatMonitor::default(),
        };
        Ok((window, halt))
    }

    pub(super) fn is_halt_requested(&self) -> bool {
        self.halt.is_halt_requested()
    }

    /// Holds the machine after a fault, whatever it is executing. Afterwards ordinary writes on the line are refused;
    /// reads and further writes of `hold` continue.
    pub(super) fn send_hold(&self) {
        self.hold_sender.send_and_refuse_ordinary_writes();
    }

    /// Reads the control's present status: consistent, though perhaps older than the last chunk.
    pub(super) async fn read_status(&self) -> Result<WindowStatus, ControllerError> {
        let deadline = Instant::now() + self.timeouts.reply_timeout;
        let (first, count) = self.map.status.block_first_and_count();
        let mut retry_delay = Duration::from_millis(1);
        loop {
            let error = match self.link.read(self.map.status.space, first, count).await {
                Ok(block) => match WindowStatus::parse(&self.map, &block)? {
                    Some(status) => return Ok(status),
                    None => {
                        ControllerError::UnreadableReply { text: "a status that changed during the read".to_owned() }
                    }
                },
                Err(error) if is_transient(&error) => error.into(),
                Err(error) => return Err(error.into()),
            };
            if Instant::now() > deadline {
                return Err(error);
            }
            sleep(retry_delay).await;
            retry_delay = (retry_delay * 2).min(self.timeouts.poll_interval);
        }
    }

    /// Waits until the machine is at rest and all chunks are complete; an error after the reply timeout, or if a halt
    /// was requested.
    pub(super) async fn wait_idle_and_chunks_complete(&mut self) -> Result<WindowStatus, ControllerError> {
        let deadline = Instant::now() + self.timeouts.reply_timeout;
        loop {
            let status = self.read_status().await?;
            if self.halt.is_halt_requested() {
                return Err(self.resend_hold_until_at_rest().await);
            }
            check_idle_or_running(&status)?;
            self.heartbeat_monitor.check_heartbeat(status.heartbeat, &self.timeouts)?;
            let over = !self.is_checked_chunk_own || status.executed_sequence == self.checked_sequence;
            let done = status.checked_sequence == self.checked_sequence && over;
            if done && status.state == WindowState::Idle {
                return Ok(status);
            }
            if Instant::now() > deadline {
                return Err(match status.checked_sequence {
                    0 if self.checked_sequence != 0 => reset_error(),
                    _ => unexpected_sequence_error(&status, self.checked_sequence),
                });
            }
            sleep(self.timeouts.poll_interval).await;
        }
    }

    /// Sequence number that the control will accept next.
    pub(super) fn next_sequence(&self) -> u16 {
        sequence_after(self.checked_sequence)
    }

    /// Executes `line`; returns the status at its end. `planned_standstill_time` is the time for which the machine
    /// may be at rest meanwhile.
    ///
    /// # Errors
    /// A refusal, an alarm, a hold, a reset, silence; `Halted` once a halt was requested.
    pub(super) async fn execute_line(
        &mut self,
        line: &str,
        planned_standstill_time: Duration,
    ) -> Result<WindowStatus, ControllerError> {
        let mut running = self.start_chunk(line.as_bytes(), line, planned_standstill_time).await?;
        loop {
            if let (status, true) = self.poll_chunk(&mut running).await? {
                return Ok(status);
            }
        }
    }

    /// Writes `chunk` and starts it; `name` identifies it in errors.
    pub(super) async fn start_chunk(
        &mut self,
        chunk: &[u8],
        name: &str,
        planned_standstill_time: Duration,
    ) -> Result<RunningChunk, ControllerError> {
        if self.halt.is_halt_requested() {
            return Err(ControllerError::Halted);
        }
        let sequence = self.next_sequence();
        let sent = match self.write_chunk(chunk).await {
            Ok(()) => self.write_sequence(sequence).await,
            Err(error) => Err(error),
        };
        match sent {
            Ok(()) => Ok(RunningChunk {
                error_label: name.to_owned(),
                sequence,
                planned_standstill_time,
                started_at: Instant::now(),
                stall_detector: StallDetector::new(),
                next_poll_delay: None,
            }),
            Err(_) if self.halt.is_halt_requested() => Err(self.resend_hold_until_at_rest().await),
            Err(error) => Err(error),
        }
    }

    /// Reads the status once; the flag is whether the whole chunk is complete and the machine at rest.
    pub(super) async fn poll_chunk(
        &mut self,
        running: &mut RunningChunk,
    ) -> Result<(WindowStatus, bool), ControllerError> {
        running.wait_before_poll(self.timeouts.poll_interval).await;
        let status = self.read_status().await?;
        if self.halt.is_halt_requested() {
            return Err(self.resend_hold_until_at_rest().await);
        }
        let (name, sequence) = (&running.error_label, running.sequence);
        if status.checked_sequence == sequence {
            (self.checked_sequence, self.is_checked_chunk_own) = (sequence, true);
            if status.refusal_code != 0 {
                return Err(refusal_error(name, status.refusal_code));
            }
        }
        check_idle_or_running(&status)?;
        self.heartbeat_monitor.check_heartbeat(status.heartbeat, &self.timeouts)?;
        if let Some(step) = self.positioning_step.filter(|_| status.is_probe_closed) {
            // The machine may still be moving, and does not stop by itself.
            self.send_hold();
            return Err(ControllerError::UnexpectedContact { step });
        }
        match status.checked_sequence {
            checked if checked == sequence => {
                if status.executed_sequence == sequence && status.state == WindowState::Idle {
                    return Ok((status, true));
                }
            }
            before if before == self.checked_sequence => {
                if running.started_at.elapsed() > self.timeouts.reply_timeout {
                    return Err(ControllerError::no_answer(name, self.timeouts.reply_timeout));
                }
            }
            0 => return Err(reset_error()),
            _ => return Err(unexpected_sequence_error(&status, sequence)),
        }
        let (state, limit) = ((status.state, status.position.clone()), self.timeouts.max_unchanged_time(status.state));
        running.stall_detector.check_not_stalled(state, limit, running.planned_standstill_time, name)?;
        Ok((status, false))
    }

    /// Waits, after a hold was sent, until the machine is at rest; then returns `Halted`, otherwise the error that
    /// prevents it. The hold may be lost: it is sent again until the status shows it; a surplus hold changes nothing.
    /// A control may stay idle on a hold: its machine is at rest if the control's program is running and has nothing
    /// left to execute.
    async fn resend_hold_until_at_rest(&self) -> ControllerError {
        let started = Instant::now();
        let (mut beats, mut last_beat_at) = (BTreeSet::new(), started);
        loop {
            let status = match self.read_status().await {
                Ok(status) => status,
                Err(error) => return error,
            };
            if beats.insert(status.heartbeat) {
                last_beat_at = Instant::now();
            }
            match status.state {
                WindowState::Idle if beats.len() > 2 && status.executed_sequence == status.checked_sequence => break,
                WindowState::Idle | WindowState::Running => self.send_hold(),
                _ => break,
            }
            if last_beat_at.elapsed() > self.timeouts.heartbeat_timeout {
                return ControllerError::ControlFrozen;
            }
            if started.elapsed() > self.timeouts.reply_timeout {
                return ControllerError::HoldFailed { seconds: self.timeouts.reply_timeout.as_secs_f64() };
            }
            sleep(self.timeouts.poll_interval).await;
        }
        ControllerError::Halted
    }

    /// Starts the heartbeat of `trued` and waits until the control's heartbeat changes; returns the status
    /// that shows it.
    pub(super) async fn exchange_first_heartbeats(&self) -> Result<WindowStatus, ControllerError> {
        let heart = || write_heartbeats(self.link.clone(), self.map.clone(), self.own_heartbeat.clone());
        self.heartbeat_task.get_or_init(|| tokio::spawn(heart()));
        let (at, words) =
            self.map.command.heartbeat.encode_value(next_heartbeat(&self.own_heartbeat)).map_err(encoding_error)?;
        match self.link.write_without_read_back(at, &words).await {
            Err(error) if !is_transient(&error) => return Err(error.into()),
            _ => {}
        }
        let first = self.read_status().await?;
        let deadline = Instant::now() + self.timeouts.heartbeat_timeout;
        loop {
            sleep(self.timeouts.poll_interval).await;
            let status = self.read_status().await?;
            if status.heartbeat != first.heartbeat {
                return Ok(status);
            }
            if Instant::now() > deadline {
                return Err(ControllerError::ControlFrozen);
            }
        }
    }
}

/// Increments `heartbeat` and returns the new value.
pub(super) fn next_heartbeat(heartbeat: &AtomicU16) -> u16 {
    heartbeat.fetch_add(1, Ordering::SeqCst).wrapping_add(1)
}

/// Writes heartbeats until the task is aborted, or a hold closes the link. A lost heartbeat is not repeated: the next
/// one follows.
async fn write_heartbeats(link: Arc<ModbusClient>, map: WindowRegisterMap, own_heartbeat: Arc<AtomicU16>) {
    loop {
        sleep(HEARTBEAT_INTERVAL).await;
        let Ok((at, words)) = map.command.heartbeat.encode_value(next_heartbeat(&own_heartbeat)) else { return };
        if let Err(ModbusError::HoldActive { .. } | ModbusError::LinkThreadEnded { .. }) =
            link.write_without_read_back(at, &words).await
        {
            return;
        }
    }
}
