//! The kernel's CAN socket: its filters, and the conversion of identifiers.

use std::io;
use std::time::Duration;

use socketcan::{
    CanFilter, CanSocket, EmbeddedFrame, ExtendedId, Socket, SocketOptions, StandardId,
};

use super::{CanError, Id};

/// Interval at which the thread checks whether the handle is dropped, or whether the interface is up again.
pub(super) const SOCKET_READ_TIMEOUT: Duration = Duration::from_millis(100);
/// Requested size of the kernel's receive buffer, bytes; the kernel may grant less.
const KEPT_BY_KERNEL: usize = 1 << 20;
/// Flags and masks of the identifier word, from the kernel's `can.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const STANDARD_BITS: u32 = 0x7FF;
const EXTENDED_BITS: u32 = 0x1FFF_FFFF;

/// Opens a socket on `interface`, which may be down.
pub(super) fn socket(interface: &str) -> Result<CanSocket, CanError> {
    // An unbound socket: fails if the kernel has no CAN at all.
    CanSocket::open_iface(0).map_err(|source| CanError::NoKernel { source })?;
    CanSocket::open(interface).map_err(|source| CanError::of_opening(interface, source))
}

/// Opens a socket that receives `id` and error frames.
pub(super) fn listening(interface: &str, id: Id) -> Result<CanSocket, CanError> {
    let socket = socket(interface)?;
    let set = || {
        only(&socket, id)?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        socket.set_read_timeout(SOCKET_READ_TIMEOUT)?;
        socket.as_raw_socket().set_recv_buffer_size(KEPT_BY_KERNEL)
    };
    match set() {
        Ok(()) => Ok(socket),
        Err(source) => Err(CanError::Open { interface: interface.to_owned(), source }),
    }
}

/// Limits the socket to data frames of `id`. The change loses no frame: the kernel adds the new filter before it
/// removes the old one.
pub(super) fn only(socket: &CanSocket, id: Id) -> io::Result<()> {
    let (flag, bits) =
        if id.is_extended() { (EXTENDED, EXTENDED_BITS) } else { (0, STANDARD_BITS) };
    socket.set_filters(&[CanFilter::new(id.raw() | flag, bits | EXTENDED | REMOTE)])
}

/// Lets the socket receive frames of all identifiers.
pub(super) fn all(socket: &CanSocket) -> io::Result<()> {
    socket.set_filter_accept_all()
}

/// Identifier of `frame`.
pub(super) fn id_of(frame: &impl EmbeddedFrame) -> Option<Id> {
    match frame.id() {
        socketcan::Id::Standard(id) => Id::new(id.as_raw().into(), false).ok(),
        socketcan::Id::Extended(id) => Id::new(id.as_raw(), true).ok(),
    }
}

pub(super) fn in_kernels_words(id: Id) -> socketcan::Id {
    // Both are in range: `Id::new` checks it.
    let extended = || ExtendedId::new(id.raw()).unwrap_or(ExtendedId::ZERO).into();
    let standard = |raw| StandardId::new(raw).unwrap_or(StandardId::ZERO).into();
    match u16::try_from(id.raw()) {
        Ok(raw) if !id.is_extended() => standard(raw),
        _ => extended(),
    }
}
