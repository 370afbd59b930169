//! Checks that each thermometer answers with a temperature. Nothing moves.

use super::{CheckEnd, CheckPart, MachineCheck, PartTimer};
use devices::sensors::thermometer::ThermometerError;

pub(super) async fn check_thermometers(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let devices = check.devices.as_ref().ok_or(CheckEnd::Unsafe)?;
    let timer = PartTimer::start(CheckPart::Sensors);
    let each = devices.thermometers.read_once().await.into_iter();
    let results: Vec<_> = each
        .map(|(entry, result)| (format!("thermometer {} ({})", entry.name, entry.describe_address()), result))
        .collect();
    for (name, result) in results {
        match result {
            Ok(celsius) => check.report_ok(timer, format!("{name}: {celsius:.2} °C")),
            // The machine file was written for a simulated machine.
            Err(error @ ThermometerError::NoSimulatedMachine) => {
                check.report_unchecked(CheckPart::Sensors, format!("{name}: {error}; {}", error.remedy()));
            }
            Err(error) => {
                check.report_failed(timer, format!("{name}: {error}"), error.remedy());
            }
        }
    }
    check.require_no_stop_request()
}
