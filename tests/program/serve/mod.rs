//! `trued serve` over HTTP and over a line of text: cycles, lists, roles, hostile and slow clients.

mod again;
mod asks;
mod audited;
pub mod crowd;
mod hostile;
mod line;
mod lists;
mod page;
mod people;
mod person;
mod prompts;
mod refused_config;
mod several;
mod slow;
mod tokens;
mod watched;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 40;
        slow::shown_out,
        lists::signs_of_life,
    ]
    .and(trials![Pool::Waiting, 20;
        lists::a_verdict,
        page::a_hold,
        several::machines,
        audited::holds,
        audited::reasons,
    ])
    .and(trials![Pool::Waiting, 0;
        line::starts,
        page::a_cycle,
        lists::pages,
        lists::slips,
        again::resumed,
        again::signed,
        person::against_the_machine,
        person::leaves_a_lost_position,
        person::resumes_elsewhere,
        page::strangers,
        asks::a_cycle,
        asks::another_file,
        asks::no_page,
        prompts::answered,
        prompts::stopped,
        prompts::at_a_terminal,
        watched::by_programs,
        watched::at_a_terminal,
        several::bad_files,
        hostile::roles,
        hostile::sessions,
        hostile::too_often,
        people::refused,
        hostile::paths,
        tokens::by_root,
        tokens::unreadable,
        audited::pages,
        audited::gone,
        refused_config::bad_sections,
    ])
    // A thousand connections: other trials would disturb the load and the daemon's memory.
    .and(trials![Pool::Alone, 10;
        crowd::beside_a_run,
        crowd::and_a_hold,
        crowd::who_only_connect,
        crowd::listeners,
    ])
}
