//! Thread that owns a CAN socket. It reads frames without delay, whatever other threads compute.

use std::io;
use std::sync::Arc;
use std::time::Instant;

use socketcan::{CanFrame, CanSocket, EmbeddedFrame, ShouldRetry, Socket};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use super::others::{ForeignIdDetector, IdFilterChange};
use super::socket::{self, SOCKET_READ_TIMEOUT, listening};
use super::stamp::Stamps;
use super::trouble::ErrorFrameClass;
use super::{CanError, CanEvent, Frame, Id, WAITING_FRAMES, interfaces};
use crate::Clock;

/// Opens the socket and starts the thread.
pub(super) fn start(
    interface: &str,
    id: Id,
    clock: Arc<dyn Clock>,
) -> Result<mpsc::Receiver<CanEvent>, CanError> {
    let socket = listening(interface, id)?;
    let (heard, receiver) = mpsc::channel(WAITING_FRAMES);
    let interface = interface.to_owned();
    let mut owner =
        Owner { interface: interface.clone(), id, stamps: Stamps::new(clock), heard, lost: 0 };
    std::thread::Builder::new()
        .name("can".to_owned())
        .spawn(move || owner.run(socket))
        .map_err(|source| CanError::Open { interface, source })?;
    Ok(receiver)
}

struct Owner {
    interface: String,
    id: Id,
    stamps: Stamps,
    heard: mpsc::Sender<CanEvent>,
    /// Frames lost since the last frame that fitted into the queue.
    lost: u32,
}

impl Owner {
    fn run(&mut self, mut socket: CanSocket) {
        loop {
            let why = match self.listen(&socket) {
                Some(why) => why,
                None => return,
            };
            self.turn(CanEvent::Down(why.to_string()));
            drop(socket);
            socket = match self.again() {
                Some(socket) => socket,
                None => return,
            };
            self.turn(CanEvent::Up);
        }
    }

    /// Reads until the interface fails, or until the handle is dropped (`None`).
    fn listen(&mut self, socket: &CanSocket) -> Option<io::Error> {
        let mut others = ForeignIdDetector::new(Instant::now());
        while !self.heard.is_closed() {
            let mut turn = others.passed(Instant::now());
            match socket.read_frame_with_timestamps() {
                Ok((CanFrame::Data(frame), stamps)) => {
                    let t_s = self.stamps.time_s(stamps.socket);
                    match socket::id_of(&frame) {
                        Some(id) if id == self.id => {
                            self.pass_on(Frame::new(t_s, id, frame.data()));
                            turn = others.own(Instant::now()).or(turn);
                        }
                        // Frames of other identifiers can arrive before the filter is set, a moment after the
                        // socket is opened.
                        Some(id) if others.is_news(id) => self.tell(CanEvent::Other(id)),
                        _ => {}
                    }
                }
                Ok((CanFrame::Error(frame), _)) => self.trouble(frame.into_error().into()),
                Ok((CanFrame::Remote(_), _)) => {}
                Err(error) if error.should_retry() => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Some(error),
            }
            let turned = match turn {
                Some(IdFilterChange::All) => socket::all(socket),
                Some(IdFilterChange::Own) => socket::only(socket, self.id),
                None => Ok(()),
            };
            if let Err(error) = turned {
                return Some(error);
            }
        }
        None
    }

    fn trouble(&mut self, trouble: ErrorFrameClass) {
        match trouble {
            ErrorFrameClass::Errors(why) => self.tell(CanEvent::ErrorFrameClass(why)),
            ErrorFrameClass::Off(why) => self.turn(CanEvent::Off(why)),
            // At least one frame is lost; the number is unknown.
            ErrorFrameClass::Missed => self.lost = self.lost.saturating_add(1),
            ErrorFrameClass::None => {}
        }
    }

    /// Waits until the interface is up again, and opens it; `None` if the handle is dropped.
    fn again(&self) -> Option<CanSocket> {
        while !self.heard.is_closed() {
            if interfaces::is_up(&self.interface)
                && let Ok(socket) = listening(&self.interface, self.id)
            {
                return Some(socket);
            }
            std::thread::sleep(SOCKET_READ_TIMEOUT);
        }
        None
    }

    /// Puts a frame into the queue; counts the frame as lost if the queue is full.
    fn pass_on(&mut self, frame: Frame) {
        if self.lost > 0 && self.heard.try_send(CanEvent::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        let full = |error| matches!(error, TrySendError::Full(_));
        if self.lost > 0 || self.heard.try_send(CanEvent::Frame(frame)).is_err_and(full) {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// Sends a change of state, and waits for room in the queue, behind the frames that arrived before. No frame
    /// can be missed meanwhile, because the interface delivers none.
    fn turn(&mut self, heard: CanEvent) {
        if self.lost > 0 && self.heard.blocking_send(CanEvent::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        // The receiver is dropped: `run` detects it.
        let _ = self.heard.blocking_send(heard);
    }

    /// Sends a report that is neither frame nor state. It may be dropped, but it must not displace a frame.
    fn tell(&self, heard: CanEvent) {
        if self.heard.capacity() > WAITING_FRAMES / 2 {
            let _ = self.heard.try_send(heard);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::HostClock;

    fn owner() -> (Owner, mpsc::Receiver<CanEvent>) {
        let (heard, receiver) = mpsc::channel(WAITING_FRAMES);
        let id = Id::new(0x181, false).unwrap();
        let stamps = Stamps::new(Arc::new(HostClock::start()));
        let interface = "can0".to_owned();
        (Owner { interface, id, stamps, heard, lost: 0 }, receiver)
    }

    /// A reader that lets its queue overflow still receives the change of state.
    #[test]
    fn an_interface_that_goes_down_is_told_behind_a_full_queue() {
        let (mut owner, mut receiver) = owner();
        let id = owner.id;
        for _ in 0..WAITING_FRAMES + 3 {
            owner.pass_on(Frame::new(0.0, id, &[1]));
        }
        let told = std::thread::spawn(move || {
            owner.turn(CanEvent::Down("off".to_owned()));
            owner.turn(CanEvent::Up);
        });
        let frames = (0..WAITING_FRAMES).map(|_| receiver.blocking_recv());
        assert!(frames.into_iter().all(|heard| matches!(heard, Some(CanEvent::Frame(_)))));
        let rest: Vec<CanEvent> = std::iter::from_fn(|| receiver.blocking_recv()).collect();
        assert_eq!(rest, [CanEvent::Lost(3), CanEvent::Down("off".to_owned()), CanEvent::Up]);
        told.join().unwrap();
    }

    /// A restarted controller has missed frames: the loss is reported before the next frame.
    #[test]
    fn a_restart_and_an_overflow_are_told_before_the_next_frame() {
        let (mut owner, mut receiver) = owner();
        owner.trouble(ErrorFrameClass::Errors("stuffed".to_owned()));
        owner.trouble(ErrorFrameClass::Off("bus off".to_owned()));
        owner.trouble(ErrorFrameClass::Missed);
        owner.trouble(ErrorFrameClass::None);
        let frame = Frame::new(0.0, owner.id, &[1]);
        owner.pass_on(frame);
        owner.pass_on(frame);
        drop(owner);
        let all: Vec<CanEvent> = std::iter::from_fn(|| receiver.blocking_recv()).collect();
        let (errors, off) =
            (CanEvent::ErrorFrameClass("stuffed".to_owned()), CanEvent::Off("bus off".to_owned()));
        assert_eq!(
            all,
            [errors, off, CanEvent::Lost(1), CanEvent::Frame(frame), CanEvent::Frame(frame)]
        );
    }
}
