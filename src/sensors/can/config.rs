//! `[sensor.can]`.

use std::sync::Arc;

use serde::Deserialize;

use crate::base::Clock;
use crate::record::sensor;
use crate::sensors::{Named, Opening, SensorError};

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    interface: String,
}

impl Named for Config {
    fn at(&self) -> String {
        format!("CAN interface {}", self.interface)
    }

    fn open<'a>(&'a self, _: &'a sensor::Sensor, _: Arc<dyn Clock>) -> Opening<'a> {
        Box::pin(async { Err(SensorError::Gone) })
    }
}
