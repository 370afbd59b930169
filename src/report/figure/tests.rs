use super::ticked_axis::value_bounds;
use super::*;
use machine::record::estimate::{CircleFigure, Unit};

pub(super) fn sine_function(figure: FunctionFigureKind, count: u32) -> EstimatedFunction {
    let x: Vec<f64> = (0..count).map(|n| f64::from(n) * 360.0 / f64::from(count)).collect();
    EstimatedFunction {
        symbol: "EXC_total".to_owned(),
        argument: "C".to_owned(),
        argument_unit: "deg".to_owned(),
        y: x.iter().map(|x| 3.0 * x.to_radians().sin()).collect(),
        u: vec![0.5; x.len()],
        x,
        unit: Unit::Um,
        figure,
        at_mm: None,
    }
}

fn circle_figure(radius: f64) -> CircleFigure {
    let angles = (0..8).map(|n| f64::from(n) * std::f64::consts::FRAC_PI_4);
    CircleFigure {
        symbol: "axis".to_owned(),
        unit: Unit::Um,
        x: angles.clone().map(|angle| 50.0 + radius * angle.cos()).collect(),
        y: angles.map(|angle| -30.0 + radius * angle.sin()).collect(),
        centre: [50.0, -30.0],
        radius,
        centre_expanded: [0.5, 0.6],
    }
}

pub(super) fn attribute_values<'a>(svg: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    svg.match_indices(&start).filter_map(|(at, _)| svg[at + start.len()..].split('"').next()).collect()
}

/// All coordinates; panics on one that is not a number.
pub(super) fn svg_coordinates(svg: &str) -> Vec<f64> {
    let names = ["x", "y", "x1", "y1", "x2", "y2", "cx", "cy", "r", "width", "height", "points"];
    let values = names.iter().flat_map(|name| attribute_values(svg, name));
    values
        .flat_map(|value| value.split([' ', ',']))
        .filter(|value| !value.is_empty())
        .map(|value| value.parse().expect(value))
        .collect()
}

/// Whether all coordinates are inside the picture. Pixel positions that plotters cannot represent saturate at
/// the limits of an i32.
pub(super) fn is_inside_picture(svg: &str) -> bool {
    let frame: Vec<f64> = attribute_values(svg, "viewBox")[0].split(' ').map(|part| part.parse().unwrap()).collect();
    let larger_side = frame[2].max(frame[3]);
    svg_coordinates(svg).iter().all(|value| (-1.0..=larger_side + 1.0).contains(value))
}

#[test]
fn axes_are_labelled_with_units() {
    let svg = draw_function(&sine_function(FunctionFigureKind::Curve, 8), 2.0).unwrap();
    for text in ["C / °", "E_XC,total / µm", "315", "−4"] {
        assert!(svg.contains(text), "{text} in {svg}");
    }
    // Eight values, and the first one again at 360°.
    assert_eq!(svg.matches("<circle").count(), 9);
    assert!(is_inside_picture(&svg));
    let mut lobes = sine_function(FunctionFigureKind::Polar, 8);
    lobes.y = lobes.x.iter().map(|x| 3.0 * (2.0 * x).to_radians().sin()).collect();
    let svg = draw_function(&lobes, 2.0).unwrap();
    for text in ["0°", "315°", "E_XC,total / µm", "C / °", "1 div = 2 µm", ">\n−2\n<"] {
        assert!(svg.contains(text), "{text} in {svg}");
    }
    assert!(is_inside_picture(&svg));
    let svg = draw_circle(&circle_figure(3.0)).unwrap();
    assert!(svg.contains("x / µm") && svg.contains("y / µm") && is_inside_picture(&svg));
}

/// Two revolutions are two lines, each with its band.
#[test]
fn new_line_starts_where_the_argument_decreases() {
    let one = draw_function(&sine_function(FunctionFigureKind::Curve, 8), 2.0).unwrap();
    let EstimatedFunction { x, y, u, .. } = sine_function(FunctionFigureKind::Curve, 8);
    let [x, y, u] = [x, y, u].map(|values| [values.clone(), values].concat());
    let two =
        draw_function(&EstimatedFunction { x, y, u, ..sine_function(FunctionFigureKind::Curve, 8) }, 2.0).unwrap();
    let added = |element: &str| two.matches(element).count() - one.matches(element).count();
    assert_eq!(["<polygon", "<polyline", "<circle"].map(added), [1, 1, 9]);
}

/// Values of some nm about 1 mm: eight digits need more room than the usual three.
#[test]
fn long_labels_do_not_cover_the_title() {
    let mut function = sine_function(FunctionFigureKind::Curve, 8);
    function.u = Vec::new();
    function.y = function.y.iter().map(|y| -1000.0 + 1e-4 * y).collect();
    let svg = draw_function(&function, 2.0).unwrap();
    let lines: Vec<&str> = svg.lines().collect();
    let number = |line: &str, name: &str| attribute_values(line, name)[0].parse::<f64>().unwrap();
    let title = lines.iter().find(|line| line.contains("rotate(270")).unwrap();
    let title_right = number(title, "x") + number(title, "font-size");
    let labels = lines.windows(2).filter(|pair| pair[0].contains("text-anchor=\"end\""));
    // The digits of the usual fonts are at most 0.64 of the font size wide.
    let left =
        |pair: &[&str]| number(pair[0], "x") - 0.64 * number(pair[0], "font-size") * pair[1].chars().count() as f64;
    let lefts: Vec<f64> = labels.map(left).collect();
    assert!(lefts.len() > 2 && lefts.iter().all(|left| *left >= title_right), "{lefts:?} {title_right}");
}

/// With u = 0.5 µm about 0, the band fills the plot except for the margins (8 % of its width each), and the
/// ticks show its width.
#[test]
fn band_half_width_is_k_times_u() {
    let flat = EstimatedFunction { y: vec![0.0; 8], ..sine_function(FunctionFigureKind::Curve, 8) };
    for (k, inside, outside) in [(4.0, ["2", "−2"], "3"), (2.0, ["1.0", "−1.0"], "1.5")] {
        let svg = draw_function(&flat, k).unwrap();
        let band = svg.split("<polygon").nth(1).unwrap();
        let y = |pair: &str| pair.split(',').nth(1).unwrap().parse::<f64>().unwrap();
        let corners = attribute_values(band, "points")[0].split_whitespace().map(y);
        let (low, high) = value_bounds(corners).unwrap();
        let share = (high - low) / (560.0 - f64::from(X_LABEL_HEIGHT + 2 * PICTURE_MARGIN));
        assert!((share - 1.0 / 1.16).abs() < 0.01, "{share}");
        let has = |label: &str| svg.contains(&format!(">\n{label}\n<"));
        assert!(inside.into_iter().all(has) && !has(outside), "k = {k}");
    }
}

/// With values 1 to 4 and ±2 about them, a bar is as long as the distance from one value to the next but one.
#[test]
fn points_are_drawn_with_error_bars() {
    let mut points = sine_function(FunctionFigureKind::Points, 4);
    points.y = vec![1.0, 2.0, 3.0, 4.0];
    points.u = vec![0.5; 4];
    let svg = draw_function(&points, 2.0).unwrap();
    let marks: Vec<_> = svg.lines().filter(|line| line.contains("r=\"7\"")).collect();
    let y_of: Vec<f64> = marks.iter().map(|m| attribute_values(m, "cy")[0].parse().unwrap()).collect();
    let bars = svg.lines().filter(|line| line.contains("<polyline")).rev().take(4);
    let bars: Vec<Vec<f64>> = bars.map(svg_coordinates).collect();
    for (bar, y) in bars.iter().rev().zip(&y_of) {
        let length = (bar[3] - bar[1]).abs();
        assert!((length - 2.0 * (y_of[0] - y_of[1])).abs() <= 2.0, "{bar:?} {y_of:?}");
        assert!(((bar[1] + bar[3]) / 2.0 - y).abs() <= 1.0, "{bar:?} {y}");
    }
}

#[test]
fn flagged_points_are_circled() {
    let mut points = sine_function(FunctionFigureKind::Points, 4);
    points.u = Vec::new();
    let circled = [points.x[2], points.y[2]];
    let svg = draw_points_with_circles(&points, &[circled]).unwrap();
    let centres = |radius: &str| -> Vec<[f64; 2]> {
        let circles = svg.lines().filter(|line| line.contains(radius)).map(svg_coordinates);
        circles.map(|numbers| [numbers[0], numbers[1]]).collect()
    };
    let marks = centres("r=\"7\"");
    assert_eq!((marks.len(), centres("r=\"14\"")), (4, vec![marks[2]]));
    assert!(is_inside_picture(&svg) && smallest_text_on_a_phone(&svg) >= 9.0);
    points.y = vec![f64::NAN; 4];
    assert_eq!(draw_points_with_circles(&points, &[]), None);
}

/// The inner ring of the scale is 0 µm, the outer ring 1 µm.
#[test]
fn polar_figure_is_counter_clockwise_from_the_right() {
    let mut function = sine_function(FunctionFigureKind::Polar, 4);
    function.y = vec![0.0, 1.0, 0.0, 0.0];
    function.u = vec![0.0; 4];
    let svg = super::draw_function(&function, 2.0).unwrap();
    let marks: Vec<_> = svg.lines().filter(|line| line.contains("r=\"7\"")).collect();
    let x: Vec<_> = marks.iter().map(|mark| attribute_values(mark, "cx")[0].to_owned()).collect();
    let y: Vec<_> = marks.iter().map(|mark| attribute_values(mark, "cy")[0].to_owned()).collect();
    // The value 0 is on the inner ring (radius 120), the value 1 on the outer ring (360); y grows downwards.
    assert_eq!(x, ["570", "450", "330", "450"]);
    assert_eq!(y, ["450", "90", "450", "570"]);
}

#[test]
fn non_finite_numbers_are_not_drawn() {
    let kinds = [
        FunctionFigureKind::Curve,
        FunctionFigureKind::Polar,
        FunctionFigureKind::Points,
        FunctionFigureKind::Histogram,
        FunctionFigureKind::Spectrum,
    ];
    for figure in kinds {
        let mut flat = sine_function(figure, 8);
        flat.y = vec![5.0; 8];
        flat.u = vec![0.0; 8];
        assert!(is_inside_picture(&draw_function(&flat, 2.0).unwrap()));
        let mut holes = sine_function(figure, 8);
        (holes.y[1], holes.x[2], holes.u[3]) = (f64::NAN, f64::INFINITY, f64::NAN);
        assert!(is_inside_picture(&draw_function(&holes, 2.0).unwrap()));
        let one = EstimatedFunction { u: Vec::new(), ..sine_function(figure, 1) };
        assert!(is_inside_picture(&draw_function(&one, 2.0).unwrap()));
        assert_eq!(draw_function(&sine_function(figure, 0), 2.0), None);
        let many = draw_function(&sine_function(figure, 720), 2.0).unwrap();
        assert!(is_inside_picture(&many));
        assert_eq!(many.contains("r=\"7\""), figure == FunctionFigureKind::Points);
    }
    let mut holes = circle_figure(3.0);
    (holes.x[1], holes.centre_expanded[0]) = (f64::NAN, f64::INFINITY);
    assert!(is_inside_picture(&draw_circle(&holes).unwrap()));
    assert!(is_inside_picture(&draw_circle(&circle_figure(0.0)).unwrap()));
    assert_eq!(draw_circle(&circle_figure(f64::NAN)), None);
}

/// Height of the smallest text when the picture is as wide as a figure on a phone of 390 px, in px.
pub(super) fn smallest_text_on_a_phone(svg: &str) -> f64 {
    const FIGURE_WIDTH_PX: f64 = 333.0;
    let size = |value: &str| value.parse::<f64>().unwrap();
    let view_width = size(attribute_values(svg, "viewBox")[0].split(' ').nth(2).unwrap());
    let sizes = attribute_values(svg, "font-size").into_iter().map(size);
    sizes.fold(f64::INFINITY, f64::min) * FIGURE_WIDTH_PX / view_width
}

/// At least 9 px high, which is 12 px of a figure of 444 px in print.
#[test]
fn text_is_legible_on_a_phone() {
    let kinds = [
        FunctionFigureKind::Curve,
        FunctionFigureKind::Polar,
        FunctionFigureKind::Points,
        FunctionFigureKind::Histogram,
        FunctionFigureKind::Spectrum,
    ];
    for figure in kinds {
        let svg = draw_function(&sine_function(figure, 24), 2.0).unwrap();
        assert!(smallest_text_on_a_phone(&svg) >= 9.0, "{figure:?}: {}", smallest_text_on_a_phone(&svg));
    }
    let temperatures = vec![("spindle".to_owned(), vec![(0.0, Some(20.0)), (60.0, Some(21.0))])];
    let map = ErrorMap {
        title: String::new(),
        horizontal_axis: ("X, mm".to_owned(), vec![0.0, 1.0]),
        vertical_axis: ("Y, mm".to_owned(), vec![0.0]),
        panels: ["error", "remaining"].map(|name| (name.to_owned(), vec![vec![1.0, 2.0]])),
    };
    let [error, remaining] = map.draw(2.0);
    let others = [draw_circle(&circle_figure(3.0)), draw_run_temperatures(&temperatures), error, remaining];
    assert!(others.iter().all(Option::is_some));
    for svg in others.into_iter().flatten() {
        assert!(smallest_text_on_a_phone(&svg) >= 9.0, "{}", smallest_text_on_a_phone(&svg));
    }
}
