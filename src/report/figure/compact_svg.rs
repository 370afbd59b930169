//! Shorter text for the SVG that the drawing library writes: a report has hundreds of shapes, and the library repeats
//! all attributes, also those with the default value, for each of them.

use std::fmt::Write as _;

/// Attributes that the report's style sheet or the SVG standard sets to the same value.
const DEFAULT_ATTRIBUTES: [(&str, &str); 4] =
    [("opacity", "1"), ("font-family", "sans-serif"), ("text-anchor", "start"), ("stroke-width", "1")];
/// Attributes of the position and shape of an element; all others are its style.
const GEOMETRY_ATTRIBUTES: [&str; 14] =
    ["x", "y", "dy", "x1", "y1", "x2", "y2", "cx", "cy", "r", "width", "height", "points", "transform"];

/// Consecutive elements with the same style.
struct SameStyleElements {
    /// Element that is written.
    written_tag: &'static str,
    style: String,
    /// Data of a path, or elements without their style, one a line.
    body: String,
    element_count: usize,
}

/// The same picture in fewer bytes: consecutive lines and areas of one style become one path, circles and texts of one
/// style a group.
pub(in crate::report) fn compact_svg(svg: &str) -> String {
    let mut compact = String::with_capacity(svg.len() / 2);
    let mut run: Option<SameStyleElements> = None;
    for element in svg.split_inclusive(">\n<").flat_map(|part| part.strip_suffix('<').or(Some(part))) {
        let next = SameStyleElements::from_element(element.trim_start_matches('<').trim_end());
        match (&mut run, next) {
            (Some(run), Some(next)) if run.written_tag == next.written_tag && run.style == next.style => {
                run.append(&next)
            }
            (_, Some(next)) => {
                run.replace(next).into_iter().for_each(|before| before.write_to(&mut compact));
            }
            (_, None) => {
                run.take().into_iter().for_each(|before| before.write_to(&mut compact));
                let _ = write!(compact, "<{}", element.trim_start_matches('<').trim_end());
            }
        }
    }
    run.into_iter().for_each(|last| last.write_to(&mut compact));
    compact
}

impl SameStyleElements {
    /// Reads an element without its first `<`; `None` for an element that is kept as it is.
    fn from_element(element: &str) -> Option<Self> {
        let (tag, rest) = element.split_once(' ')?;
        let (attributes, content) = rest.split_once('>')?;
        let attributes = attributes.trim_end_matches('/');
        let all: Vec<(&str, &str)> = attributes.split("\" ").filter_map(|pair| pair.trim().split_once("=\"")).collect();
        let all: Vec<(&str, &str)> = all.into_iter().map(|(name, value)| (name, value.trim_end_matches('"'))).collect();
        let attribute = |name: &str| all.iter().find(|(key, _)| *key == name).map(|(_, value)| *value);
        let number = |name: &str| attribute(name)?.parse::<i32>().ok();
        let (tag, body) = match tag {
            "polyline" => ("path", path_data(attribute("points")?, false)?),
            "polygon" => ("path", path_data(attribute("points")?, true)?),
            "line" => {
                let [x1, y1, x2, y2] = [number("x1")?, number("y1")?, number("x2")?, number("y2")?];
                ("path", format!("M{x1},{y1}l{},{}", x2 - x1, y2 - y1))
            }
            "rect" => {
                let [x, y, width, height] = [number("x")?, number("y")?, number("width")?, number("height")?];
                ("path", format!("M{x},{y}h{width}v{height}h{}z", -width))
            }
            // A filled circle is a dot: a line of no length with round ends.
            "circle" if attribute("stroke") == Some("none") => {
                let [x, y, radius] = [number("cx")?, number("cy")?, number("r")?];
                let colour = attribute("fill")?;
                let opacity = style_text("path", &[("opacity", attribute("opacity")?)]);
                let style =
                    format!(" stroke=\"{colour}\" stroke-width=\"{}\" stroke-linecap=\"round\"{opacity}", 2 * radius);
                return Some(Self { written_tag: "path", style, body: format!("M{x},{y}h0"), element_count: 1 });
            }
            "circle" => ("circle", geometry_text(&all)),
            "text" => {
                let content = content.strip_suffix("</text>")?.trim();
                ("text", format!("{}>{content}", geometry_text(&all)))
            }
            _ => return None,
        };
        Some(Self { written_tag: tag, style: style_text(tag, &all), body, element_count: 1 })
    }

    fn append(&mut self, next: &Self) {
        if self.written_tag != "path" {
            self.body.push('\n');
        }
        self.body.push_str(&next.body);
        self.element_count += 1;
    }

    fn write_to(&self, out: &mut String) {
        let Self { written_tag: tag, style, body, element_count } = self;
        let end = if *tag == "text" { "</text>" } else { "/>" };
        let written = match (*tag, element_count) {
            ("path", _) => writeln!(out, "<path{style} d=\"{body}\"/>"),
            (_, 1) => writeln!(out, "<{tag}{style}{body}{end}"),
            _ => {
                let elements: Vec<String> = body.split('\n').map(|element| format!("<{tag}{element}{end}")).collect();
                writeln!(out, "<g{style}>{}</g>", elements.concat())
            }
        };
        debug_assert!(written.is_ok(), "writing to a string cannot fail");
    }
}

/// Path through `points`, such as `1,2 3,4 `, with relative coordinates; `None` if one is not a whole number.
fn path_data(points: &str, is_closed: bool) -> Option<String> {
    let pair = |pair: &str| -> Option<(i32, i32)> {
        let (x, y) = pair.split_once(',')?;
        Some((x.parse().ok()?, y.parse().ok()?))
    };
    let points: Vec<(i32, i32)> = points.split_whitespace().map(pair).collect::<Option<_>>()?;
    let (x, y) = points.first()?;
    let mut data = format!("M{x},{y}l");
    let steps = points.windows(2).map(|ends| (ends[1].0 - ends[0].0, ends[1].1 - ends[0].1));
    let steps: Vec<String> = steps.filter(|step| *step != (0, 0)).map(|(dx, dy)| format!("{dx},{dy}")).collect();
    data.push_str(if steps.is_empty() { "0,0" } else { "" });
    data.push_str(&steps.join(" ").replace(" -", "-").replace(",-", "-"));
    data.push_str(if is_closed { "z" } else { "" });
    Some(data)
}

fn geometry_text(attributes: &[(&str, &str)]) -> String {
    let geometry = attributes.iter().filter(|(name, _)| GEOMETRY_ATTRIBUTES.contains(name));
    geometry.map(|(name, value)| format!(" {name}=\"{value}\"")).collect()
}

/// Attributes of the style as text, numbers rounded; without default values and without the fill of a text.
fn style_text(tag: &str, attributes: &[(&str, &str)]) -> String {
    let is_default = |name: &str, value: &str| {
        let is_text_colour = tag == "text" && name == "fill";
        let is_absent_stroke = name == "stroke" && value == "none";
        is_text_colour || is_absent_stroke || DEFAULT_ATTRIBUTES.contains(&(name, value))
    };
    let style =
        attributes.iter().filter(|(name, value)| !GEOMETRY_ATTRIBUTES.contains(name) && !is_default(name, value));
    style.map(|(name, value)| format!(" {name}=\"{}\"", rounded(value))).collect()
}

/// Rounds a number to two decimals; text that is not a number is unchanged.
fn rounded(value: &str) -> String {
    match value.parse::<f64>() {
        Ok(number) => ((number * 100.0).round() / 100.0).to_string(),
        Err(_) => value.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::sine_function;
    use super::super::{PICTURE_SIZE, draw_function};
    use super::*;
    use machine::record::estimate::FunctionFigureKind;

    #[test]
    fn shapes_of_one_style_share_a_path() {
        let svg = "<svg role=\"img\" viewBox=\"0 0 9 9\">\n\
            <polyline fill=\"none\" opacity=\"1\" stroke=\"#1F6FB2\" stroke-width=\"4\" points=\"1,2 4,1 4,1 -6,11 \"/>\n\
            <polyline fill=\"none\" opacity=\"1\" stroke=\"#1F6FB2\" stroke-width=\"4\" points=\"7,8 7,9 \"/>\n\
            <polygon opacity=\"0.333333\" fill=\"#C2571A\" points=\"0,0 5,0 5,5 \"/>\n\
            <line opacity=\"1\" stroke=\"#D5D9DE\" stroke-width=\"1\" x1=\"3\" y1=\"4\" x2=\"1\" y2=\"9\"/>\n\
            <rect x=\"1\" y=\"2\" width=\"3\" height=\"4\" opacity=\"1\" fill=\"none\" stroke=\"#D5D9DE\"/>\n\
            <circle cx=\"5\" cy=\"6\" r=\"7\" opacity=\"1\" fill=\"none\" stroke=\"#22262B\" stroke-width=\"2\"/>\n\
            <circle cx=\"5\" cy=\"6\" r=\"7\" opacity=\"0.5\" fill=\"#22262B\" stroke=\"none\" stroke-width=\"1\"/>\n\
            <text x=\"1\" y=\"2\" dy=\"0.5ex\" text-anchor=\"end\" font-family=\"sans-serif\" font-size=\"29.032258\" \
            opacity=\"1\" fill=\"#22262B\">\na &lt; b\n</text>\n\
            <text x=\"1\" y=\"3\" dy=\"0.5ex\" text-anchor=\"end\" font-family=\"sans-serif\" font-size=\"29.032258\" \
            opacity=\"1\" fill=\"#22262B\" transform=\"rotate(270, 1, 3)\">\n−1\n</text>\n</svg>\n";
        let expected = "<svg role=\"img\" viewBox=\"0 0 9 9\">\
            <path fill=\"none\" stroke=\"#1F6FB2\" stroke-width=\"4\" d=\"M1,2l3-1-10,10M7,8l0,1\"/>\n\
            <path opacity=\"0.33\" fill=\"#C2571A\" d=\"M0,0l5,0 0,5z\"/>\n\
            <path stroke=\"#D5D9DE\" d=\"M3,4l-2,5\"/>\n\
            <path fill=\"none\" stroke=\"#D5D9DE\" d=\"M1,2h3v4h-3z\"/>\n\
            <circle fill=\"none\" stroke=\"#22262B\" stroke-width=\"2\" cx=\"5\" cy=\"6\" r=\"7\"/>\n\
            <path stroke=\"#22262B\" stroke-width=\"14\" stroke-linecap=\"round\" opacity=\"0.5\" d=\"M5,6h0\"/>\n\
            <g text-anchor=\"end\" font-size=\"29.03\"><text x=\"1\" y=\"2\" dy=\"0.5ex\">a &lt; b</text>\
            <text x=\"1\" y=\"3\" dy=\"0.5ex\" transform=\"rotate(270, 1, 3)\">−1</text></g>\n</svg>";
        assert_eq!(compact_svg(svg), expected);
    }

    /// Every element of a picture is read: none is left as the drawing library wrote it.
    #[test]
    fn picture_keeps_all_texts_in_half_of_the_bytes() {
        let svg = draw_function(&sine_function(FunctionFigureKind::Curve, 72), 2.0).unwrap();
        let compact = compact_svg(&svg);
        assert!(compact.len() < svg.len() / 2, "{} of {}", compact.len(), svg.len());
        for written in ["<polyline", "<polygon", "<line", "<rect", "sans-serif"] {
            assert!(!compact.contains(written), "{written}");
        }
        assert_eq!(compact.matches("<text").count(), svg.matches("<text").count());
        assert!(compact.contains(&format!("viewBox=\"0 0 {} {}\"", PICTURE_SIZE.0, PICTURE_SIZE.1)));
        assert!(compact.starts_with("<svg") && compact.ends_with("</svg>"));
    }
}
