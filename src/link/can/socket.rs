//! The kernel's CAN socket: its filters, and the conversion of identifiers.

use std::io;
use std::time::Duration;

use socketcan::id::id_to_canid_t;
use socketcan::{CanFilter, CanSocket, ExtendedId, Id, Socket, SocketOptions, StandardId};

use super::{CanError, CanId};

/// Interval at which the thread checks whether the handle is dropped, or whether the interface is up again.
pub(super) const SOCKET_READ_TIMEOUT: Duration = Duration::from_millis(100);
/// Requested size of the kernel's receive buffer, bytes; the kernel may grant less.
const REQUESTED_RECEIVE_BUFFER_BYTES: usize = 1 << 20;
/// Flags of the identifier word, from the kernel's `can.h`.
const EXTENDED_ID_FLAG: u32 = 0x8000_0000;
const REMOTE_FRAME_FLAG: u32 = 0x4000_0000;

/// Opens a socket on `interface`, which may be down.
pub(super) fn open_socket(interface: &str) -> Result<CanSocket, CanError> {
    // An unbound socket: fails if the kernel has no CAN at all.
    CanSocket::open_iface(0).map_err(|source| CanError::NoKernelSupport { source })?;
    CanSocket::open(interface).map_err(|source| CanError::from_open_error(interface, source))
}

/// Opens a socket that receives `id` and error frames.
pub(super) fn open_filtered_socket(interface: &str, id: CanId) -> Result<CanSocket, CanError> {
    let socket = open_socket(interface)?;
    let configure = || {
        accept_only_own_id(&socket, id)?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        socket.set_read_timeout(SOCKET_READ_TIMEOUT)?;
        socket.as_raw_socket().set_recv_buffer_size(REQUESTED_RECEIVE_BUFFER_BYTES)
    };
    match configure() {
        Ok(()) => Ok(socket),
        Err(source) => Err(CanError::OpenFailed { interface: interface.to_owned(), source }),
    }
}

/// Limits the socket to data frames of `id`; error frames are still received. The change loses no frame: the kernel
/// adds the new filter before it removes the old one.
pub(super) fn accept_only_own_id(socket: &CanSocket, id: CanId) -> io::Result<()> {
    let mask = match id.0 {
        Id::Standard(_) => StandardId::MAX.as_raw().into(),
        Id::Extended(_) => ExtendedId::MAX.as_raw(),
    };
    socket.set_filters(&[CanFilter::new(id_to_canid_t(id.0), mask | EXTENDED_ID_FLAG | REMOTE_FRAME_FLAG)])
}

/// Lets the socket receive frames of all identifiers.
pub(super) fn accept_all_ids(socket: &CanSocket) -> io::Result<()> {
    socket.set_filter_accept_all()
}
