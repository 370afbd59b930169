//! `[serve]` sections that are refused before the daemon serves.

use crate::support::machine_shop::{MODBUS_SECTION, MachineShop};

/// The daemon refuses to serve a cycle that everybody could start, or that no enabling signal protects.
pub fn invalid_serve_sections_are_refused() {
    let cases = [
        ("127.0.0.1:0", "0.0.0.0:1502", "any_interface"),
        ("allow = [\"127.0.0.1\"]", "allow = []", "modbus.allow is empty"),
        ("min_interval_s = 0.0", "demand = [\"auto\"]", "demand must contain `enable`"),
        ("number = 1", "number = 9", "cycle number 9"),
        ("\"self-calibration\"\n[serve.", "\"sorcery\"\n[serve.", "the method `sorcery` is not known"),
        ("allow = ", "alow = ", "allow"),
        (MODBUS_SECTION, "", "no interface can start a cycle"),
        (MODBUS_SECTION, "[serve.http]\nlisten = \"0.0.0.0:0\"\n", "other computers can reach"),
        (MODBUS_SECTION, "[serve.http]\nlisten = \"127.0.0.1:0\"\nnames = [\"a.example\"]\n", "tokens = true"),
        // A refusal of the cycle itself is reported at the start of the daemon, not at the first start of the
        // cycle.
        ("trials = 1000", "trials = 1000\npositions = 2", "cycle 1 cannot be measured"),
        ("centre_mm = [0.0, 0.0, 0.0]", "centre_mm = [0.0, 0.0, 900.0]", "cycle 1 cannot be"),
    ];
    for (from, to, words) in cases {
        let shop = MachineShop::with_serve(MODBUS_SECTION);
        shop.replace_in_machine_file(from, to);
        let output = shop.run_trued(&["serve", "--machine", &shop.machine_path()]);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{to}: {told}");
        assert!(told.contains(words), "{words} in {told}");
    }
}
