//! Thread that owns a CAN socket. It reads frames without delay, whatever other threads compute.

use std::io;
use std::sync::Arc;
use std::time::Instant;

use socketcan::{CanFrame as SocketFrame, CanSocket, EmbeddedFrame, ShouldRetry, Socket};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use super::error_frame::ErrorFrameEffect;
use super::foreign_ids::{ForeignIdDetector, IdFilterChange};
use super::socket::{self, SOCKET_READ_TIMEOUT, open_filtered_socket};
use super::timestamp_converter::TimestampConverter;
use super::{CanError, CanEvent, CanFrame, CanId, MAX_QUEUED_FRAMES, interfaces};
use crate::Clock;

/// Opens the socket and starts the thread.
pub(super) fn start_receiver_thread(
    interface: &str,
    id: CanId,
    clock: Arc<dyn Clock>,
) -> Result<mpsc::Receiver<CanEvent>, CanError> {
    let socket = open_filtered_socket(interface, id)?;
    let (events, receiver) = mpsc::channel(MAX_QUEUED_FRAMES);
    let interface = interface.to_owned();
    let mut owner = SocketOwner {
        interface: interface.clone(),
        id,
        timestamp_converter: TimestampConverter::new(clock),
        event_sender: events,
        unreported_lost_frames: 0,
    };
    std::thread::Builder::new()
        .name("can".to_owned())
        .spawn(move || owner.run(socket))
        .map_err(|source| CanError::OpenFailed { interface, source })?;
    Ok(receiver)
}

/// State of the thread that reads the frames of one interface.
struct SocketOwner {
    interface: String,
    /// The own identifier: only its frames are passed to the reader.
    id: CanId,
    timestamp_converter: TimestampConverter,
    event_sender: mpsc::Sender<CanEvent>,
    /// Frames lost since the last [`CanEvent::LostFrames`], a lower bound: each frame that found the queue full, and
    /// one for each error frame that reports lost frames.
    unreported_lost_frames: u32,
}

impl SocketOwner {
    /// Reads frames, and reopens the interface after each failure, until the handle is dropped.
    fn run(&mut self, mut socket: CanSocket) {
        loop {
            let Some(why) = self.read_frames_until_failure(&socket) else { return };
            self.send_state_change(CanEvent::InterfaceDown(why.to_string()));
            drop(socket);
            let Some(reopened) = self.reopen_when_up() else { return };
            socket = reopened;
            self.send_state_change(CanEvent::InterfaceUp);
        }
    }

    /// Reads until the interface fails, or until the handle is dropped (`None`).
    fn read_frames_until_failure(&mut self, socket: &CanSocket) -> Option<io::Error> {
        let mut detector = ForeignIdDetector::new(Instant::now());
        while !self.event_sender.is_closed() {
            let mut filter_change = detector.due_filter_change(Instant::now());
            match socket.read_frame_with_timestamps() {
                Ok((SocketFrame::Data(frame), timestamps)) => {
                    let t_s = self.timestamp_converter.monotonic_time_s(timestamps.socket);
                    match CanId(frame.id()) {
                        id if id == self.id => {
                            self.queue_frame(CanFrame::new(t_s, id, frame.data()));
                            filter_change = detector.record_own_frame(Instant::now()).or(filter_change);
                        }
                        // The filter is set only after the socket is opened: in between, frames of other identifiers
                        // can arrive.
                        id if detector.record_new_foreign_id(id) => self.send_report_if_room(CanEvent::ForeignId(id)),
                        _ => {}
                    }
                }
                Ok((SocketFrame::Error(frame), _)) => self.handle_error_frame(frame.into_error().into()),
                Ok((SocketFrame::Remote(_), _)) => {}
                Err(error) if error.should_retry() || error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Some(error),
            }
            let filter_result = match filter_change {
                Some(IdFilterChange::AllIds) => socket::accept_all_ids(socket),
                Some(IdFilterChange::OwnId) => socket::accept_only_own_id(socket, self.id),
                None => Ok(()),
            };
            if let Err(error) = filter_result {
                return Some(error);
            }
        }
        None
    }

    fn handle_error_frame(&mut self, class: ErrorFrameEffect) {
        match class {
            ErrorFrameEffect::BusErrors(why) => self.send_report_if_room(CanEvent::BusErrors(why)),
            ErrorFrameEffect::BusOff(why) => self.send_state_change(CanEvent::BusOff(why)),
            // At least one frame is lost; the number is unknown.
            ErrorFrameEffect::LostFrames => self.unreported_lost_frames = self.unreported_lost_frames.saturating_add(1),
            ErrorFrameEffect::Harmless => {}
        }
    }

    /// Waits until the interface is up again, and opens it; `None` if the handle is dropped.
    fn reopen_when_up(&self) -> Option<CanSocket> {
        while !self.event_sender.is_closed() {
            if interfaces::is_interface_up(&self.interface)
                && let Ok(socket) = open_filtered_socket(&self.interface, self.id)
            {
                return Some(socket);
            }
            std::thread::sleep(SOCKET_READ_TIMEOUT);
        }
        None
    }

    /// Reports frames lost before, then puts `frame` into the queue; without room for both, `frame` counts as lost.
    fn queue_frame(&mut self, frame: CanFrame) {
        if self.unreported_lost_frames > 0
            && self.event_sender.try_send(CanEvent::LostFrames(self.unreported_lost_frames)).is_ok()
        {
            self.unreported_lost_frames = 0;
        }
        let full = |error| matches!(error, TrySendError::Full(_));
        if self.unreported_lost_frames > 0 || self.event_sender.try_send(CanEvent::Frame(frame)).is_err_and(full) {
            self.unreported_lost_frames = self.unreported_lost_frames.saturating_add(1);
        }
    }

    /// Queues a change of state behind the frames that arrived before, and waits while the queue is full. No frame is
    /// missed meanwhile, because the interface delivers none.
    fn send_state_change(&mut self, event: CanEvent) {
        if self.unreported_lost_frames > 0
            && self.event_sender.blocking_send(CanEvent::LostFrames(self.unreported_lost_frames)).is_ok()
        {
            self.unreported_lost_frames = 0;
        }
        // A send error means that the receiver is dropped, which `run` detects.
        let _ = self.event_sender.blocking_send(event);
    }

    /// Sends a report (neither a frame nor a change of state) only while more than half of the queue is free;
    /// otherwise drops the report.
    fn send_report_if_room(&self, event: CanEvent) {
        if self.event_sender.capacity() > MAX_QUEUED_FRAMES / 2 {
            let _ = self.event_sender.try_send(event);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::HostClock;

    fn create_owner() -> (SocketOwner, mpsc::Receiver<CanEvent>) {
        let (events, receiver) = mpsc::channel(MAX_QUEUED_FRAMES);
        let id = CanId::new(0x181, false).unwrap();
        let timestamps = TimestampConverter::new(Arc::new(HostClock::start()));
        let interface = "can0".to_owned();
        (
            SocketOwner {
                interface,
                id,
                timestamp_converter: timestamps,
                event_sender: events,
                unreported_lost_frames: 0,
            },
            receiver,
        )
    }

    /// A reader that lets its queue overflow still receives the change of state.
    #[test]
    fn interface_down_is_reported_behind_a_full_queue() {
        let (mut owner, mut receiver) = create_owner();
        let id = owner.id;
        for _ in 0..MAX_QUEUED_FRAMES + 3 {
            owner.queue_frame(CanFrame::new(0.0, id, &[1]));
        }
        let sender = std::thread::spawn(move || {
            owner.send_state_change(CanEvent::InterfaceDown("off".to_owned()));
            owner.send_state_change(CanEvent::InterfaceUp);
        });
        let frames = (0..MAX_QUEUED_FRAMES).map(|_| receiver.blocking_recv());
        assert!(frames.into_iter().all(|events| matches!(events, Some(CanEvent::Frame(_)))));
        let rest: Vec<CanEvent> = std::iter::from_fn(|| receiver.blocking_recv()).collect();
        assert_eq!(rest, [CanEvent::LostFrames(3), CanEvent::InterfaceDown("off".to_owned()), CanEvent::InterfaceUp]);
        sender.join().unwrap();
    }

    /// A restarted controller has missed frames: the loss is reported before the next frame.
    #[test]
    fn bus_errors_and_lost_frames_are_reported_before_the_next_frame() {
        let (mut owner, mut receiver) = create_owner();
        owner.handle_error_frame(ErrorFrameEffect::BusErrors("stuffed".to_owned()));
        owner.handle_error_frame(ErrorFrameEffect::BusOff("bus off".to_owned()));
        owner.handle_error_frame(ErrorFrameEffect::LostFrames);
        owner.handle_error_frame(ErrorFrameEffect::Harmless);
        let frame = CanFrame::new(0.0, owner.id, &[1]);
        owner.queue_frame(frame);
        owner.queue_frame(frame);
        drop(owner);
        let all: Vec<CanEvent> = std::iter::from_fn(|| receiver.blocking_recv()).collect();
        let (errors, off) = (CanEvent::BusErrors("stuffed".to_owned()), CanEvent::BusOff("bus off".to_owned()));
        assert_eq!(all, [errors, off, CanEvent::LostFrames(1), CanEvent::Frame(frame), CanEvent::Frame(frame)]);
    }
}
