//! The thread that owns a socket of the kernel's: whatever computes elsewhere, frames are taken.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use socketcan::{
    CanFilter, CanFrame, CanSocket, EmbeddedFrame, ExtendedId, ShouldRetry, Socket, SocketOptions,
    StandardId,
};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use super::interfaces;
use super::stamp::Stamps;
use super::{CanError, Frame, Heard, Id, WAITING_FRAMES};
use crate::base::Clock;

/// How often it looks whether its handle is gone, or its interface back.
const PAUSE: Duration = Duration::from_millis(100);
/// What the kernel may keep while this thread does not run, bytes; it grants less if it wants.
const KEPT_BY_KERNEL: usize = 1 << 20;
/// Flags and bits of an identifier's word, as in the kernel's `can.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const STANDARD_BITS: u32 = 0x7FF;
const EXTENDED_BITS: u32 = 0x1FFF_FFFF;

/// Open it, and start the thread.
pub(super) fn start(
    interface: &str,
    id: Id,
    clock: Arc<dyn Clock>,
) -> Result<mpsc::Receiver<Heard>, CanError> {
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

/// A socket on `interface`, which may be down.
pub(super) fn socket(interface: &str) -> Result<CanSocket, CanError> {
    // On no interface in particular: fails if the kernel has no CAN at all.
    CanSocket::open_iface(0).map_err(|source| CanError::NoKernel { source })?;
    CanSocket::open(interface).map_err(|source| CanError::of_opening(interface, source))
}

fn listening(interface: &str, id: Id) -> Result<CanSocket, CanError> {
    let socket = socket(interface)?;
    let set = || {
        let (flag, bits) =
            if id.is_extended() { (EXTENDED, EXTENDED_BITS) } else { (0, STANDARD_BITS) };
        socket.set_filters(&[CanFilter::new(id.raw() | flag, bits | EXTENDED | REMOTE)])?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        socket.set_read_timeout(PAUSE)?;
        socket.as_raw_socket().set_recv_buffer_size(KEPT_BY_KERNEL)
    };
    match set() {
        Ok(()) => Ok(socket),
        Err(source) => Err(CanError::Open { interface: interface.to_owned(), source }),
    }
}

pub(super) fn id_of(id: Id) -> socketcan::Id {
    // Both are in range: `Id` was made so.
    let extended = || ExtendedId::new(id.raw()).unwrap_or(ExtendedId::ZERO).into();
    let standard = |raw| StandardId::new(raw).unwrap_or(StandardId::ZERO).into();
    match u16::try_from(id.raw()) {
        Ok(raw) if !id.is_extended() => standard(raw),
        _ => extended(),
    }
}

struct Owner {
    interface: String,
    id: Id,
    stamps: Stamps,
    heard: mpsc::Sender<Heard>,
    /// Frames since the last one that had room.
    lost: u32,
}

impl Owner {
    fn run(&mut self, mut socket: CanSocket) {
        loop {
            let why = match self.listen(&socket) {
                Some(why) => why,
                None => return,
            };
            self.turn(Heard::Down(why.to_string()));
            drop(socket);
            socket = match self.again() {
                Some(socket) => socket,
                None => return,
            };
            self.turn(Heard::Up);
        }
    }

    /// Until the interface fails, or the handle is gone (`None`).
    fn listen(&mut self, socket: &CanSocket) -> Option<io::Error> {
        while !self.heard.is_closed() {
            match socket.read_frame_with_timestamps() {
                Ok((CanFrame::Data(frame), stamps)) => {
                    let t_s = self.stamps.time_s(stamps.socket);
                    // The filter was set a moment after the socket was there.
                    if frame.id() == id_of(self.id) {
                        self.pass_on(Frame::new(t_s, self.id, frame.data()));
                    }
                }
                Ok((CanFrame::Error(frame), _)) => {
                    self.tell(Heard::Trouble(frame.into_error().to_string()));
                }
                Ok((CanFrame::Remote(_), _)) => {}
                Err(error) if error.should_retry() => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Some(error),
            }
        }
        None
    }

    /// Once the interface is up again; `None`: the handle is gone.
    fn again(&self) -> Option<CanSocket> {
        while !self.heard.is_closed() {
            if interfaces::is_up(&self.interface)
                && let Ok(socket) = listening(&self.interface, self.id)
            {
                return Some(socket);
            }
            std::thread::sleep(PAUSE);
        }
        None
    }

    /// What no reader takes is counted, not kept.
    fn pass_on(&mut self, frame: Frame) {
        if self.lost > 0 && self.heard.try_send(Heard::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        let full = |error| matches!(error, TrySendError::Full(_));
        if self.lost > 0 || self.heard.try_send(Heard::Frame(frame)).is_err_and(full) {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// The interface's own state is told whatever happens, behind the frames that came before it:
    /// no frame comes meanwhile that could be missed.
    fn turn(&mut self, heard: Heard) {
        if self.lost > 0 && self.heard.blocking_send(Heard::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        // Nobody is there any more: `run` sees it.
        let _ = self.heard.blocking_send(heard);
    }

    /// What is neither frame nor state may be told too late, but not instead of a frame.
    fn tell(&self, heard: Heard) {
        if self.heard.capacity() > WAITING_FRAMES / 2 {
            let _ = self.heard.try_send(heard);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::clock::HostClock;

    /// A reader that looks elsewhere for so long that its queue is full still learns of it.
    #[test]
    fn an_interface_that_goes_down_is_told_behind_a_full_queue() {
        let (heard, mut receiver) = mpsc::channel(WAITING_FRAMES);
        let id = Id::new(0x181, false).unwrap();
        let stamps = Stamps::new(Arc::new(HostClock::start()));
        let mut owner = Owner { interface: "can0".to_owned(), id, stamps, heard, lost: 0 };
        for _ in 0..WAITING_FRAMES + 3 {
            owner.pass_on(Frame::new(0.0, id, &[1]));
        }
        let told = std::thread::spawn(move || {
            owner.turn(Heard::Down("off".to_owned()));
            owner.turn(Heard::Up);
        });
        let frames = (0..WAITING_FRAMES).map(|_| receiver.blocking_recv());
        assert!(frames.into_iter().all(|heard| matches!(heard, Some(Heard::Frame(_)))));
        let rest: Vec<Heard> = std::iter::from_fn(|| receiver.blocking_recv()).collect();
        assert_eq!(rest, [Heard::Lost(3), Heard::Down("off".to_owned()), Heard::Up]);
        told.join().unwrap();
    }
}
