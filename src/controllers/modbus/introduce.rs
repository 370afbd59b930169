//! What it says of itself.

use super::driver::ModbusControl;
use crate::controllers::{ControllerError, Introduction};

impl ModbusControl {
    pub(super) async fn say_who(&mut self) -> Result<Introduction, ControllerError> {
        Ok(Introduction::default())
    }
}
