//! Validity of a register map.

use super::{Chunk, MOST_READ, MOST_WRITTEN, Map};
use link::modbus::Space;
use link::modbus::value::Order;

/// Maximum number of registers for parameters: far more than any touch needs.
const MOST_OF_PROGRAM: usize = 2000;

/// # Errors
/// The map is invalid; the message names the items.
pub(super) fn map(map: &Map) -> Result<(), String> {
    if !matches!(map.status.space, Space::Input | Space::Holding) {
        return Err("`status.space` is `input` or `holding`: bits hold no numbers".to_owned());
    }
    let Chunk { registers, order, .. } = map.command.chunk;
    // A line must fit in one request; parameters are read back before they take effect, and may need
    // several requests.
    let resident = map.status.result.is_some();
    let most = if resident { MOST_OF_PROGRAM } else { MOST_WRITTEN };
    if !(1..=most).contains(&usize::from(registers)) {
        return Err(format!(
            "`command.chunk` has {registers} registers; {} 1 to {most}",
            if resident { "a resident program takes" } else { "one request writes" }
        ));
    }
    if resident && order != Order::default() {
        return Err(
            "`command.chunk` of a resident program has no `order`: each of its parameters has"
                .to_owned(),
        );
    }
    if !resident {
        together(map)?;
    }
    scales(map)?;
    inside(map)?;
    let command = map.command.spans().into_iter();
    let command =
        command.map(|(name, at, count)| (Space::Holding, at, count, format!("command.{name}")));
    let status = map.status.spans().into_iter();
    let status =
        status.map(|(name, at, count)| (map.status.space, at, count, format!("status.{name}")));
    apart(command.chain(status).collect())
}

/// Checks that one request writes a line and all that belongs to it. Then a late request of the line before
/// cannot leave values next to those of the next line.
fn together(map: &Map) -> Result<(), String> {
    const WITH_A_LINE: [&str; 4] = ["acknowledge", "crc", "length", "chunk"];
    let mut spans = map.command.spans();
    spans.retain(|(name, ..)| WITH_A_LINE.contains(name));
    spans.sort_by_key(|(_, at, _)| *at);
    let beside = |pair: &[(&str, u16, u16)]| match pair {
        [(_, at, count), (_, next, _)] => u32::from(*at) + u32::from(*count) == u32::from(*next),
        _ => true,
    };
    let registers: usize = spans.iter().map(|(.., count)| usize::from(*count)).sum();
    let last = spans.last().is_some_and(|(name, ..)| *name == "chunk");
    // The heartbeat may be directly before them, and is then written in the same request.
    if last && spans.windows(2).all(beside) && registers < MOST_WRITTEN {
        return Ok(());
    }
    Err(format!(
        "`command.acknowledge`, `crc`, `length` and `chunk` must lie side by side, `chunk` last, {} \
         registers at most: one request writes them, so that nothing of a line before is left beside them",
        MOST_WRITTEN - 1
    ))
}

fn scales(map: &Map) -> Result<(), String> {
    let status = &map.status;
    let axes = status.latch.values().chain(status.position.values());
    let times = [status.time_s, status.latch_time_s];
    match axes.chain(&times).find(|register| register.number.scale <= 0.0) {
        None => Ok(()),
        Some(register) => {
            Err(format!("the scale at address {} must be greater than 0", register.address))
        }
    }
}

/// Checks that one request can read the status, head first, tail last.
fn inside(map: &Map) -> Result<(), String> {
    let (first, count) = map.status.block();
    let last = map.status.sequence_tail.address;
    for (name, address, length) in map.status.spans() {
        let end = usize::from(address) + usize::from(length);
        if address < first || name != "sequence_tail" && end > usize::from(last) {
            return Err(format!(
                "`status.{name}` at {address} lies outside the block from `sequence_head` at {first} to \
                 `sequence_tail` at {last}"
            ));
        }
    }
    if usize::from(count) > MOST_READ {
        return Err(format!(
            "the status is a block of {count} registers; one request reads {MOST_READ} at most"
        ));
    }
    Ok(())
}

/// Space, first register, number of registers and name of an item.
pub(in super::super) type Span = (Space, u16, u16, String);

/// Checks that no two items overlap.
///
/// # Errors
/// Two items overlap, or an item is beyond the last address; the message names them.
pub(in super::super) fn apart(mut all: Vec<Span>) -> Result<(), String> {
    all.sort();
    for pair in all.windows(2) {
        let [(space, at, count, name), (next_space, next, _, next_name)] = pair else { continue };
        if space == next_space && usize::from(*at) + usize::from(*count) > usize::from(*next) {
            return Err(format!(
                "`{name}` and `{next_name}` lie over each other at address {next}"
            ));
        }
        if usize::from(*next) + 1 > usize::from(u16::MAX) {
            return Err(format!("`{next_name}` lies beyond the last address"));
        }
    }
    Ok(())
}
