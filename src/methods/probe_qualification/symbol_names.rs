//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, harmonic_result, main_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main_result("x_stylus", "stylus offset: X"),
    main_result("y_stylus", "stylus offset: Y"),
    main_result("r_stylus", "effective radius of the stylus ball, minus the stated radii"),
    main_result("E_probe", "pre-travel over the direction of the touch"),
    main_result("E_probe_fast", "change of the pre-travel at the higher feed"),
    harmonic_result("E_probe_c*", "pre-travel: harmonic *, cosine part"),
    harmonic_result("E_probe_s*", "pre-travel: harmonic *, sine part"),
    main_result("t_latch", "delay from contact to latch"),
    main_result("s_touch", "scatter of the touches"),
];
