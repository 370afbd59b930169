//! State of the bus while no frame arrives, with the reason if it is known.

use link::can::{CanError, CanEvent, Id};

#[derive(Debug, Default)]
pub(super) struct Bus {
    down: Option<String>,
    /// Reason why the CAN controller has left the bus (bus-off).
    off: Option<String>,
    /// Last bus errors that the controller has reported.
    errors: Option<String>,
    /// Identifiers of the other frames that arrive.
    others: Vec<Id>,
}

impl Bus {
    /// Stores an event that is not a frame.
    pub fn hears(&mut self, heard: CanEvent) {
        match heard {
            CanEvent::Frame(_) => {}
            CanEvent::Down(why) => self.down = Some(why),
            CanEvent::Up => (self.down, self.off) = (None, None),
            CanEvent::Off(why) => self.off = Some(why),
            CanEvent::Lost(_) => self.off = None,
            CanEvent::ErrorFrameClass(why) => self.errors = Some(why),
            CanEvent::Other(id) => self.others.push(id),
        }
    }

    /// Clears all earlier events when a frame has arrived.
    pub fn speaks(&mut self) {
        *self = Self::default();
    }

    /// Returns the fault of the bus, if one is known; the fault that explains most comes first.
    pub fn ails(&self, interface: &str, id: Id) -> Option<CanError> {
        let (interface, id) = (interface.to_owned(), id.to_string());
        if let Some(why) = self.down.clone() {
            return Some(CanError::Down { interface, why });
        }
        if let Some(why) = self.off.clone() {
            return Some(CanError::Off { interface, why });
        }
        // Frames of other nodes arrive, so the bus itself works.
        if !self.others.is_empty() {
            let others = self.others.iter().map(Id::to_string).collect::<Vec<_>>().join(", ");
            return Some(CanError::ForeignIdDetector { interface, id, others });
        }
        let why = self.errors.clone()?;
        Some(CanError::ErrorFrameClass { interface, id, why })
    }
}
