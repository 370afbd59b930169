//! State of the bus while no frame arrives, with the reason if it is known.

use link::can::{CanError, CanEvent, CanId};

#[derive(Debug, Default)]
pub(super) struct BusState {
    down_reason: Option<String>,
    /// Reason why the CAN controller has left the bus (bus-off).
    bus_off_reason: Option<String>,
    /// Last bus errors that the controller has reported.
    bus_errors: Option<String>,
    /// Identifiers of the other frames that arrive.
    foreign_ids: Vec<CanId>,
}

impl BusState {
    /// Stores an event that is not a frame.
    pub fn record_event(&mut self, event: CanEvent) {
        match event {
            CanEvent::Frame(_) => {}
            CanEvent::Down(why) => self.down_reason = Some(why),
            CanEvent::Up => (self.down_reason, self.bus_off_reason) = (None, None),
            CanEvent::BusOff(why) => self.bus_off_reason = Some(why),
            CanEvent::LostFrames(_) => self.bus_off_reason = None,
            CanEvent::BusErrors(why) => self.bus_errors = Some(why),
            CanEvent::ForeignId(id) => self.foreign_ids.push(id),
        }
    }

    /// Clears all earlier events when a frame has arrived.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Returns the fault of the bus, if one is known; the fault that explains most comes first.
    pub fn fault(&self, interface: &str, id: CanId) -> Option<CanError> {
        let (interface, id) = (interface.to_owned(), id.to_string());
        if let Some(why) = self.down_reason.clone() {
            return Some(CanError::Down { interface, why });
        }
        if let Some(why) = self.bus_off_reason.clone() {
            return Some(CanError::BusOff { interface, why });
        }
        // Frames of other nodes arrive, so the bus itself works.
        if !self.foreign_ids.is_empty() {
            let foreign_ids = self.foreign_ids.iter().map(CanId::to_string).collect::<Vec<_>>().join(", ");
            return Some(CanError::ForeignIds { interface, id, foreign_ids });
        }
        let why = self.bus_errors.clone()?;
        Some(CanError::BusErrors { interface, id, why })
    }
}
