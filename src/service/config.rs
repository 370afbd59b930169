//! `[serve]` of the machine file: which cycles may be started from outside, and through which interfaces.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::key_range::check_key_range;
use super::schedule::entry::{self, ScheduleEntry};
use link::{HostPort, LinkConfig, LinkKeys};

/// Highest cycle number; the lowest is 1. The Modbus map has one start coil for each cycle.
pub const MAX_CYCLES: u16 = 8;

/// Condition of an external start. The machine reports it; if no report is fresh, a person who starts at the page
/// confirms it instead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartInterlock {
    /// The external start is enabled: by a key switch at the machine, or by a bit of its PLC.
    Enable,
    /// The control is in automatic mode.
    Auto,
    /// The guards are closed.
    Door,
}

/// A cycle that may be started from outside, `[[serve.cycle]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CycleConfig {
    /// Number by which the cycle is started, from 1.
    pub number: u16,
    pub method: String,
    /// Number of passes, as `--repeat`; `None`: as the settings of the method in the machine file state it.
    pub repeat: Option<u32>,
}

/// The daemon's own Modbus TCP server.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModbusServerConfig {
    /// Address and port of this computer to listen on.
    pub listen: SocketAddr,
    /// Permits an unspecified address in `listen`, that is, every network interface of this computer.
    #[serde(default)]
    pub any_interface: bool,
    /// Addresses of the clients that may connect; at least one.
    pub allow: Vec<IpAddr>,
    /// Maximum time between two changes of the control's `alive` register, s. After that, the inputs of the control
    /// count as stale.
    #[serde(default = "default_fresh_s")]
    pub fresh_s: f64,
}

/// Keys of `[http]` or `[serve.http]`, before validation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HttpKeys {
    /// Address and port to listen on; validation permits a loopback address only.
    listen: SocketAddr,
    /// Host names of the proxy in front of the page; permitted only with `tokens = true`.
    #[serde(rename = "names", default)]
    proxy_names: Vec<String>,
    /// Whether every client must present a token.
    #[serde(default)]
    tokens: bool,
}

/// The web page and the HTTP API.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "HttpKeys")]
pub struct HttpConfig {
    /// Address and port to listen on; a loopback address only.
    pub listen: SocketAddr,
    /// Host names under which a proxy on this computer receives requests, with the port unless it is the default.
    /// Empty: no proxy.
    pub proxy_names: Vec<String>,
    /// Whether every client must present a token.
    pub requires_tokens: bool,
}

impl TryFrom<HttpKeys> for HttpConfig {
    type Error = String;

    fn try_from(HttpKeys { listen, proxy_names: names, tokens }: HttpKeys) -> Result<Self, String> {
        if !names.is_empty() && !tokens {
            return Err("`names` permits access from other computers, where any client may start a cycle: set \
                        `tokens = true`, and create a token for each client with `trued token add`"
                .to_owned());
        }
        match listen.ip().is_loopback() {
            true => Ok(Self { listen, proxy_names: names, requires_tokens: tokens }),
            false => Err(format!(
                "listen is `{listen}`, which other computers can reach, and any client there may start a cycle: \
                 set it to 127.0.0.1"
            )),
        }
    }
}

/// Keys of `[serve.line]`, before validation: exactly one of `serial`, `serial_id` and `tcp`; `baud` not with `tcp`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
}

/// The text interface, with lines such as `START 1 ENABLE AUTO DOOR`: a serial port, or a TCP server to which the
/// daemon connects.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "LineKeys")]
pub struct LineInterfaceConfig(pub LinkConfig);

const DEFAULT_LINE_BAUD: u32 = 9600;

impl TryFrom<LineKeys> for LineInterfaceConfig {
    type Error = String;

    fn try_from(LineKeys { serial, serial_id, baud, tcp }: LineKeys) -> Result<Self, String> {
        LinkConfig::from_keys(LinkKeys { serial, serial_id, tcp, baud }, DEFAULT_LINE_BAUD).map(Self)
    }
}

/// Keys of `[serve]`, before validation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ServeKeys {
    /// Minimum time between the end of a cycle and the start of the next, s; default 5.
    min_interval_s: Option<f64>,
    /// Maximum time between two events of a run, s; after that, the run counts as hung. Default 900.
    #[serde(rename = "patience_s")]
    event_timeout_s: Option<f64>,
    /// Time from the end of a run for which its verdict stays valid, h; after that, the result is outdated. Default
    /// 192.
    verdict_h: Option<f64>,
    /// Conditions of an external start, with `enable` at least; without the key all of [`StartInterlock`].
    demand: Option<Vec<StartInterlock>>,
    cycle: Vec<CycleConfig>,
    modbus: Option<ModbusServerConfig>,
    line: Option<LineInterfaceConfig>,
    http: Option<HttpConfig>,
    #[serde(default)]
    schedule: Vec<ScheduleEntry>,
}

/// `[serve]`, validated.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ServeKeys")]
pub struct ServeConfig {
    /// Minimum time between the end of a cycle and the start of the next.
    pub min_pause_between_cycles: Duration,
    /// Maximum time between two events of a run; after that, the run counts as hung.
    pub max_event_interval: Duration,
    /// Time from the end of a run for which its verdict stays valid; after that, the result is outdated.
    pub verdict_validity: Duration,
    /// Conditions of an external start; always contains [`StartInterlock::Enable`].
    pub required_interlocks: Vec<StartInterlock>,
    pub cycles: Vec<CycleConfig>,
    pub modbus_server_config: Option<ModbusServerConfig>,
    pub line_interface_config: Option<LineInterfaceConfig>,
    /// `[serve.http]`, the page of a daemon that serves this machine file alone; refused in a machine file of
    /// `trued.toml`.
    pub http_config: Option<HttpConfig>,
    pub schedules: Vec<ScheduleEntry>,
}

fn default_fresh_s() -> f64 {
    1.0
}

impl TryFrom<ServeKeys> for ServeConfig {
    type Error = String;

    fn try_from(keys: ServeKeys) -> Result<Self, String> {
        let ServeKeys { min_interval_s, event_timeout_s, verdict_h, demand, cycle, modbus, line, http, schedule } =
            keys;
        let (min_interval_s, event_timeout_s) = (min_interval_s.unwrap_or(5.0), event_timeout_s.unwrap_or(900.0));
        // One week between measurements, and one day of tolerance.
        let verdict_h = verdict_h.unwrap_or(192.0);
        let demand = demand.unwrap_or_else(|| vec![StartInterlock::Enable, StartInterlock::Auto, StartInterlock::Door]);
        check_key_range("min_interval_s", min_interval_s, 0.0, 86_400.0)?;
        check_key_range("patience_s", event_timeout_s, 1.0, 86_400.0)?;
        check_key_range("verdict_h", verdict_h, 0.1, 8784.0)?;
        if !demand.contains(&StartInterlock::Enable) {
            return Err("demand must contain `enable`: an external start must be enabled at the machine, \
                        not by software alone"
                .to_owned());
        }
        check_cycle_numbers(&cycle)?;
        let numbers: Vec<u16> = cycle.iter().map(|cycle| cycle.number).collect();
        entry::validate_schedule_entries(&schedule, &numbers)?;
        modbus.as_ref().map_or(Ok(()), check_modbus_addresses_and_fresh_time)?;
        Ok(Self {
            min_pause_between_cycles: Duration::from_secs_f64(min_interval_s),
            max_event_interval: Duration::from_secs_f64(event_timeout_s),
            verdict_validity: Duration::from_secs_f64(3600.0 * verdict_h),
            required_interlocks: demand,
            cycles: cycle,
            modbus_server_config: modbus,
            line_interface_config: line,
            http_config: http,
            schedules: schedule,
        })
    }
}

/// Checks that there is a cycle, and that the numbers of the cycles are permitted and different.
fn check_cycle_numbers(cycles: &[CycleConfig]) -> Result<(), String> {
    for (index, cycle) in cycles.iter().enumerate() {
        if !(1..=MAX_CYCLES).contains(&cycle.number) {
            return Err(format!("cycle number {} is not from 1 to {MAX_CYCLES}", cycle.number));
        }
        if cycles[..index].iter().any(|other| other.number == cycle.number) {
            return Err(format!("cycle number {} occurs twice", cycle.number));
        }
    }
    match cycles.is_empty() {
        true => Err("no cycle is configured: add [[serve.cycle]]".to_owned()),
        false => Ok(()),
    }
}

fn check_modbus_addresses_and_fresh_time(modbus: &ModbusServerConfig) -> Result<(), String> {
    if modbus.listen.ip().is_unspecified() && !modbus.any_interface {
        return Err(format!(
            "modbus.listen is `{}`, every interface of this computer: set the address of the interface to \
             the machine, or set `any_interface = true`",
            modbus.listen
        ));
    }
    if modbus.allow.is_empty() {
        return Err("modbus.allow is empty: list the addresses of the clients that may connect".to_owned());
    }
    check_key_range("modbus.fresh_s", modbus.fresh_s, 0.1, 60.0)
}
