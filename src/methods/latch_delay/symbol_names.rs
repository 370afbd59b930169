//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main("t_latch", "delay from contact to latch"),
    main("E_latch", "position error caused by the delay"),
    main("T_scan", "duration of one PLC program scan"),
    main("s_*", "scatter of the touches at * mm/min"),
    main("E_F*", "deviations of the touches at * mm/min"),
];
