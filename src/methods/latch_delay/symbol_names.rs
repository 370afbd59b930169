//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    main_result("t_latch", "delay from contact to latch"),
    main_result("E_latch", "position error caused by the delay"),
    main_result("T_scan", "duration of one PLC program scan"),
    main_result("s_*", "scatter of the touches at * mm/min"),
    main_result("E_F*", "deviations of the touches at * mm/min"),
];
