//! The page while an operator sets up sensors: their values update while the operator types.

use super::accessibility;
use super::browser::Browser;
use super::cycle::page_url;
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::MachineShop;

/// The artefact is off by 0.12 mm, so that the second prompt has targets.
fn shop_with_sensors() -> MachineShop {
    let file = include_str!("../../../config/multiprobe.toml");
    let cycle = "[serve]\nmin_interval_s = 0.0\n[[serve.cycle]]\nnumber = 1\nmethod = \"multiprobe\"\n";
    let shop = MachineShop::with_machine_file(&format!("{file}\n{cycle}{HTTP_SECTION}"));
    shop.replace_in_machine_file("centre_offset_mm = [0.008, -0.005]", "centre_offset_mm = [0.120, 0.050]");
    shop
}

pub fn sensor_values_update_while_a_name_is_typed() {
    let (browser, shop) = (Browser::open(), shop_with_sensors());
    let daemon = shop.start_daemon("fast");
    browser.client.open_url(&page_url(&daemon)).unwrap();
    browser.fill_and_submit_form("/start", &[("who", "Ada")]);
    browser.wait_for_text("#sensors", |text| text.contains("r2"));
    accessibility::check_page_at_all_sizes(&browser, "sensors");
    browser.fill_and_submit_form("/answer", &[("who", "Ada")]);
    let seen = browser.wait_for_text("#sensors", |text| text.contains("tilt"));
    assert!(seen.contains("section 2") && seen.contains("z1"), "{seen}");
    // The values change, but the page is not reloaded and the typed text is kept.
    browser.client.execute_script("window.untouched = true", &[]).unwrap();
    browser.wait_for_element("form[action$='/answer'] [name=who]").send_keys("Lise").unwrap();
    let first = browser.visible_text("#sensors");
    let second = browser.wait_for_text("#sensors", |text| text != first && text.contains("tilt"));
    browser.wait_for_text("#sensors", |text| text != second && text.contains("tilt"));
    let kept = "return [window.untouched, document.querySelector('#asked [name=who]').value]";
    let kept = browser.client.execute_script(kept, &[]).unwrap();
    assert_eq!(kept, serde_json::json!([true, "Lise"]));
    accessibility::check_page_at_all_sizes(&browser, "centring");
    assert_eq!(browser.take_console_entries(), Vec::<String>::new());
}
