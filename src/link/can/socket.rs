//! The kernel's socket: what it lets through, and identifiers in its words.

use std::io;
use std::time::Duration;

use socketcan::{
    CanFilter, CanSocket, EmbeddedFrame, ExtendedId, Socket, SocketOptions, StandardId,
};

use super::{CanError, Id};

/// How often its thread looks whether its handle is gone, or its interface back.
pub(super) const PAUSE: Duration = Duration::from_millis(100);
/// What the kernel may keep while the thread does not run, bytes; it grants less if it wants.
const KEPT_BY_KERNEL: usize = 1 << 20;
/// Flags and bits of an identifier's word, as in the kernel's `can.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const STANDARD_BITS: u32 = 0x7FF;
const EXTENDED_BITS: u32 = 0x1FFF_FFFF;

/// A socket on `interface`, which may be down.
pub(super) fn socket(interface: &str) -> Result<CanSocket, CanError> {
    // On no interface in particular: fails if the kernel has no CAN at all.
    CanSocket::open_iface(0).map_err(|source| CanError::NoKernel { source })?;
    CanSocket::open(interface).map_err(|source| CanError::of_opening(interface, source))
}

/// One that hears `id` and error frames.
pub(super) fn listening(interface: &str, id: Id) -> Result<CanSocket, CanError> {
    let socket = socket(interface)?;
    let set = || {
        only(&socket, id)?;
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

/// From now on data frames of `id` alone come. No frame is lost by the change: the kernel sets what is new
/// before it takes away what was.
pub(super) fn only(socket: &CanSocket, id: Id) -> io::Result<()> {
    let (flag, bits) =
        if id.is_extended() { (EXTENDED, EXTENDED_BITS) } else { (0, STANDARD_BITS) };
    socket.set_filters(&[CanFilter::new(id.raw() | flag, bits | EXTENDED | REMOTE)])
}

/// From now on frames of all identifiers come.
pub(super) fn all(socket: &CanSocket) -> io::Result<()> {
    socket.set_filter_accept_all()
}

/// Whose frame it is.
pub(super) fn id_of(frame: &impl EmbeddedFrame) -> Option<Id> {
    match frame.id() {
        socketcan::Id::Standard(id) => Id::new(id.as_raw().into(), false).ok(),
        socketcan::Id::Extended(id) => Id::new(id.as_raw(), true).ok(),
    }
}

pub(super) fn in_kernels_words(id: Id) -> socketcan::Id {
    // Both are in range: `Id` was made so.
    let extended = || ExtendedId::new(id.raw()).unwrap_or(ExtendedId::ZERO).into();
    let standard = |raw| StandardId::new(raw).unwrap_or(StandardId::ZERO).into();
    match u16::try_from(id.raw()) {
        Ok(raw) if !id.is_extended() => standard(raw),
        _ => extended(),
    }
}
