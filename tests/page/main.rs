//! The page as a person uses it: headless Chromium, driven by fantoccini, against the program. The browser
//! and its driver are Debian's `chromium` and `chromium-driver`; axe-core, which looks for what keeps people
//! from using a page, is made by `tests/peers/axe/fetch`. Without them these trials are skipped, with the
//! reason; with `TRUED_REQUIRE_PEERS=1` they fail. Pictures of what was seen are in `page` below the
//! target directory.

mod browser;
mod cycle;
mod life;
mod look;
#[path = "../serve/shop.rs"]
#[allow(dead_code, reason = "shared with trials that use the rest of it")]
mod shop;
mod states;
#[path = "../support/waiting.rs"]
#[allow(dead_code, reason = "shared with trials that use the rest of it")]
mod waiting;

use std::future::Future;
use std::path::{Path, PathBuf};

use browser::Browser;
use libtest_mimic::{Arguments, Completion, Failed, Trial};

const MISSING: &str = "chromedriver or axe-core is not here: apt-get install chromium chromium-driver; tests/peers/axe/fetch";

/// What `tests/peers/axe/fetch` has made.
pub fn axe() -> Option<PathBuf> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent()?;
    let file = target.join("peers/axe-4.12.1/axe.min.js");
    file.is_file().then_some(file)
}

fn trial<F>(name: &str, run: fn(Browser) -> F) -> Trial
where
    F: Future<Output = ()> + 'static,
{
    let own = name.to_owned();
    Trial::ignorable_test(name, move || match (browser::Driver::start(), axe()) {
        (Some(driver), Some(_)) => {
            let mut runtime = tokio::runtime::Builder::new_current_thread();
            let runtime = runtime.enable_all().build()?;
            waiting::watched(own, || {
                runtime.block_on(async { run(Browser::open(driver).await).await });
            });
            Ok(Completion::Completed)
        }
        _ if std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1") => {
            Err(Failed::from(MISSING))
        }
        _ => Ok(Completion::ignored_with(MISSING)),
    })
}

fn main() {
    let trials = vec![
        trial("a_cycle_is_started_held_resumed_and_signed", cycle::held_and_signed),
        trial("each_state_is_seen_from_afar", states::from_afar),
        trial("a_source_that_stands_still_is_away", life::stands_still),
        trial("what_changes_slowly_is_not_left_to_stand", life::slowly),
        trial("without_a_script_all_is_there", states::without_script),
    ];
    // Each has a browser and a machine: one at a time.
    let arguments = Arguments { test_threads: Some(1), ..Arguments::from_args() };
    libtest_mimic::run(&arguments, trials).exit();
}
