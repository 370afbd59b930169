//! Tests against tokio-modbus's own server; the independent peer is in `tests/interop/pymodbus/`.

use std::future;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio_modbus::server::{Service, tcp};
use tokio_modbus::{ExceptionCode, Request, Response};

use super::*;
use crate::{CaptureReplay, CaptureWriter, HostPort, LinkConfig, LinkMode};

/// Holding registers 0 to 99; input registers 0 to 9 hold 1000 and more.
#[derive(Clone, Default)]
struct TestDevice(Arc<Mutex<Vec<u16>>>);

impl Service for TestDevice {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        let mut words = self.0.lock().unwrap();
        words.resize(100, 0);
        let of = |address: u16, count: u16| {
            let first = usize::from(address);
            first..first + usize::from(count)
        };
        future::ready(match request {
            Request::ReadHoldingRegisters(address, count) => words
                .get(of(address, count))
                .map(|words| Response::ReadHoldingRegisters(words.to_vec()))
                .ok_or(ExceptionCode::IllegalDataAddress),
            Request::ReadInputRegisters(address, count) => {
                Ok(Response::ReadInputRegisters((1000 + address..1000 + address + count).collect()))
            }
            Request::WriteMultipleRegisters(address, new) => {
                let count = new.len() as u16;
                words[of(address, count)].copy_from_slice(&new);
                // The device clears register 50 itself.
                words[50] = 0;
                Ok(Response::WriteMultipleRegisters(address, count))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

async fn start_device_and_client() -> (TestDevice, ModbusClient) {
    let (device, line, settings) = start_device().await;
    let link = ModbusClient::open(line, settings).await.unwrap();
    (device, link)
}

async fn start_device() -> (TestDevice, ModbusLineConfig, DeviceSettings) {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let device = TestDevice::default();
    let shared = device.clone();
    tokio::spawn(async move {
        let server = tcp::Server::new(listener);
        let connected = |stream, at| {
            let device = shared.clone();
            async move { tcp::accept_tcp_connection(stream, at, |_| Ok(Some(device.clone()))) }
        };
        let _ = server.serve(&connected, |_| ()).await;
    });
    let allowed = AccessList {
        readable: vec![
            RegisterRange { space: RegisterSpace::Input, first: 0, last: 9 },
            RegisterRange { space: RegisterSpace::Holding, first: 0, last: 199 },
        ],
        writable: vec![RegisterRange { space: RegisterSpace::Holding, first: 10, last: 60 }],
    };
    let settings = DeviceSettings { unit: 1, timeout: Duration::from_secs(1), access_list: allowed };
    (device, ModbusLineConfig::with_defaults(LinkConfig::Tcp(HostPort::local(port))), settings)
}

#[tokio::test]
async fn registers_are_read_and_written_and_read_back() {
    let (device, link) = start_device_and_client().await;
    assert_eq!(link.read(RegisterSpace::Input, 2, 3).await.unwrap(), [1002, 1003, 1004]);
    link.write(20, &[7, 8, 9]).await.unwrap();
    assert_eq!(device.0.lock().unwrap()[19..24], [0, 7, 8, 9, 0]);
    let cleared = link.write(50, &[1]).await.unwrap_err();
    assert!(matches!(cleared, ModbusError::ReadBackDiffers { .. }), "{cleared}");
    link.write_without_read_back(50, &[1]).await.unwrap();
}

#[tokio::test]
async fn exception_is_reported_and_the_connection_stays() {
    let (_device, link) = start_device_and_client().await;
    let refused = link.read(RegisterSpace::Holding, 98, 4).await.unwrap_err();
    assert_eq!(
        refused.to_string(),
        "reading holding registers 98 to 101: the device refuses function 3 with exception 2 \
         (illegal data address)"
    );
    assert_eq!(link.read(RegisterSpace::Holding, 98, 2).await.unwrap(), [0, 0]);
}

#[tokio::test]
async fn request_outside_the_access_list_is_not_sent() {
    let (device, link) = start_device_and_client().await;
    let refused = |result: Result<(), ModbusError>| {
        assert!(matches!(result, Err(ModbusError::NotAllowed { .. })), "{result:?}");
    };
    refused(link.write(9, &[1, 1]).await);
    refused(link.write(60, &[1, 1]).await);
    refused(link.write(20, &[]).await);
    refused(link.write(10, &[0; 124]).await);
    refused(link.prepare_urgent_write(61, &[1]).map(drop));
    refused(link.read(RegisterSpace::Input, 9, 2).await.map(drop));
    refused(link.read(RegisterSpace::Coil, 0, 1).await.map(drop));
    refused(link.read(RegisterSpace::Holding, 0, 126).await.map(drop));
    assert!(device.0.lock().unwrap().is_empty());
}

#[tokio::test]
async fn after_a_hold_an_ordinary_write_is_refused() {
    let (device, link) = start_device_and_client().await;
    let hold = link.prepare_urgent_write(30, &[1]).unwrap();
    hold.send_and_refuse_ordinary_writes();
    let refused = link.write(31, &[1]).await.unwrap_err();
    assert!(matches!(refused, ModbusError::HoldActive { .. }), "{refused}");
    assert_eq!(link.read(RegisterSpace::Holding, 30, 2).await.unwrap(), [1, 0]);
    drop(link);
    hold.send_and_refuse_ordinary_writes();
    drop(device);
}

#[tokio::test]
async fn a_hold_is_sent_although_the_handle_is_dropped() {
    let (device, link) = start_device_and_client().await;
    link.prepare_urgent_write(30, &[1]).unwrap().send_and_refuse_ordinary_writes();
    drop(link);
    for _ in 0..500 {
        if device.0.lock().unwrap().get(30) == Some(&1) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("no hold");
}

/// Sends commands, with reads between them: `times` more than needed.
async fn write_commands_with_repeated_reads(link: &ModbusClient, times: usize) -> Result<Vec<Vec<u16>>, ModbusError> {
    let mut read = Vec::new();
    for command in [7, 8, 9] {
        link.write(20, &[command, command]).await?;
        for _ in 0..times {
            read.push(link.read(RegisterSpace::Holding, 19, 4).await?);
        }
        // A heartbeat.
        for beat in 0..times as u16 {
            link.write_without_read_back(40, &[beat]).await?;
        }
    }
    read.dedup();
    Ok(read)
}

#[tokio::test]
async fn capture_is_replayed_without_the_device() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.capture");
    let (device, line, settings) = start_device().await;
    let capture = CaptureWriter::create(&file).unwrap();
    let opening = ModbusClient::open(line.clone(), settings.clone());
    let link = LinkMode::Captured(capture).apply_to(opening).await.unwrap();
    let had = write_commands_with_repeated_reads(&link, 2).await.unwrap();
    assert_eq!(had, [[0, 7, 7, 0], [0, 8, 8, 0], [0, 9, 9, 0]]);
    drop((link, device));
    for times in 1..4 {
        let replay = LinkMode::Replayed(CaptureReplay::read(&file).unwrap());
        let nowhere = ModbusLineConfig { link: LinkConfig::Tcp(HostPort::local(1)), ..line.clone() };
        let opening = ModbusClient::open(nowhere, settings.clone());
        let link = replay.apply_to(opening).await.unwrap();
        assert_eq!(write_commands_with_repeated_reads(&link, times).await.unwrap(), had);
        let unknown = link.write(20, &[10, 10]).await.unwrap_err().to_string();
        assert!(unknown.contains("the capture has no `unit 1, function 16, address 20"), "{unknown}");
    }
}
