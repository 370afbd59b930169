use super::ErrorMap;
use super::page::{ReportFacts, render_result_page};
use machine::record::estimate::*;
use machine::record::plan::Plan;
use machine::record::stage_proof::{Clearance, StageProof};

const BUDGET_SOURCES_WITH_U: [(&str, f64); 4] =
    [("repeatability", 0.31), ("lobing", 0.22), ("stylus offset", 0.30), ("drift", 0.07)];

fn parameter_with_budget(symbol: &str, value: f64, unit: Unit, scale: f64) -> Parameter {
    let budget = BUDGET_SOURCES_WITH_U.map(|(source, u)| serde_json::json!({"source": source, "u": scale * u}));
    let u = scale * BUDGET_SOURCES_WITH_U.iter().map(|(_, u)| u * u).sum::<f64>().sqrt();
    serde_json::from_value(serde_json::json!({
        "symbol": symbol, "value": value, "unit": unit, "u": u, "U": 2.13 * u, "k": 2.13,
        "dof": 15.4, "identifiable": true, "budget": budget,
    }))
    .unwrap()
}

fn harmonic_function(symbol: &str, harmonics: &[(f64, f64)], figure: FunctionFigureKind) -> EstimatedFunction {
    let x: Vec<f64> = (0..24).map(|n| f64::from(n) * 15.0).collect();
    let at = |x: &f64| {
        let turn = x.to_radians();
        harmonics.iter().map(|(n, size)| size * (n * turn + size).sin()).sum()
    };
    EstimatedFunction {
        symbol: symbol.to_owned(),
        argument: if figure == FunctionFigureKind::Polar { "θ" } else { "C" }.to_owned(),
        argument_unit: "deg".to_owned(),
        y: x.iter().map(at).collect(),
        u: x.iter().map(|x| 0.4 + 0.1 * x.to_radians().cos()).collect(),
        x,
        unit: Unit::Um,
        figure,
        at_mm: None,
    }
}

/// An estimate as from the self-calibration of a rotary axis.
pub(super) fn example_estimate() -> Estimate {
    let total = [
        harmonic_function("EXC_total", &[(0.0, 50.1), (1.0, 31.0), (2.0, 1.2)], FunctionFigureKind::Curve),
        harmonic_function("EYC_total", &[(1.0, 27.0), (3.0, 0.8)], FunctionFigureKind::Curve),
    ];
    let axis = CircleFigure {
        symbol: "axis_position".to_owned(),
        unit: Unit::Um,
        x: total[0].y.clone(),
        y: total[0].x.iter().map(|x| 29.8 * x.to_radians().sin() - 30.0).collect(),
        centre: [-13.2, -30.004],
        radius: 30.6,
        centre_expanded: [4.1, 3.2],
    };
    let mut lost = parameter_with_budget("scale_xy", 0.0, Unit::UmPerM, 1.0);
    lost.identifiable = false;
    Estimate {
        trued_estimate: ESTIMATE_VERSION,
        method: "self-calibration".to_owned(),
        provenance: None,
        coverage_percent: Some(95.45),
        trials: Some(10_000),
        parameters: vec![
            parameter_with_budget("EX0C", 49.873, Unit::Um, 1.0),
            parameter_with_budget("EY0C", -30.0041, Unit::Um, 1.05),
            parameter_with_budget("EXX1_minus_EYY1", 12.2, Unit::UmPerM, 21.0),
            parameter_with_budget("EC0Y", -8.31, Unit::Urad, 9.0),
            lost,
        ],
        functions: total
            .into_iter()
            .chain([
                harmonic_function("E_radial", &[(2.0, 1.1), (3.0, 0.4)], FunctionFigureKind::Curve),
                harmonic_function("W", &[(2.0, 2.1), (3.0, 0.9), (5.0, 0.3)], FunctionFigureKind::Polar),
            ])
            .collect(),
        circles: vec![axis],
        arrows: Vec::new(),
        weakest: None,
        covariance: ParameterCovariance::default(),
        rank: 26,
        unknowns: 26,
        condition: 21.88,
        gauge: vec!["the mean of W is zero".to_owned()],
        held_at_zero: Vec::new(),
        location_at_mm: None,
        not_identifiable: vec!["the common scale of X and Y (confounded with R)".to_owned()],
        residual_rms_um: 0.283,
        degrees_of_freedom: 38,
        chi2_per_dof: 1.04,
        verdict: Verdict::Pass,
        decision_rule: None,
        warnings: vec!["holds at the height Z = 62 mm only".to_owned()],
        outliers: Vec::new(),
        measurement_checks: Vec::new(),
        prior_hashes: Vec::new(),
        measured_ranges: Default::default(),
        source_effects: Vec::new(),
    }
}

pub(super) fn plan(machine: &str) -> Plan {
    serde_json::from_value(serde_json::json!({
        "trued_plan": 1,
        "method": "self-calibration",
        "settings": {"n": 24, "probe_angles_deg": [0, 15, 90]},
        "machine": {"name": machine, "topology": "w-C-B-X-F-Z-Y-S-t", "tool_mm": [0, 0, -120.5]},
        "probe": {"ball_radius_mm": 3.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0.3, 0.1, 50.0], "axis": [0, 0, 1],
                     "radius_mm": 45.0},
        "steps": [{"id": 0, "stage": 0, "kind": "touch", "label": "1a/C000", "from": {"X": 60.0},
                   "to": {"X": 44.0}, "feed_mm_min": 30.0, "sensor": "probe",
                   "normal": [1.0, 0.0, 0.0]}],
    }))
    .unwrap()
}

fn proof_of_step(step: u32, clearance_mm: f64) -> StageProof {
    let between = ["stylus stem".to_owned(), "vice".to_owned()];
    let clearance = Clearance { step, line: 9, clearance_mm, between };
    StageProof {
        motion_count: 8,
        nearest: Some(clearance.clone()),
        steps: vec![clearance],
        unchecked_items: vec!["probe body".to_owned()],
    }
}

fn report_facts() -> ReportFacts {
    ReportFacts {
        run_id: "12".to_owned(),
        start_time: "2025-03-14T09:26:53Z".to_owned(),
        run_state: "finished".to_owned(),
        signatures: Some(vec!["by Ada on 2025-03-15".to_owned()]),
        reading_count: 96,
        temperature_rows: vec![("spindle".to_owned(), "mean 20.13 °C".to_owned())],
        temperature_curves: Vec::new(),
        events_with_times: vec![("10:02".to_owned(), "confirmed by Ada: the way is free".to_owned())],
        program_version: "0.1.0".to_owned(),
        sha256_by_item: vec![("plan".to_owned(), "ba7816bf8f01cfea".repeat(4))],
        stage_proofs: vec![proof_of_step(0, 2.25), proof_of_step(0, 1.26)],
        ..ReportFacts::default()
    }
}

/// The report shows the failed parameters, by how much they fail and by which rule; without limits the table has
/// no column for them.
#[test]
fn failed_parameters_are_named() {
    let mut estimate = example_estimate();
    let page = |estimate: &Estimate| render_result_page(&plan("mill"), estimate, &report_facts()).unwrap();
    assert!(!page(&estimate).contains("Probability of conformity"));
    estimate.verdict = Verdict::Fail;
    estimate.decision_rule = Some("guard bands".to_owned());
    estimate.parameters[1].judged =
        Some(LimitVerdict { limit: 12.5, verdict: Verdict::Fail, conformance: Some(0.0213) });
    let failed = page(&estimate);
    for words in [
        "E_Y0C −30.0 µm, U 1.1 µm, limit ±12.5 µm: FAIL (position of C in Y)",
        "out of tolerance by more than the uncertainty",
        ">±12.5</td>",
        ">2.1 %</td>",
        "no limit",
        "Decision rule: guard bands.",
    ] {
        assert!(failed.contains(words), "{words}");
    }
}

/// Each cell shows its value, or nothing for a value that is not finite.
#[test]
fn volume_maps_are_drawn() {
    let map = ErrorMap {
        title: "X and Y, at Z 300 mm".to_owned(),
        horizontal_axis: ("X, mm".to_owned(), vec![-100.0, 0.0, 100.0]),
        vertical_axis: ("Y, mm".to_owned(), vec![-50.0, 50.0]),
        panels: [
            ("error, µm".to_owned(), vec![vec![11.0, 22.0, 33.0], vec![44.0, 55.0, f64::NAN]]),
            ("left, µm".to_owned(), vec![vec![71.0; 3], vec![72.0; 3]]),
        ],
    };
    assert_eq!(map.max_value(), 72.0);
    let volume = Some((vec!["largest 55 µm".to_owned()], vec![map]));
    let page = render_result_page(
        &plan("mill 3"),
        &example_estimate(),
        &ReportFacts { volume_texts_and_maps: volume, ..report_facts() },
    )
    .unwrap();
    for words in ["Position error of the tool", "largest 55 µm", "X and Y, at Z 300 mm", "X, mm", "Y, mm"] {
        assert!(page.contains(words), "{words}");
    }
    let texts = |value: &str| page.matches(&format!(">{value}</text>")).count();
    assert_eq!(["11", "22", "33", "44", "55", "−100", "71", "72"].map(texts), [1, 1, 1, 1, 1, 2, 3, 3]);
    assert!(!page.contains("NaN"));
}

#[test]
fn page_has_all_sections() {
    let estimate = example_estimate();
    let page = render_result_page(&plan("mill 3"), &estimate, &report_facts()).unwrap();
    let symbols = estimate.parameters.iter().map(|p| &p.symbol);
    let symbols = symbols.chain(estimate.functions.iter().map(|f| &f.symbol));
    for symbol in symbols.chain(estimate.circles.iter().map(|circle| &circle.symbol)) {
        assert!(page.contains(&format!("title=\"{symbol}\"")), "{symbol}");
    }
    let hash = report_facts().sha256_by_item[0].1.clone();
    for text in [
        "mill 3",
        "<th scope=\"row\">Temperature: spindle</th><td>mean 20.13 °C</td>",
        "class=\"badge verdict pass\"",
        "(49.9 ± 1.0) µm",
        "not identifiable",
        "E<sub>X0C</sub>",
        "Z = 62 mm",
        "the mean of W is zero",
        "confounded with R",
        "touches: 1",
        "stylus offset",
        "26 of 26 unknowns",
        "21.88",
        "cylinder, radius 45 mm",
        "[0,15,90]",
        "finished",
        "Events during the run",
        "confirmed by Ada: the way is free",
        "1.26 mm between stylus stem and vice, step 0 (1a",
        "<li>probe body</li>",
        &hash,
    ] {
        assert!(page.contains(text), "{text}");
    }
    // Four functions, the circle, the clearance, and the sketches of the axes Y and C.
    assert_eq!(page.matches("<svg").count(), 8);
    assert_eq!(page.matches("</svg>").count(), 8);
    assert_eq!(page.matches("<li>probe body</li>").count(), 1);
}

/// A result with correlated unknowns, and vectors at their positions.
fn estimate_with_arrows() -> Estimate {
    let arrow = |label: &str, vector, flagged| FigureArrow {
        label: label.to_owned(),
        at_mm: [120.0, -40.0, 60.0],
        vector,
        modelled: None,
        flagged,
    };
    let group = |name: &str, arrows| ArrowGroup { name: name.to_owned(), arrows };
    let groups = vec![
        group("B -30°, C 90°", vec![arrow("ball 1", [0.3, -0.4, 0.1], false)]),
        group("B 60°, C 0°", vec![arrow("ball 2", [0.2, -9.4, 1.25], true)]),
        group("B 90°, C 0°", vec![]),
    ];
    Estimate {
        arrows: vec![ArrowFigure {
            symbol: "residuals".to_owned(),
            unit: Unit::Um,
            groups,
            figure: VectorFigureKind::Arrows,
        }],
        weakest: Some("EX0S together with tool_x".to_owned()),
        covariance: ParameterCovariance {
            symbols: ["EX0S", "tool_x", "EA0B"].map(str::to_owned).into(),
            rows: vec![vec![4.0, -3.9999, 0.1], vec![-3.9999, 4.0, 0.0], vec![0.1, 0.0, 1.0]],
        },
        ..example_estimate()
    }
}

#[test]
fn correlations_and_residuals_are_on_the_page() {
    let page = render_result_page(&plan("mill"), &estimate_with_arrows(), &report_facts()).unwrap();
    for text in [
        "E_X0S together with tool_x",
        "<h3>Above ±0.5</h3>",
        "<sub>x</sub></span>: −0.999975",
        "All 3 groups",
        "Largest vectors: B 60°, C 0°, rms 9.5 µm",
        "<li>ball 2 at B 60°, C 0°: (0.2, −9.4, 1.2) µm</li>",
        "the longest arrows are shortened",
    ] {
        assert!(page.contains(text), "{text}");
    }
    assert!(!page.contains("ball 1 at"));
    // Eight figures as without vectors, the matrix, all vectors in one picture, and the group with the largest ones.
    // Two groups with vectors are too few for a picture of their sizes.
    assert_eq!(page.matches("<svg").count(), 8 + 1 + 2);
    let without = render_result_page(&plan("mill"), &example_estimate(), &report_facts()).unwrap();
    for absent in ["Correlation of the results", "Weakest combination of parameters", "Three views"] {
        assert!(page.contains(absent) && !without.contains(absent), "{absent}");
    }
}

#[test]
fn balls_are_described() {
    let mut plan = plan("mill");
    let ball =
        |id: &str, radius_mm: f64| serde_json::json!({"id": id, "centre_mm": [0, 0, 60], "radius_mm": radius_mm});
    let told = |plan: &Plan| render_result_page(plan, &example_estimate(), &report_facts()).unwrap();
    plan.artefact = serde_json::from_value(serde_json::json!({
        "kind": "balls", "balls": [ball("1", 12.5), ball("2", 15.0)],
        "lengths": [{"from": "1", "to": "2", "mm": 304.8, "u_mm": 1e-4}],
    }))
    .unwrap();
    let text = "2 balls, radius 12.5 to 15 mm; certified lengths 1 to 2: 304.8 mm (u = 0.10 µm)";
    assert!(told(&plan).contains(text));
    plan.artefact = serde_json::from_value(serde_json::json!({"kind": "balls", "balls": [ball("1", 15.0)]})).unwrap();
    assert!(told(&plan).contains("1 ball, radius 15 mm; no certified length"));
}

/// With a laser sensor the report does not mention a stylus, and repeated measurements are scans.
#[test]
fn sensor_is_described_instead_of_the_stylus() {
    let mut plan = plan("mill");
    let laser = serde_json::json!({"name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1],
                                   "range_mm": [-10, 10], "noise_um": 0.5});
    plan.sensors.push(serde_json::from_value(laser).unwrap());
    let scan = serde_json::json!({"path": [], "dwell_s": 0.1, "samples": 8});
    let mut step = plan.steps[0].clone();
    step.kind = machine::record::plan::StepKind::Reference;
    step.scan = Some(serde_json::from_value(scan).unwrap());
    plan.steps = vec![step];
    let page = render_result_page(&plan, &example_estimate(), &report_facts()).unwrap();
    for text in ["Sensor laser", "range -10 to 10 mm, noise 0.5 µm declared", "reference scans: 1"] {
        assert!(page.contains(text), "{text}");
    }
    assert!(!page.contains("Stylus") && !page.contains("reference touches"));
}

#[test]
fn page_needs_no_other_file() {
    let page = render_result_page(&plan("mill"), &estimate_with_arrows(), &report_facts()).unwrap();
    for foreign in ["{{", "{%", "<script", "src=", "href=", "url(", "@import", "NaN", " inf"] {
        assert!(!page.contains(foreign), "{foreign}");
    }
}

#[test]
fn names_are_escaped() {
    let hostile = "<script>alert('1')</script>\" onload=\"x";
    let mut estimate = estimate_with_arrows();
    estimate.arrows[0].groups[1].name = hostile.to_owned();
    estimate.arrows[0].groups[1].arrows[0].label = hostile.to_owned();
    estimate.covariance.symbols[0] = hostile.to_owned();
    estimate.weakest = Some(hostile.to_owned());
    estimate.warnings = vec![hostile.to_owned()];
    estimate.parameters[0].symbol = hostile.to_owned();
    estimate.functions[0].symbol = hostile.to_owned();
    estimate.functions[0].argument = hostile.to_owned();
    estimate.circles[0].symbol = hostile.to_owned();
    let facts = ReportFacts { run_id: hostile.to_owned(), ..report_facts() };
    let page = render_result_page(&plan(hostile), &estimate, &facts).unwrap();
    assert!(!page.contains("<script") && !page.contains("\" onload"));
    assert!(page.contains("&lt;script&gt;"));
}

#[test]
fn empty_estimate_has_a_page() {
    let mut estimate = example_estimate();
    estimate.parameters.clear();
    estimate.functions.truncate(1);
    estimate.functions[0].y = vec![f64::NAN; 24];
    estimate.circles.clear();
    estimate.warnings.clear();
    estimate.verdict = Verdict::Undecided;
    let page = render_result_page(&plan("mill"), &estimate, &ReportFacts::default()).unwrap();
    assert!(page.contains("No finite values to draw") && page.contains("badge verdict undecided"));
    assert!(!page.contains("Warnings") && !page.contains("Events during the run") && !page.contains("<svg"));
}

/// Data of the machine file are printed, a missing one as not stated; an expired certificate is marked.
#[test]
fn report_data_are_printed_or_not_stated() {
    let mut plan = plan("mill");
    plan.report.serial_number = Some("SN 0815".to_owned());
    plan.report.certificate_due = Some("2025-01-31".to_owned());
    let facts = ReportFacts { is_certificate_expired: true, control: "Grbl 1.1f".to_owned(), ..report_facts() };
    let page = render_result_page(&plan, &example_estimate(), &facts).unwrap();
    for row in [
        "Serial number</th><td>SN 0815<",
        "Location</th><td>not stated<",
        "Certificate valid until</th><td>2025-01-31: expired before this measurement<",
        "Control and firmware</th><td>Grbl 1.1f<",
        "Operator</th><td>not stated<",
        "Begin</th><td>2025-03-14T09:26:53Z<",
    ] {
        assert!(page.contains(row), "{row}");
    }
}

/// ±1.1 µm about the least-squares circle centre: the second harmonic alone.
#[test]
fn an_error_motion_figure_states_its_value() {
    let motion = harmonic_function("EXC", &[(2.0, 1.1), (1.0, 5.0)], FunctionFigureKind::Polar);
    let estimate = Estimate { functions: vec![motion], ..example_estimate() };
    let page = render_result_page(&plan("mill"), &estimate, &report_facts()).unwrap();
    let text = "error motion value 2.2\u{a0}µm about the least-squares circle centre";
    assert!(page.contains(text), "{page}");
    // The eccentricity of 5 µm would hide the form of ±1.1 µm.
    assert!(page.contains("removed before drawing: eccentricity 5.0\u{a0}µm towards "), "{page}");
    let without = render_result_page(&plan("mill"), &example_estimate(), &report_facts()).unwrap();
    assert!(!without.contains("error motion value"));
}
