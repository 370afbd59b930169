//! `[serve]` of the machine file: which cycles may be started from outside, and through which interfaces.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::schedule::entry::{self, Entry};
use link::{HostPort, Named};

/// Highest cycle number; the lowest is 1. The Modbus map has one start coil for each cycle.
pub const MAX_CYCLES: u16 = 8;

/// A condition that the machine itself must report before a cycle starts from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Demand {
    /// The external start is enabled: by a key switch at the machine, or by a bit of its PLC.
    Enable,
    /// The control is in automatic mode.
    Auto,
    /// The guards are closed.
    Door,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cycle {
    /// Number by which the cycle is started, from 1.
    pub number: u16,
    pub method: String,
    /// Number of passes, as `--repeat`.
    pub repeat: Option<u32>,
}

/// The daemon's own Modbus TCP server.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Modbus {
    /// Address and port of this computer to listen on.
    pub listen: SocketAddr,
    #[serde(default)]
    pub any_interface: bool,
    /// Addresses of the clients that may connect.
    pub allow: Vec<IpAddr>,
    /// Maximum time between two changes of the control's `alive` register, s. After that, the inputs of the control
    /// count as stale.
    #[serde(default = "fresh_s")]
    pub fresh_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HttpKeys {
    listen: SocketAddr,
    #[serde(default)]
    names: Vec<String>,
    #[serde(default)]
    tokens: bool,
}

/// The page and the HTTP API.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "HttpKeys")]
pub struct Http {
    /// Address and port to listen on; a loopback address only.
    pub listen: SocketAddr,
    /// Host names under which a proxy on this computer receives requests, with the port unless it is the default.
    pub names: Vec<String>,
    /// Whether every client must present its own token.
    pub tokens: bool,
}

impl TryFrom<HttpKeys> for Http {
    type Error = String;

    fn try_from(HttpKeys { listen, names, tokens }: HttpKeys) -> Result<Self, String> {
        if !names.is_empty() && !tokens {
            return Err("names let people elsewhere in, and whoever asks may start a cycle: say `tokens = true`, \
                        and make a token for each with `trued token add`"
                .to_owned());
        }
        match listen.ip().is_loopback() {
            true => Ok(Self { listen, names, tokens }),
            false => Err(format!(
                "listen is `{listen}`, which others can reach, and whoever reaches it may start a cycle: \
                 listen on 127.0.0.1"
            )),
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
}

/// The serial or TCP text interface, with lines such as `START 1 ENABLE AUTO DOOR`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "LineKeys")]
pub struct Line(pub Named);

const USUAL_BAUD: u32 = 9600;

impl TryFrom<LineKeys> for Line {
    type Error = String;

    fn try_from(LineKeys { serial, serial_id, baud, tcp }: LineKeys) -> Result<Self, String> {
        Named::of((serial, serial_id, tcp), baud, USUAL_BAUD).map(Self)
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    #[serde(default = "min_interval_s")]
    min_interval_s: f64,
    #[serde(default = "patience_s")]
    patience_s: f64,
    #[serde(default = "verdict_h")]
    verdict_h: f64,
    #[serde(default = "all")]
    demand: Vec<Demand>,
    cycle: Vec<Cycle>,
    modbus: Option<Modbus>,
    line: Option<Line>,
    http: Option<Http>,
    #[serde(default)]
    schedule: Vec<Entry>,
}

/// `[serve]`, validated.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    /// Minimum time between the end of a cycle and the start of the next.
    pub min_interval: Duration,
    /// Maximum time between two events of a run; after that, the run counts as hung.
    pub patience: Duration,
    /// Time for which a verdict stays valid.
    pub verdict: Duration,
    /// Conditions of an external start; always contains [`Demand::Enable`].
    pub demand: Vec<Demand>,
    pub cycle: Vec<Cycle>,
    pub modbus: Option<Modbus>,
    pub line: Option<Line>,
    pub http: Option<Http>,
    pub schedule: Vec<Entry>,
}

fn min_interval_s() -> f64 {
    5.0
}

fn patience_s() -> f64 {
    900.0
}

/// Default validity of a verdict, h: one week between measurements, and one day of tolerance.
fn verdict_h() -> f64 {
    192.0
}

fn fresh_s() -> f64 {
    1.0
}

fn all() -> Vec<Demand> {
    vec![Demand::Enable, Demand::Auto, Demand::Door]
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys {
            min_interval_s,
            patience_s,
            verdict_h,
            demand,
            cycle,
            modbus,
            line,
            http,
            schedule,
        } = keys;
        if !(0.0..=86_400.0).contains(&min_interval_s) {
            return Err(format!("min_interval_s is {min_interval_s}; from 0 to 86400"));
        }
        if !(1.0..=86_400.0).contains(&patience_s) {
            return Err(format!("patience_s is {patience_s}; from 1 to 86400"));
        }
        if !(0.1..=8784.0).contains(&verdict_h) {
            return Err(format!("verdict_h is {verdict_h}; from 0.1 to 8784"));
        }
        if !demand.contains(&Demand::Enable) {
            return Err(
                "demand must contain `enable`: a start from outside is enabled at the machine, \
                        never by software alone"
                    .to_owned(),
            );
        }
        check_cycles(&cycle)?;
        let numbers: Vec<u16> = cycle.iter().map(|cycle| cycle.number).collect();
        entry::check(&schedule, &numbers)?;
        modbus.as_ref().map_or(Ok(()), check_modbus)?;
        let min_interval = Duration::from_secs_f64(min_interval_s);
        let patience = Duration::from_secs_f64(patience_s);
        let verdict = Duration::from_secs_f64(3600.0 * verdict_h);
        Ok(Self { min_interval, patience, verdict, demand, cycle, modbus, line, http, schedule })
    }
}

fn check_cycles(cycles: &[Cycle]) -> Result<(), String> {
    for (index, cycle) in cycles.iter().enumerate() {
        if !(1..=MAX_CYCLES).contains(&cycle.number) {
            return Err(format!("cycle number {} is not from 1 to {MAX_CYCLES}", cycle.number));
        }
        if cycles[..index].iter().any(|other| other.number == cycle.number) {
            return Err(format!("cycle number {} is given twice", cycle.number));
        }
    }
    match cycles.is_empty() {
        true => Err("no cycle may be started: add [[serve.cycle]]".to_owned()),
        false => Ok(()),
    }
}

fn check_modbus(modbus: &Modbus) -> Result<(), String> {
    if modbus.listen.ip().is_unspecified() && !modbus.any_interface {
        return Err(format!(
            "modbus.listen is `{}`, every interface of this computer: name the address that leads to \
             the machine, or say `any_interface = true`",
            modbus.listen
        ));
    }
    if modbus.allow.is_empty() {
        return Err("modbus.allow is empty: name the addresses that may connect".to_owned());
    }
    match (0.1..=60.0).contains(&modbus.fresh_s) {
        true => Ok(()),
        false => Err(format!("modbus.fresh_s is {}; from 0.1 to 60", modbus.fresh_s)),
    }
}
