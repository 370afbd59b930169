//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, harmonics, main};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main("x_stylus", "stylus offset: X"),
    main("y_stylus", "stylus offset: Y"),
    main("r_stylus", "effective radius of the stylus ball, minus the stated radii"),
    main("E_probe", "pre-travel over the direction of the touch"),
    main("E_probe_fast", "change of the pre-travel at the higher feed"),
    harmonics("E_probe_c*", "pre-travel: harmonic *, cosine part"),
    harmonics("E_probe_s*", "pre-travel: harmonic *, sine part"),
    main("t_latch", "delay from contact to latch"),
    main("s_touch", "scatter of the touches"),
];
