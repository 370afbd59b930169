//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main, setup};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup("zero_x", "zero point of the sensor: X"),
    setup("zero_y", "zero point of the sensor: Y"),
    setup("zero_z", "zero point of the sensor: Z"),
    setup("beam_x", "direction of the beam: X"),
    setup("beam_y", "direction of the beam: Y"),
    setup("gain", "gain of the sensor"),
    setup("form", "form deviation of the scanned surface"),
    main("deviation", "residuals of the points"),
    main("residuals", "residuals of the sphere positions"),
];
