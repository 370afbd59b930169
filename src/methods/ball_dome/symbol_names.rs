//! Names of the results in plain words.

use crate::symbol_names::{SymbolPattern, main, setup};

pub const SYMBOL_NAMES: &[SymbolPattern] = &[
    setup("N1_tool_x", "nominal machine, stated stylus: stylus tip X"),
    setup("N1_tool_y", "nominal machine, stated stylus: stylus tip Y"),
    setup("N1_tool_z", "nominal machine, stated stylus: stylus tip Z"),
    setup("N2_tool_x", "nominal machine, stylus from one ball: stylus tip X"),
    setup("N2_tool_y", "nominal machine, stylus from one ball: stylus tip Y"),
    setup("N2_tool_z", "nominal machine, stylus from one ball: stylus tip Z"),
    setup("N3_tool_x", "nominal machine, stylus from all balls: stylus tip X"),
    setup("N3_tool_y", "nominal machine, stylus from all balls: stylus tip Y"),
    setup("N3_tool_z", "nominal machine, stylus from all balls: stylus tip Z"),
    setup("S1_tool_x", "calibrated machine, stated stylus: stylus tip X"),
    setup("S1_tool_y", "calibrated machine, stated stylus: stylus tip Y"),
    setup("S1_tool_z", "calibrated machine, stated stylus: stylus tip Z"),
    setup("S2_tool_x", "calibrated machine, stylus from one ball: stylus tip X"),
    setup("S2_tool_y", "calibrated machine, stylus from one ball: stylus tip Y"),
    setup("S2_tool_z", "calibrated machine, stylus from one ball: stylus tip Z"),
    setup("S3_tool_x", "calibrated machine, stylus from all balls: stylus tip X"),
    setup("S3_tool_y", "calibrated machine, stylus from all balls: stylus tip Y"),
    setup("S3_tool_z", "calibrated machine, stylus from all balls: stylus tip Z"),
    setup("S4_tool_x", "calibrated machine, stylus of the calibration: stylus tip X"),
    setup("S4_tool_y", "calibrated machine, stylus of the calibration: stylus tip Y"),
    setup("S4_tool_z", "calibrated machine, stylus of the calibration: stylus tip Z"),
    main("N1_*", "nominal machine, stated stylus: * deviation"),
    main("N2_*", "nominal machine, stylus from one ball: * deviation"),
    main("N3_*", "nominal machine, stylus from all balls: * deviation"),
    main("S1_*", "calibrated machine, stated stylus: * deviation"),
    main("S2_*", "calibrated machine, stylus from one ball: * deviation"),
    main("S3_*", "calibrated machine, stylus from all balls: * deviation"),
    main("S4_*", "calibrated machine, stylus of the calibration: * deviation"),
];
