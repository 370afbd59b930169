//! Faults and foreign frames of a CAN bus since the last frame of the sensor: the reason why no frame arrives.

use link::can::{CanError, CanEvent, CanId};

/// Events since the last frame of the sensor that may explain why no further frame arrives.
#[derive(Debug, Default)]
pub(super) struct BusState {
    /// Reason why the interface is down.
    down_reason: Option<String>,
    /// Reason why the CAN controller has left the bus (bus-off); cleared by later frames or a restart.
    bus_off_reason: Option<String>,
    /// Last report of bus errors by the CAN controller.
    last_bus_errors: Option<String>,
    /// Identifiers of the frames of other nodes that arrive.
    foreign_ids: Vec<CanId>,
}

impl BusState {
    /// Stores an event that is not a frame.
    pub fn record_event(&mut self, event: CanEvent) {
        match event {
            CanEvent::Frame(_) => {}
            CanEvent::InterfaceDown(why) => self.down_reason = Some(why),
            CanEvent::InterfaceUp => (self.down_reason, self.bus_off_reason) = (None, None),
            CanEvent::BusOff(why) => self.bus_off_reason = Some(why),
            CanEvent::LostFrames(_) => self.bus_off_reason = None,
            CanEvent::BusErrors(why) => self.last_bus_errors = Some(why),
            CanEvent::ForeignId(id) => self.foreign_ids.push(id),
        }
    }

    /// Clears all earlier events when a frame has arrived.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Returns the fault of the bus, `None` if no fault is known. Of several faults: interface down, else bus-off,
    /// else foreign identifiers, else bus errors.
    pub fn fault(&self, interface: &str, expected_id: CanId) -> Option<CanError> {
        let (interface, id) = (interface.to_owned(), expected_id.to_string());
        if let Some(why) = self.down_reason.clone() {
            return Some(CanError::InterfaceDown { interface, why });
        }
        if let Some(why) = self.bus_off_reason.clone() {
            return Some(CanError::BusOff { interface, why });
        }
        // Frames of other nodes arrive, so the bus itself works.
        if !self.foreign_ids.is_empty() {
            let foreign_ids = self.foreign_ids.iter().map(CanId::to_string).collect::<Vec<_>>().join(", ");
            return Some(CanError::ForeignIds { interface, id, foreign_ids });
        }
        let why = self.last_bus_errors.clone()?;
        Some(CanError::BusErrors { interface, id, why })
    }
}
