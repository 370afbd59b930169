//! Who looks at the clock, asks the judge, and does what it says: first in the journal, then at the desk.

use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::books::Books;
use super::entry::{BY_CALL, Entry, Need, Overlap};
use super::judge::{Decision, Standing, Wanted, judge};
use super::window::{Window, window};
use crate::service::Log;
use crate::service::board::State;
use crate::service::config::Demand;
use crate::service::desk::Desk;
use crate::service::rota::{Call, Planned, Told};
use crate::store::{Journal, Outcome, Slot, StoreError};

/// A timer that calls again within this time, or whose clock was set back, has called already.
const ONCE: SignedDuration = SignedDuration::from_mins(5);
/// Of what comes, in the plan that is shown.
const NEXT: usize = 3;

struct Track {
    entry: Entry,
    /// Up to this slot the journal knows.
    seen: Timestamp,
    /// Its time has come; why it has not started.
    waits: Option<(Timestamp, String)>,
}

pub struct Keeper {
    books: Books,
    desk: Desk,
    demand: Vec<Demand>,
    tracks: Vec<Track>,
    looked: Option<Timestamp>,
    told: Option<Told>,
    /// Since when, on the clock that nobody sets, the control is known to execute nothing.
    idle_since: Option<f64>,
    idle: Option<Duration>,
    /// The slot whose run is on, and the count of starts that it is.
    under_way: Option<(Slot, u16)>,
    stopped: bool,
    minute: i64,
}

impl Keeper {
    /// What an earlier service left is written down: a slot that it started, an arming that its end broke.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn begin(
        machine: &str,
        (entries, demand): (&[Entry], &[Demand]),
        desk: &Desk,
        journal: &Arc<Journal>,
        log: &Log,
    ) -> Result<Self, StoreError> {
        let known = entries.iter().map(|e| (e.name.clone(), format!("{} {}", e.at, e.zone)));
        let seen = journal.schedules(machine, known.collect(), Timestamp::now()).wait()?;
        let (machine, journal, log) = (machine.to_owned(), Arc::clone(journal), log.clone());
        let books = Books { machine, journal, log };
        for slot in books.recent()?.into_iter().filter(|slot| slot.outcome == Outcome::Started) {
            books.settle(slot);
        }
        books
            .journal
            .armings(&books.machine)?
            .iter()
            .for_each(|arming| books.end_if_broken(arming));
        let track = |(entry, seen): (&Entry, _)| Track { entry: entry.clone(), seen, waits: None };
        Ok(Self {
            books,
            desk: desk.clone(),
            demand: demand.to_vec(),
            tracks: entries.iter().zip(seen).map(track).collect(),
            looked: None,
            told: None,
            idle_since: None,
            idle: None,
            under_way: None,
            stopped: false,
            minute: i64::MIN,
        })
    }

    pub fn ends(&self) -> bool {
        self.desk.is_ending()
    }

    /// `now` on the wall, `now_s` on a clock that nobody sets.
    pub fn look(&mut self, now: Timestamp, now_s: f64) {
        self.follow();
        self.listen(now_s);
        if let Some(last) = self.looked.filter(|last| now < *last) {
            self.books.log.say(&format!("schedule: the clock was set back, from {last} to {now}"));
        }
        let mut tracks = std::mem::take(&mut self.tracks);
        let mut changed = false;
        for track in &mut tracks {
            changed |= self.attend(track, now);
        }
        self.tracks = tracks;
        self.looked = Some(now);
        let minute = now.as_second().div_euclid(60);
        if changed || minute != self.minute {
            self.minute = minute;
            self.publish(now);
        }
    }

    /// Whether anything has changed.
    fn attend(&mut self, track: &mut Track, now: Timestamp) -> bool {
        let found = window(&track.entry.calendar, self.looked, track.seen, now);
        let before = track.waits.clone();
        self.missed(track, &found);
        // Before its time once more: the clock was set back, and brings it again.
        track.waits = track.waits.take().filter(|(at, _)| *at <= now);
        if let Some(at) = found.due {
            if let Some((last, why)) = track.waits.take() {
                self.skips(track, last, format!("{why}; the next is due"));
            }
            let open = at > track.seen || self.books.is_open(&track.entry.name, at);
            track.waits = open.then(|| (at, String::new()));
        }
        if let Some((at, why)) = track.waits.take() {
            self.decide(track, (at, why), now);
        }
        found.due.is_some() || !found.missed.is_empty() || before != track.waits
    }

    fn missed(&self, track: &mut Track, found: &Window) {
        let Track { entry, seen, .. } = track;
        if found.more {
            self.books
                .log
                .say(&format!("schedule {}: earlier ones were missed as well", entry.name));
        }
        let why = match self.looked {
            None => "no service was there at its time",
            Some(_) => "the clock went forward over it, or the service stood still",
        };
        for at in &found.missed {
            let slot = self.books.slot(&entry.name, entry.cycle, *at, Outcome::Missed);
            self.books.tell(&Slot { why: why.to_owned(), ..slot });
            *seen = *at.max(seen);
        }
    }

    fn skips(&self, track: &mut Track, at: Timestamp, why: String) {
        let Track { entry, seen, .. } = track;
        let slot = self.books.slot(&entry.name, entry.cycle, at, Outcome::Skipped);
        self.books.tell(&Slot { why, ..slot });
        *seen = at.max(*seen);
    }

    fn decide(&mut self, track: &mut Track, (at, last): (Timestamp, String), now: Timestamp) {
        let entry = &track.entry;
        let wanted = Wanted {
            demand: &self.demand,
            ready: &entry.ready,
            idle: entry.idle,
            overlap: entry.overlap,
            latest: at.saturating_add(entry.latest).unwrap_or(at),
        };
        let waits = match self.judged(entry.cycle, &wanted, now) {
            Ok(Decision::Start) => {
                let (name, cycle) = (entry.name.clone(), entry.cycle);
                track.seen = track.seen.max(at);
                // Why not is in the journal by then.
                return drop(self.start(&name, cycle, at));
            }
            Ok(Decision::Skip(why)) => return self.skips(track, at, why),
            Ok(Decision::Wait(why)) => why,
            // Without a journal nothing starts.
            Err(error) if now <= wanted.latest => format!("{error}; {}", error.remedy()),
            Err(error) => return self.skips(track, at, error.to_string()),
        };
        if waits != last {
            self.books.log.say(&format!("schedule {} of {at} waits: {waits}", entry.name));
        }
        track.waits = Some((at, waits));
    }

    fn judged(
        &self,
        cycle: u16,
        wanted: &Wanted<'_>,
        now: Timestamp,
    ) -> Result<Decision, StoreError> {
        let armings = self.books.journal.armings(&self.books.machine)?;
        let arming = armings.iter().find(|arming| arming.cycle == cycle);
        arming.into_iter().for_each(|arming| self.books.end_if_broken(arming));
        let said = self.told.map(|told| told.said).unwrap_or_default();
        let refused = self.desk.may(cycle, said).err();
        Ok(judge(wanted, &Standing { now, refused, arming, told: self.told, idle: self.idle }))
    }

    /// First in the journal, then at the desk.
    fn start(&mut self, schedule: &str, cycle: u16, at: Timestamp) -> Result<(), String> {
        let slot = self.books.slot(schedule, cycle, at, Outcome::Started);
        if !self.books.keep(&slot) {
            return Err("it was decided before, or the journal cannot be written".to_owned());
        }
        let said = self.told.map(|told| told.said).unwrap_or_default();
        match self.desk.start(cycle, said, &format!("the schedule {schedule}")) {
            Ok(()) => {
                self.under_way = Some((slot, self.desk.board().accepted));
                Ok(())
            }
            Err(refusal) => {
                let (outcome, why) = (Outcome::Skipped, refusal.to_string());
                self.books.tell(&Slot { outcome, why: why.clone(), ..slot });
                Err(why)
            }
        }
    }

    /// A timer of the system, or a person, says that a cycle is due.
    pub fn called(&mut self, call: Call, now: Timestamp) {
        let Call { cycle, who, answer } = call;
        self.books.log.say(&format!("schedule: {who} says that cycle {cycle} is due"));
        // Whoever called may have gone.
        let _ = answer.send(self.answer(cycle, now));
    }

    fn answer(&mut self, cycle: u16, now: Timestamp) -> Result<(), String> {
        let name = format!("{BY_CALL} {cycle}");
        // Whatever its schedules wait for.
        let of_cycle = self.tracks.iter().map(|t| &t.entry).filter(|entry| entry.cycle == cycle);
        let ready: Vec<Need> = of_cycle.clone().flat_map(|entry| entry.ready.clone()).collect();
        let idle = of_cycle.map(|entry| entry.idle).max().unwrap_or_default();
        let (demand, ready) = (self.demand.as_slice(), ready.as_slice());
        let wanted = Wanted { demand, ready, idle, overlap: Overlap::Skip, latest: now };
        let decision = self.judged(cycle, &wanted, now).map_err(|error| error.to_string())?;
        let began = |slot: &&Slot| {
            let ran = !matches!(slot.outcome, Outcome::Skipped | Outcome::Missed);
            slot.schedule == name && ran && now.duration_since(slot.at) < ONCE
        };
        let recent = self.books.recent().map_err(|error| error.to_string())?;
        let why = match (recent.iter().find(began), decision) {
            (Some(slot), _) => format!("it was started already, at {}", slot.at),
            (None, Decision::Start) => return self.start(&name, cycle, now),
            (None, Decision::Wait(why) | Decision::Skip(why)) => why,
        };
        let slot = self.books.slot(&name, cycle, now, Outcome::Skipped);
        self.books.tell(&Slot { why: why.clone(), ..slot });
        Err(why)
    }

    /// What the machine tells just now.
    fn listen(&mut self, now_s: f64) {
        self.told = self.desk.rota().told();
        let state = self.desk.board().state;
        let rests = state != State::Running && self.told.is_some_and(|told| told.idle);
        self.idle_since = rests.then(|| self.idle_since.unwrap_or(now_s));
        let idle = self.idle_since.map(|since| (now_s - since).max(0.0));
        self.idle = idle.map(Duration::from_secs_f64);
        let stopped = matches!(state, State::Held | State::Failed);
        if stopped && !self.stopped {
            self.books.disarm(None, "the machine is held, or a cycle failed");
        }
        self.stopped = stopped;
    }

    /// What becomes of the slot whose run is on.
    fn follow(&mut self) {
        let Some((mut slot, accepted)) = self.under_way.take() else { return };
        let board = self.desk.board();
        let ours = board.accepted == accepted;
        if ours && slot.run == 0 && board.run > 0 {
            slot.run = board.run.into();
            self.books.keep(&slot);
        }
        match board.state {
            State::Running if ours => self.under_way = Some((slot, accepted)),
            // The next service finds it.
            State::Ending => {}
            _ => {
                let cycle = slot.cycle;
                if !self.books.settle(slot) {
                    self.books.disarm(None, &format!("the schedule's cycle {cycle} failed"));
                }
            }
        }
    }

    fn publish(&self, now: Timestamp) {
        let waits = self.tracks.iter().map(|Track { waits, .. }| {
            waits.as_ref().map(|(at, why)| format!("that of {at} waits: {why}"))
        });
        let all = self.tracks.iter().map(|track| of_entry(&track.entry, now)).zip(waits);
        let all = all.map(|(planned, waiting)| Planned { waiting, ..planned });
        self.desk.rota().plans(all.collect());
    }
}

/// What comes after `now`.
pub fn planned(entries: &[Entry], now: Timestamp) -> Vec<Planned> {
    entries.iter().map(|entry| of_entry(entry, now)).collect()
}

fn of_entry(entry: &Entry, now: Timestamp) -> Planned {
    Planned {
        name: entry.name.clone(),
        cycle: entry.cycle,
        at: entry.at.clone(),
        zone: entry.zone.clone(),
        latest_min: entry.latest.as_secs() / 60,
        next: entry.calendar.after(now).take(NEXT).collect(),
        waiting: None,
    }
}
