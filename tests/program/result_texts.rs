//! The results of one run on page, report, terminal and in the results file: same value, U, digits, minus sign, symbol,
//! limit and verdict.

use crate::support::harness::{Pool, Trials, trials};
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::{MachineShop, built_in_machine_text};

pub fn trials() -> Trials {
    trials![Pool::Computing, 0;
        all_outputs_show_the_same_results,
        failed_run_names_its_parameters_everywhere,
        run_list_is_filtered_by_verdict,
        volumetric_error_is_judged,
    ]
}

/// EX0C fails, EY0C passes, and the limit of EC0Y is within its uncertainty.
fn shop_with_tolerances() -> MachineShop {
    let limits = "\n[tolerance]\nEX0C_um = 10.0\nEY0C_um = 500.0\nEC0Y_urad = 28.0\n";
    let machine = built_in_machine_text();
    let cycle = "\n[serve]\nmin_interval_s = 1.0\n[[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n";
    let shop = MachineShop::with_machine_file(&format!("{machine}{limits}{cycle}{HTTP_SECTION}"));
    assert_eq!(shop.run_self_calibration().status.code(), Some(3), "fail");
    shop
}

/// Text of a page without its tags, white space joined.
fn text_of_html(html: &str) -> String {
    let mut text = String::new();
    let mut is_tag = false;
    for letter in html.chars() {
        match letter {
            '<' => is_tag = true,
            '>' => is_tag = false,
            _ if !is_tag => text.push(letter),
            _ => {}
        }
        if letter == '>' {
            text.push(' ');
        }
    }
    // The templates escape the slash of µm/m.
    text.replace("&#x2f;", "/").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Rounds by code independent of the program: two significant digits of U.
fn expected_value_and_u(value: f64, expanded: f64) -> [String; 2] {
    let leading_digit = format!("{expanded:e}");
    let exponent: i32 = leading_digit.split_once('e').unwrap().1.parse().unwrap();
    let decimals = usize::try_from(1 - exponent).unwrap_or(0);
    [value, expanded].map(|number| format!("{number:.decimals$}").replace('-', "\u{2212}"))
}

pub fn all_outputs_show_the_same_results() {
    let shop = shop_with_tolerances();
    let estimate = shop.run_json(&["show", "1", "--json"]);
    let terminal = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    let folder = shop.path_text("out");
    assert!(shop.run_trued(&["export", "1", "--to", &folder]).status.success());
    let read = |name: &str| std::fs::read_to_string(shop.path("out").join(name)).unwrap();
    let report = text_of_html(&read("run-1-report.html"));
    let daemon = shop.start_daemon("fast");
    let page = text_of_html(&daemon.http().get_text("/runs/1"));
    assert_eq!(daemon.http().get_text("/api/v1/runs/1/results.csv"), read("run-1-results.csv"));
    let csv = read("run-1-results.csv");
    let rows: Vec<Vec<String>> = csv::Reader::from_reader(csv.as_bytes())
        .records()
        .map(|row| row.unwrap().iter().map(str::to_owned).collect())
        .collect();
    let parameters = estimate["parameters"].as_array().unwrap();
    assert!(rows.len() == parameters.len() && rows.len() > 5);
    for (parameter, row) in parameters.iter().zip(&rows) {
        let symbol = parameter["symbol"].as_str().unwrap();
        let [value, expanded] =
            expected_value_and_u(parameter["value"].as_f64().unwrap(), parameter["U"].as_f64().unwrap());
        // The results file is for programs: an ASCII minus sign.
        assert_eq!([&row[0], &row[2], &row[4]], [symbol, &value.replace('\u{2212}', "-"), &expanded], "{symbol}");
        let (shown, _) = row[11].split_once(' ').unwrap();
        let line = terminal.lines().find(|line| line.split_whitespace().next() == Some(shown)).unwrap();
        let columns: Vec<&str> = line.split_whitespace().collect();
        assert!(columns[1] == value && columns[3] == expanded, "{symbol}: {line}");
        // Base and subscript, name, value, .., U: the report has u between them.
        let subscripted = shown.replacen('_', " ", 1);
        let name = &row[1];
        let on_page = format!("{subscripted} {name} {value} {expanded} {}", row[7]);
        assert!(page.contains(&on_page), "{on_page}\n{page}");
        let in_report = report.split(&format!("{subscripted} {name} {value} ")).nth(1).unwrap();
        assert_eq!(in_report.split(' ').nth(1), Some(expanded.as_str()), "{symbol}");
    }
}

/// Page, report and terminal contain the sentence of each failed result, with limit and verdict.
pub fn failed_run_names_its_parameters_everywhere() {
    let shop = shop_with_tolerances();
    let terminal = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    let listed = String::from_utf8(shop.run_trued(&["runs"]).stdout).unwrap();
    assert!(listed.contains("FAIL"), "{listed}");
    let daemon = shop.start_daemon("fast");
    let get = |path: &str| text_of_html(&daemon.http().get_text(path));
    let sentence =
        terminal.lines().find(|line| line.trim().starts_with("E_X0C") && line.contains("limit ±10 µm: FAIL"));
    let sentence = sentence.unwrap_or_else(|| panic!("{terminal}")).trim();
    let undecided = terminal.lines().find(|line| line.contains("limit ±28 µrad: UNDECIDED")).unwrap().trim();
    for path in ["/machines/simulated%20five-axis%20machine", "/runs/1", "/runs/1/report"] {
        let text = get(path);
        assert!(text.contains(sentence), "{path}: {sentence} is not in {text}");
        assert!(path.starts_with("/machines") || text.contains(undecided), "{path}: {undecided}");
    }
    assert!(get("/runs").contains("finished FAIL"));
}

pub fn run_list_is_filtered_by_verdict() {
    let shop = shop_with_tolerances();
    let daemon = shop.start_daemon("fast");
    let count = |path: &str| daemon.http().get_json(path).as_array().unwrap().len();
    assert_eq!(count("/api/v1/runs?verdict=fail&method=&machine="), 1);
    assert_eq!(count("/api/v1/runs?verdict=pass"), 0);
    assert_eq!(count("/api/v1/runs?method=samba"), 0);
    assert_eq!(daemon.http().get_json("/api/v1/runs")[0]["verdict"], "fail");
    let page = text_of_html(&daemon.http().get_text("/runs?machine=&method=&verdict=pass"));
    assert!(page.contains("no runs") && !page.contains("FAIL"), "{page}");
}

/// At C = 180° the tool is off by twice the distance of the axis from its stated position; squareness and scale add
/// less than 5 µm within the part.
pub fn volumetric_error_is_judged() {
    let limits = "\n[tolerance]\nE_vol_um = 50.0\n";
    let shop = MachineShop::with_machine_file(&format!("{}{limits}", built_in_machine_text()));
    assert_eq!(shop.run_self_calibration().status.code(), Some(3), "fail");
    let estimate = shop.run_json(&["show", "1", "--json"]);
    let parameters = estimate["parameters"].as_array().unwrap();
    let value = |symbol: &str| {
        let of_symbol = parameters.iter().find(|parameter| parameter["symbol"] == symbol).unwrap();
        of_symbol["value"].as_f64().unwrap()
    };
    let (volumetric, expected) = (value("E_vol"), 2.0 * value("EX0C").hypot(value("EY0C")));
    assert!((volumetric - expected).abs() < 5.0, "{volumetric} {expected}");
    let terminal = String::from_utf8(shop.run_trued(&["show", "1"]).stdout).unwrap();
    let name = "(largest position error of the tool over the measured volume)";
    assert!(terminal.lines().any(|line| line.contains("limit ±50 µm: FAIL") && line.contains(name)), "{terminal}");
}
