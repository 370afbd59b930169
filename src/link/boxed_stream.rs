//! Byte stream of any kind of device: serial port, TCP connection, stream inside this process.

use std::pin::Pin;

use tokio::io::{AsyncRead, AsyncWrite};

pub(super) trait ByteStream: AsyncRead + AsyncWrite + Send {}
impl<S: AsyncRead + AsyncWrite + Send> ByteStream for S {}

pub(super) type BoxedStream = Pin<Box<dyn ByteStream>>;
