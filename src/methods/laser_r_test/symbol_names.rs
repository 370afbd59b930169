//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result, setup_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup_result("zero_x", "zero point of the sensor: X"),
    setup_result("zero_y", "zero point of the sensor: Y"),
    setup_result("zero_z", "zero point of the sensor: Z"),
    setup_result("beam_x", "direction of the beam: X"),
    setup_result("beam_y", "direction of the beam: Y"),
    setup_result("gain", "gain of the sensor"),
    setup_result("form", "form deviation of the scanned surface"),
    main_result("deviation", "residuals of the points"),
    main_result("residuals", "residuals of the sphere positions"),
];
