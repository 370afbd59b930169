//! Checks the accessibility of a page at several screen sizes, and stores pictures of it.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::axe_script_path;
use super::browser::Browser;

/// Screen sizes of a desktop, an upright tablet, and a telephone.
const WINDOW_SIZES: [(&str, [u32; 2]); 3] =
    [("desktop", [1280, 900]), ("tablet", [820, 1180]), ("telephone", [390, 844])];

/// Checks at each width: takes a picture; axe-core reports no serious problem, nothing is wider than the screen, and
/// every target is large enough for a glove. Dark mode differs in its colours only: it is checked at one width.
pub fn check_page_at_all_sizes(browser: &Browser, name: &str) {
    for (width, size) in WINDOW_SIZES {
        browser.set_window_size(size);
        let schemes: &[&str] = if width == "tablet" { &["dark", "light"] } else { &["light"] };
        for scheme in schemes {
            let feature = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
            browser.run_devtools_command("Emulation.setEmulatedMedia", &feature);
            save_picture(browser, &format!("{name}-{width}-{scheme}"));
            let where_ = format!("{name}, {width}, {scheme}");
            assert_eq!(serious_axe_violations(browser), Vec::<String>::new(), "{where_}");
        }
        let where_ = format!("{name}, {width}");
        assert_eq!(too_small_click_targets(browser), Vec::<String>::new(), "{where_}");
        let over = "return document.documentElement.scrollWidth - document.documentElement.clientWidth";
        assert_eq!(browser.client.execute_script(over, &[]).unwrap(), json!(0), "{where_}");
    }
}

fn picture_folder() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap().join("page")
}

fn save_picture(browser: &Browser, name: &str) {
    std::fs::create_dir_all(picture_folder()).unwrap();
    let png = browser.client.screenshot_png().unwrap();
    std::fs::write(picture_folder().join(format!("{name}.png")), png).unwrap();
}

/// Problems that axe-core rates serious or worse.
pub fn serious_axe_violations(browser: &Browser) -> Vec<String> {
    if browser.client.execute_script("return typeof axe", &[]).expect("a type") == "undefined" {
        let script = std::fs::read_to_string(axe_script_path().unwrap()).unwrap();
        browser.client.execute_script(&script, &[]).expect("axe-core");
    }
    let ask = "return axe.run().then((found) => found.violations.map((fault) => ({
            id: fault.id, impact: fault.impact, help: fault.help,
            where: fault.nodes.map((node) => node.html).slice(0, 3) })),
            (error) => [{ impact: 'serious', id: String(error) }])";
    let found = browser.client.execute_script(ask, &[]).expect("what it finds");
    let found = found.as_array().expect("a list").clone();
    let bad = |fault: &&Value| matches!(fault["impact"].as_str(), Some("serious" | "critical"));
    found.iter().filter(bad).map(ToString::to_string).collect()
}

/// Targets less than 48 pixels high or wide, too small for a glove.
fn too_small_click_targets(browser: &Browser) -> Vec<String> {
    let ask = "return [...document.querySelectorAll('a, button, input, select, summary')]
        .filter((one) => one.offsetParent && one.type !== 'hidden')
        .map((one) => [one.closest('label') || one, one.outerHTML])
        .map(([hit, html]) => [hit.getBoundingClientRect(), html])
        .filter(([box]) => box.height < 47.5 || box.width < 47.5)
        .map(([box, html]) => `${Math.round(box.width)} x ${Math.round(box.height)}: ${html}`)";
    let found = browser.client.execute_script(ask, &[]).expect("sizes");
    found.as_array().expect("a list").iter().map(ToString::to_string).collect()
}
