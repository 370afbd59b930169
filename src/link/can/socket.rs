//! The kernel's CAN socket: its filters, and the conversion of identifiers.

use std::io;
use std::time::Duration;

use socketcan::{CanFilter, CanSocket, EmbeddedFrame, ExtendedId, Socket, SocketOptions, StandardId};

use super::{CanError, CanId};

/// Interval at which the thread checks whether the handle is dropped, or whether the interface is up again.
pub(super) const SOCKET_READ_TIMEOUT: Duration = Duration::from_millis(100);
/// Requested size of the kernel's receive buffer, bytes; the kernel may grant less.
const KERNEL_BUFFER_BYTES: usize = 1 << 20;
/// Flags and masks of the identifier word, from the kernel's `can.h`.
const EXTENDED_ID_FLAG: u32 = 0x8000_0000;
const REMOTE_FRAME_FLAG: u32 = 0x4000_0000;
const STANDARD_ID_MASK: u32 = 0x7FF;
const EXTENDED_ID_MASK: u32 = 0x1FFF_FFFF;

/// Opens a socket on `interface`, which may be down.
pub(super) fn socket(interface: &str) -> Result<CanSocket, CanError> {
    // An unbound socket: fails if the kernel has no CAN at all.
    CanSocket::open_iface(0).map_err(|source| CanError::NoKernelSupport { source })?;
    CanSocket::open(interface).map_err(|source| CanError::from_open_error(interface, source))
}

/// Opens a socket that receives `id` and error frames.
pub(super) fn open_filtered_socket(interface: &str, id: CanId) -> Result<CanSocket, CanError> {
    let socket = socket(interface)?;
    let configure = || {
        accept_own_id(&socket, id)?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        socket.set_read_timeout(SOCKET_READ_TIMEOUT)?;
        socket.as_raw_socket().set_recv_buffer_size(KERNEL_BUFFER_BYTES)
    };
    match configure() {
        Ok(()) => Ok(socket),
        Err(source) => Err(CanError::OpenFailed { interface: interface.to_owned(), source }),
    }
}

/// Limits the socket to data frames of `id`. The change loses no frame: the kernel adds the new filter before it
/// removes the old one.
pub(super) fn accept_own_id(socket: &CanSocket, id: CanId) -> io::Result<()> {
    let (flag, bits) = if id.is_extended() { (EXTENDED_ID_FLAG, EXTENDED_ID_MASK) } else { (0, STANDARD_ID_MASK) };
    socket.set_filters(&[CanFilter::new(id.raw() | flag, bits | EXTENDED_ID_FLAG | REMOTE_FRAME_FLAG)])
}

/// Lets the socket receive frames of all identifiers.
pub(super) fn accept_all_ids(socket: &CanSocket) -> io::Result<()> {
    socket.set_filter_accept_all()
}

/// Identifier of `frame`.
pub(super) fn frame_id(frame: &impl EmbeddedFrame) -> Option<CanId> {
    match frame.id() {
        socketcan::Id::Standard(id) => CanId::new(id.as_raw().into(), false).ok(),
        socketcan::Id::Extended(id) => CanId::new(id.as_raw(), true).ok(),
    }
}

pub(super) fn to_socketcan_id(id: CanId) -> socketcan::Id {
    // Both are in range: `CanId::new` checks it.
    let extended = || ExtendedId::new(id.raw()).unwrap_or(ExtendedId::ZERO).into();
    let standard = |raw| StandardId::new(raw).unwrap_or(StandardId::ZERO).into();
    match u16::try_from(id.raw()) {
        Ok(raw) if !id.is_extended() => standard(raw),
        _ => extended(),
    }
}
