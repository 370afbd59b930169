//! `trued run r-test`: an operator at the terminal clamps sphere and nest.

use serde_json::Value;

use super::{MachineShop, successful_json_output};
use crate::support::terminal_operator;

/// Location errors of `config/r-test.toml`, µm.
const TRUE_PARAMETERS: [(&str, f64); 2] = [("EX0C", 12.0), ("EY0C", -7.0)];

pub fn two_r_test_runs_find_the_true_axis_and_are_compared() {
    let file = include_str!("../../../config/r-test.toml");
    let file = file.replacen("samples = 10", "samples = 10\nmonte_carlo_trials = 100", 1);
    let shop = MachineShop::with_machine_file(&file);
    for _ in 0..2 {
        let mut run = shop.trued_command(&["run", "r-test", "--json", "--machine", &shop.machine_path()]);
        let estimate =
            successful_json_output(&terminal_operator::confirm_prompts_with_enter(&mut run).output().unwrap());
        for (symbol, truth) in TRUE_PARAMETERS {
            let parameters = estimate["parameters"].as_array().unwrap();
            let found = parameters.iter().find(|parameter| parameter["symbol"] == symbol).unwrap();
            let [value, u] = ["value", "U"].map(|key| found[key].as_f64().unwrap());
            assert!((value - truth).abs() <= u && u < 2.0, "{symbol} {value} ± {u}");
        }
    }
    let compared = successful_json_output(&shop.run_trued(&["compare", "1", "2", "--json"]));
    let functions: Vec<&Value> = compared["functions"].as_array().unwrap().iter().collect();
    let symbols = functions.iter().map(|function| function["symbol"].as_str().unwrap());
    assert_eq!(symbols.collect::<Vec<_>>(), ["EXC_total", "EYC_total", "EXC", "EYC", "EZC"]);
}
