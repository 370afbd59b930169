//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main_result, setup_result};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup_result("N1_tool_x", "nominal machine, stated stylus: stylus tip X"),
    setup_result("N1_tool_y", "nominal machine, stated stylus: stylus tip Y"),
    setup_result("N1_tool_z", "nominal machine, stated stylus: stylus tip Z"),
    setup_result("N2_tool_x", "nominal machine, stylus from one ball: stylus tip X"),
    setup_result("N2_tool_y", "nominal machine, stylus from one ball: stylus tip Y"),
    setup_result("N2_tool_z", "nominal machine, stylus from one ball: stylus tip Z"),
    setup_result("N3_tool_x", "nominal machine, stylus from all balls: stylus tip X"),
    setup_result("N3_tool_y", "nominal machine, stylus from all balls: stylus tip Y"),
    setup_result("N3_tool_z", "nominal machine, stylus from all balls: stylus tip Z"),
    setup_result("S1_tool_x", "calibrated machine, stated stylus: stylus tip X"),
    setup_result("S1_tool_y", "calibrated machine, stated stylus: stylus tip Y"),
    setup_result("S1_tool_z", "calibrated machine, stated stylus: stylus tip Z"),
    setup_result("S2_tool_x", "calibrated machine, stylus from one ball: stylus tip X"),
    setup_result("S2_tool_y", "calibrated machine, stylus from one ball: stylus tip Y"),
    setup_result("S2_tool_z", "calibrated machine, stylus from one ball: stylus tip Z"),
    setup_result("S3_tool_x", "calibrated machine, stylus from all balls: stylus tip X"),
    setup_result("S3_tool_y", "calibrated machine, stylus from all balls: stylus tip Y"),
    setup_result("S3_tool_z", "calibrated machine, stylus from all balls: stylus tip Z"),
    setup_result("S4_tool_x", "calibrated machine, stylus of the calibration: stylus tip X"),
    setup_result("S4_tool_y", "calibrated machine, stylus of the calibration: stylus tip Y"),
    setup_result("S4_tool_z", "calibrated machine, stylus of the calibration: stylus tip Z"),
    main_result("N1_*", "nominal machine, stated stylus: * deviation"),
    main_result("N2_*", "nominal machine, stylus from one ball: * deviation"),
    main_result("N3_*", "nominal machine, stylus from all balls: * deviation"),
    main_result("S1_*", "calibrated machine, stated stylus: * deviation"),
    main_result("S2_*", "calibrated machine, stylus from one ball: * deviation"),
    main_result("S3_*", "calibrated machine, stylus from all balls: * deviation"),
    main_result("S4_*", "calibrated machine, stylus of the calibration: * deviation"),
];
