//! Checks that each thermometer answers with a temperature. Nothing moves.

use std::time::Instant;

use super::{Check, Ended, Part};
use devices::sensors::thermometer::ThermometerError;

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let devices = check.devices.as_ref().ok_or(Ended::Unsafe)?;
    let since = Instant::now();
    let each = devices.thermometers.once().await.into_iter();
    let told: Vec<_> = each
        .map(|(entry, said)| (format!("thermometer {} ({})", entry.name, entry.at()), said))
        .collect();
    for (name, said) in told {
        match said {
            Ok(celsius) => check.well(Part::Sensors, since, format!("{name}: {celsius:.2} °C")),
            // The machine file was written for a simulated machine.
            Err(error @ ThermometerError::NothingToFeel) => {
                check.not_looked_at(Part::Sensors, format!("{name}: {error}; {}", error.remedy()));
            }
            Err(error) => {
                check.failed(Part::Sensors, since, format!("{name}: {error}"), error.remedy());
            }
        }
    }
    check.go_on()
}
