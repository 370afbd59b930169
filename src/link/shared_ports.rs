//! Ports that several devices share: a serial port, or a converter behind TCP, is opened once, and each device gets
//! its own handle.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use tokio::sync::Mutex;

use super::byte_stream::WeakByteStream;
use super::modbus::{DeviceSettings, Framing, ModbusClient, ModbusError, ModbusLine, WeakModbusClient};
use super::{Address, ByteStreamHandle, LinkError, open_byte_stream};

/// The open ports. A port is closed when its last handle is dropped; the next device that uses a lost port reopens
/// it.
#[derive(Clone, Default)]
pub struct SharedPorts(Arc<Mutex<OpenPorts>>);

#[derive(Default)]
struct OpenPorts {
    streams: BTreeMap<String, WeakByteStream>,
    modbus: BTreeMap<String, WeakModbusClient>,
}

impl SharedPorts {
    /// Returns a handle to the stream at `address`; opens the stream if it is not open.
    ///
    /// # Errors
    /// The stream cannot be opened.
    pub async fn open_byte_stream(&self, address: &Address) -> Result<ByteStreamHandle, LinkError> {
        let mut open = self.0.lock().await;
        let key = port_key(address);
        if let Some(flow) = open.streams.get(&key).and_then(WeakByteStream::upgrade) {
            return Ok(flow);
        }
        let flow = open_byte_stream(address).await?;
        open.streams.insert(key, flow.downgrade());
        Ok(flow)
    }

    /// Returns a handle to the device of `settings` on `line`. An RTU line is opened if it is not open; over Modbus
    /// TCP each device has its own connection.
    ///
    /// # Errors
    /// The line cannot be opened.
    pub async fn modbus(&self, line: ModbusLine, settings: DeviceSettings) -> Result<ModbusClient, ModbusError> {
        if line.framing == Framing::Tcp {
            return ModbusClient::open(line, settings).await;
        }
        let mut open = self.0.lock().await;
        let port = line.link.address().map_or_else(|_| line.to_string(), |at| port_key(&at));
        let key = format!("{port} {:?}", line.parity);
        if let Some(link) = open.modbus.get(&key).and_then(|weak| weak.upgrade(settings.clone())) {
            return Ok(link);
        }
        let link = ModbusClient::open(line, settings).await?;
        open.modbus.insert(key, link.downgrade());
        Ok(link)
    }
}

/// Key of a port, the same for all names of one port.
fn port_key(address: &Address) -> String {
    match address {
        Address::Serial { path, baud } => {
            let real = std::fs::canonicalize(Path::new(path)).unwrap_or_else(|_| path.into());
            format!("{} {baud}", real.display())
        }
        Address::Tcp { .. } => address.to_string(),
    }
}
