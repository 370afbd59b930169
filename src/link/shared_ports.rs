//! Ports that several devices share: a serial port, or a converter behind TCP, is opened once, and each device gets
//! its own handle.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Weak};

use tokio::sync::Mutex;

use super::byte_stream::SharedStream;
use super::modbus::{DeviceSettings, Framing, ModbusClient, ModbusError, ModbusLineConfig, OpenLine};
use super::{ByteStreamHandle, LinkAddress, LinkError, open_byte_stream};

/// The open ports. A port is closed when its last handle is dropped; the next device that uses a lost port reopens
/// it.
#[derive(Clone, Default)]
pub struct SharedPorts(Arc<Mutex<OpenPorts>>);

#[derive(Default)]
struct OpenPorts {
    /// By `port_key`.
    streams: BTreeMap<String, Weak<SharedStream>>,
    /// RTU lines only, by port and parity; Modbus TCP connections are not shared.
    modbus_lines: BTreeMap<String, Weak<OpenLine>>,
}

impl SharedPorts {
    /// Returns a handle to the stream at `address`; opens the stream if it is not open.
    ///
    /// # Errors
    /// The stream cannot be opened.
    pub async fn open_byte_stream(&self, address: &LinkAddress) -> Result<ByteStreamHandle, LinkError> {
        let mut open = self.0.lock().await;
        let key = port_key(address);
        let stream = open.streams.get(&key).and_then(Weak::upgrade);
        if let Some(handle) = stream.and_then(ByteStreamHandle::from_open_stream) {
            return Ok(handle);
        }
        let handle = open_byte_stream(address).await?;
        open.streams.insert(key, handle.weak_stream());
        Ok(handle)
    }

    /// Returns a handle to the device of `settings` on `line`. An RTU line is opened if it is not open; over Modbus
    /// TCP each device has its own connection.
    ///
    /// # Errors
    /// The line cannot be opened.
    pub async fn open_modbus_client(
        &self,
        line: ModbusLineConfig,
        settings: DeviceSettings,
    ) -> Result<ModbusClient, ModbusError> {
        if line.framing == Framing::Tcp {
            return ModbusClient::open(line, settings).await;
        }
        let mut open = self.0.lock().await;
        let port = line.link.resolve_address().map_or_else(|_| line.to_string(), |at| port_key(&at));
        let key = format!("{port} {:?}", line.parity);
        if let Some(line) = open.modbus_lines.get(&key).and_then(Weak::upgrade) {
            return Ok(ModbusClient::from_open_line(line, settings));
        }
        let client = ModbusClient::open(line, settings).await?;
        open.modbus_lines.insert(key, client.weak_line());
        Ok(client)
    }
}

/// Key of a port: the same for all names of one serial port with the same baud rate.
fn port_key(address: &LinkAddress) -> String {
    match address {
        LinkAddress::Serial { path, baud } => {
            let real = std::fs::canonicalize(Path::new(path)).unwrap_or_else(|_| path.into());
            format!("{} {baud}", real.display())
        }
        LinkAddress::Tcp { .. } => address.to_string(),
    }
}
