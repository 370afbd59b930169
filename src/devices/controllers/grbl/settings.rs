//! Settings of a control, as `$$` lists them. Setting numbers and meanings are those of grblHAL
//! (`settings.h`).

use std::collections::BTreeMap;

use super::driver::Grbl;
use super::message::Message;
use crate::controllers::ControllerError;

/// Bit of `$21`: hard limits are on.
pub(super) const HARD_LIMITS: u32 = 1;
/// Bits of `$22`: homing is on; the switch is at zero; axes without a switch are homed at their present
/// position.
pub(super) const HOMING: u32 = 1;
pub(super) const SWITCH_IS_ZERO: u32 = 1 << 3;
pub(super) const BY_HAND: u32 = 1 << 5;

/// First numbers of the settings for minimum and maximum, an extension of the simulated control: the travel
/// of its axis may extend to both sides of zero, which grblHAL does not support.
pub(super) const SIMULATED_ENDS: [u16; 2] = [9000, 9050];

/// Settings with a numeric value, by number.
pub(super) struct Settings(pub BTreeMap<u16, f64>);

impl Settings {
    pub fn value(&self, number: u16) -> Option<f64> {
        self.0.get(&number).copied()
    }

    /// Whether the mask `number` has a bit of `bits`; false if the setting is not reported.
    pub fn has(&self, number: u16, bits: u32) -> bool {
        self.mask(number) & bits != 0
    }

    fn mask(&self, number: u16) -> u32 {
        // The conversion is exact: masks are small whole numbers.
        self.value(number).unwrap_or_default() as u32
    }
}

impl Grbl {
    pub(super) async fn settings(&mut self) -> Result<Settings, ControllerError> {
        let said = self.wire.ask("$$").await?.into_iter();
        let settings = said.filter_map(|message| match message {
            Message::Setting(number, value) => Some((number, value)),
            _ => None,
        });
        Ok(Settings(settings.collect()))
    }
}
