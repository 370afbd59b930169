//! State of the bus while no frame arrives, with the reason if it is known.

use link::can::{CanError, Heard, Id};

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
    pub fn hears(&mut self, heard: Heard) {
        match heard {
            Heard::Frame(_) => {}
            Heard::Down(why) => self.down = Some(why),
            Heard::Up => (self.down, self.off) = (None, None),
            Heard::Off(why) => self.off = Some(why),
            Heard::Lost(_) => self.off = None,
            Heard::Trouble(why) => self.errors = Some(why),
            Heard::Other(id) => self.others.push(id),
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
            return Some(CanError::Others { interface, id, others });
        }
        let why = self.errors.clone()?;
        Some(CanError::Trouble { interface, id, why })
    }
}
